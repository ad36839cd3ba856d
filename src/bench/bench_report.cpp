// SPDX-License-Identifier: Apache-2.0
// What a benchmark found, as tables, JSON and pictures.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/atomic_file.h"
#include "vdbcarve/app/bench.h"

namespace vdbcarve {

namespace {

std::string number(double v, int digits) {
    char text[32];
    std::snprintf(text, sizeof text, "%.*f", digits, v);
    return text;
}
std::string some(double v, int digits) { return v > 0 ? number(v, digits) : "–"; }
std::string grid_of(const BenchRow& b) { return std::to_string(b.dims[0]) + "x" + std::to_string(b.dims[1]) + "x" + std::to_string(b.dims[2]); }

std::string head_of(const BenchResult& r) {
    return "scene: " + r.scene + "; " + r.machine + ", " + std::to_string(r.threads) + " threads, vector loops " + r.loops +
           (r.device.empty() ? "" : "; " + r.device) + "\ndense method: " + r.dense_flags +
           (r.device.empty() ? "" : "; on the device a thread a voxel, approximate division, early exit") + "\n\n";
}

}  // namespace

std::string bench_table(const BenchResult& r) {
    std::ostringstream out;
    out << head_of(r);
    bool cpu = false, device = false;
    for (const BenchRow& b : r.rows) {
        cpu |= b.carve_s > 0;
        device |= b.device.has_value();
    }
    const auto mb = [&](size_t bytes) { return number(static_cast<double>(bytes) / 1e6, 0); };
    if (cpu) {
        out << "| grid | views | fields s (cpu) | carve s (cpu) | peak MB | hull MB | leaves | look-ups M | dense s (cpu) | dense peak MB | dense / (fields + "
               "carve) | dense / carve | level_set s | dual mesh s | marching cubes s |\n"
            << "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";
        for (const BenchRow& b : r.rows) {
            const bool dense = b.dense_s > 0;
            out << "| " << grid_of(b) << " | " << b.views << " | " << number(b.fields_s, 3) << " (" << number(b.fields_cpu_s, 2) << ") | "
                << number(b.carve_s, 3) << " (" << number(b.carve_cpu_s, 2) << ") | " << mb(b.carve_peak_bytes) << " | " << mb(b.hull_bytes) << " | "
                << b.leaves << " | " << number(static_cast<double>(b.voxel_lookups) / 1e6, 1) << " | "
                << (dense ? number(b.dense_s, 3) + " (" + number(b.dense_cpu_s, 2) + ")" : "–") << " | " << (dense ? mb(b.dense_peak_bytes) : "–") << " | "
                << (dense ? number(b.ratio_with_fields(), 1) : "–") << " | " << (dense ? number(b.ratio_without_fields(), 1) : "–") << " | "
                << some(b.level_set_s, 2) << " | " << some(b.mesh_s, 2) << " | " << some(b.cubes_s, 2) << " |\n";
        }
    }
    if (device) {
        out << "\nDevice, ms: steps are device time; the columns with an arrow are wall time.\n\n"
            << "| grid | views | leaves | look-ups M | upload | fields | nodes | leaves | topology | fields → hull | level_set | mesh | host masks → hull | "
               "device masks → mesh | host masks → mesh | hull → host | → OpenVDB | mesh → host | dense | "
               "device MB |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n";
        for (const BenchRow& b : r.rows) {
            if (!b.device) continue;
            const BenchDevice& d = *b.device;
            out << "| " << grid_of(b) << " | " << b.views << " | " << d.leaf_count << " | " << number(static_cast<double>(d.voxel_lookups) / 1e6, 1) << " | "
                << number(d.upload, 2) << " | " << number(d.distance, 3) << " | " << number(d.nodes, 3) << " | " << number(d.leaves, 3) << " | "
                << number(d.topology, 3) << " | " << number(d.fields_to_hull, 3) << " | " << some(d.level_set, 3) << " | " << some(d.mesh, 3) << " | "
                << number(d.host_to_hull, 2) << " | " << some(d.device_to_mesh, 2) << " | " << some(d.host_to_mesh, 2) << " | " << number(d.download_hull, 1)
                << " | " << number(d.openvdb_hull, 1) << " | " << some(d.download_mesh, 1) << " | " << some(d.dense, 2) << " | " << mb(d.bytes) << " |\n";
        }
    }
    return out.str();
}

std::string bench_paper_table(const BenchResult& r) {
    // Denkowski 2013, Table 1: seconds on a Core i5 with 1 and 4 threads and on a GTX 560, of its own images.
    struct Paper {
        std::array<int, 3> dims;
        const char* text;
    };
    static const Paper kPaper[] = {{{256, 256, 256}, "–; 11.0; 0.48"}, {{512, 512, 512}, "300; 80; 3.73"}, {{1024, 512, 1024}, "1019; 297; 13.0"}};
    std::ostringstream out;
    out << head_of(r);
    out << "Seconds from masks in host memory to the volume, distance fields included; the dense method needs none. Transfers of the device apart: masks in, "
           "volume out.\n\n"
        << "| volume | views | CPU x1 dense | CPU x1 sparse | CPU x" << r.threads << " dense | CPU x" << r.threads
        << " sparse | GPU dense (in) | GPU sparse, in included (in; out) | GPU dense / sparse | carve + mesh a second | the paper: CPU x1; x4; GPU |\n"
        << "|---|---|---|---|---|---|---|---|---|---|---|\n";
    for (const BenchRow& b : r.rows) {
        const char* paper = "–";
        for (const Paper& p : kPaper)
            if (p.dims == b.dims && b.views == 36) paper = p.text;
        out << "| " << grid_of(b) << " | " << b.views << " | " << some(b.dense_one_s, 3) << " | " << some(b.fields_one_s + b.carve_one_s, 3) << " | "
            << some(b.dense_s, 3) << " | " << some(b.fields_s + b.carve_s, 3) << " | ";
        if (b.device) {
            const BenchDevice& d = *b.device;
            const double dense = d.dense > 0 ? d.dense + d.dense_upload : 0;
            out << (d.dense > 0 ? number(dense / 1e3, 5) + " (" + number(d.dense_upload / 1e3, 5) + ")" : "–") << " | " << number(d.host_to_hull / 1e3, 5)
                << " (" << number(d.upload / 1e3, 5) << "; " << number(d.download_hull / 1e3, 5) << ") | "
                << (dense > 0 ? number(dense / d.host_to_hull, 1) : "–") << " | " << (d.host_to_mesh > 0 ? number(1e3 / d.host_to_mesh, 0) : "–") << " | ";
        } else {
            out << "– | – | – | – | ";
        }
        out << paper << " |\n";
    }
    return out.str();
}

std::string bench_json(const BenchResult& r) {
    nlohmann::ordered_json j{{"scene", r.scene}, {"machine", r.machine}, {"threads", r.threads}, {"vector_loops", r.loops}, {"dense_method", r.dense_flags}};
    if (!r.device.empty()) j["device"] = r.device;
    j["rows"] = nlohmann::json::array();
    for (const BenchRow& b : r.rows) {
        nlohmann::ordered_json row{{"dims", b.dims}, {"views", b.views}};
        const auto put = [](nlohmann::ordered_json& to, const char* key, double value) {
            if (value > 0) to[key] = value;
        };
        if (b.carve_s > 0) {
            row.update({{"fields_s", b.fields_s},
                        {"fields_cpu_s", b.fields_cpu_s},
                        {"carve_s", b.carve_s},
                        {"carve_cpu_s", b.carve_cpu_s},
                        {"carve_peak_bytes", b.carve_peak_bytes},
                        {"field_bytes", b.field_bytes},
                        {"hull_bytes", b.hull_bytes},
                        {"leaves", b.leaves},
                        {"active_voxels", b.active_voxels},
                        {"node_tests", b.node_tests},
                        {"voxel_lookups", b.voxel_lookups}});
        }
        if (b.level_set_s > 0) {
            row["level_set_s"] = b.level_set_s;
            row["level_set_peak_bytes"] = b.level_set_peak_bytes;
            row["mesh_s"] = b.mesh_s;
            row["marching_cubes_s"] = b.cubes_s;
        }
        if (b.dense_s > 0) {
            row["dense_s"] = b.dense_s;
            row["dense_cpu_s"] = b.dense_cpu_s;
            row["dense_peak_bytes"] = b.dense_peak_bytes;
            row["dense_object_voxels"] = b.dense_object_voxels;
            row["ratio_with_fields"] = b.ratio_with_fields();
            row["ratio_without_fields"] = b.ratio_without_fields();
        }
        put(row, "fields_one_thread_s", b.fields_one_s);
        put(row, "carve_one_thread_s", b.carve_one_s);
        put(row, "dense_one_thread_s", b.dense_one_s);
        if (b.device) {
            const BenchDevice& d = *b.device;
            nlohmann::ordered_json v{{"leaves", d.leaf_count},
                                     {"node_tests", d.node_tests},
                                     {"voxel_lookups", d.voxel_lookups},
                                     {"bytes", d.bytes},
                                     {"upload_ms", d.upload},
                                     {"fields_ms", d.distance},
                                     {"nodes_ms", d.nodes},
                                     {"leaves_ms", d.leaves},
                                     {"topology_ms", d.topology},
                                     {"fields_to_hull_ms", d.fields_to_hull},
                                     {"host_masks_to_hull_ms", d.host_to_hull},
                                     {"download_hull_ms", d.download_hull},
                                     {"download_and_convert_hull_ms", d.openvdb_hull}};
            put(v, "level_set_ms", d.level_set);
            put(v, "mesh_ms", d.mesh);
            put(v, "device_masks_to_mesh_ms", d.device_to_mesh);
            put(v, "host_masks_to_mesh_ms", d.host_to_mesh);
            put(v, "download_mesh_ms", d.download_mesh);
            put(v, "dense_ms", d.dense);
            put(v, "dense_upload_ms", d.dense_upload);
            v["vertices"] = d.vertices;
            v["triangles"] = d.triangles;
            row["device"] = v;
        }
        j["rows"].push_back(row);
    }
    return j.dump(1) + "\n";
}

std::string bench_svg(const BenchResult& r, bool over_views) {
    // The rows to draw: of the commonest number of views, or of the commonest grid.
    const auto key = [&](const BenchRow& b) { return over_views ? std::array<int, 3>(b.dims) : std::array<int, 3>{b.views, 0, 0}; };
    std::map<std::array<int, 3>, int> tally;
    for (const BenchRow& b : r.rows) ++tally[key(b)];
    std::array<int, 3> common{};
    int most = 0;
    for (const auto& [k, n] : tally)
        if (n > most) common = k, most = n;
    struct Line {
        const char* name;
        const char* colour;
        std::function<double(const BenchRow&)> seconds;
        std::vector<std::pair<double, double>> points;
    };
    const auto device = [](double BenchDevice::*what) { return [what](const BenchRow& b) { return b.device ? (*b.device).*what / 1e3 : 0.0; }; };
    std::vector<Line> lines{{"CPU: dense method", "#b04a3a", [](const BenchRow& b) { return b.dense_s; }, {}},
                            {"CPU: distance fields + carve", "#2a6f97", [](const BenchRow& b) { return b.fields_s + b.carve_s; }, {}},
                            {"CPU: level_set", "#7a7a4a", [](const BenchRow& b) { return b.level_set_s; }, {}},
                            {"GPU: dense method, masks uploaded",
                             "#d98c7f",
                             [](const BenchRow& b) { return b.device && b.device->dense > 0 ? (b.device->dense + b.device->dense_upload) / 1e3 : 0; },
                             {}},
                            {"GPU: masks in host memory to hull", "#3a9a6a", device(&BenchDevice::host_to_hull), {}},
                            {"GPU: masks on the device to mesh", "#8a5fb0", device(&BenchDevice::device_to_mesh), {}},
                            {"GPU: carve alone", "#61a5c2", device(&BenchDevice::fields_to_hull), {}}};
    double x_low = 1e300, x_high = 0, y_low = 1e300, y_high = 0;
    std::map<double, std::string> ticks;
    for (const BenchRow& b : r.rows) {
        if (key(b) != common) continue;
        const double x = over_views ? b.views : static_cast<double>(b.dims[0]) * b.dims[1] * b.dims[2];
        ticks[x] = over_views ? std::to_string(b.views) : std::to_string(b.dims[0]) + "×" + std::to_string(b.dims[1]) + "×" + std::to_string(b.dims[2]);
        x_low = std::min(x_low, x);
        x_high = std::max(x_high, x);
        for (Line& line : lines) {
            const double y = line.seconds(b);
            if (!(y > 0)) continue;
            line.points.emplace_back(x, y);
            y_low = std::min(y_low, y);
            y_high = std::max(y_high, y);
        }
    }
    y_low = std::pow(10, std::floor(std::log10(y_low)));
    y_high = std::pow(10, std::ceil(std::log10(y_high)));
    constexpr double kWidth = 760, kHeight = 470, kLeft = 80, kRight = 60, kTop = 40, kBottom = 100;
    const auto px = [&](double x) { return kLeft + (x_high > x_low ? std::log(x / x_low) / std::log(x_high / x_low) : 0.5) * (kWidth - kLeft - kRight); };
    const auto py = [&](double y) { return kHeight - kBottom - std::log(y / y_low) / std::log(y_high / y_low) * (kHeight - kTop - kBottom); };
    std::ostringstream s;
    s << "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " << kWidth << " " << kHeight
      << "\" font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n";
    s << "<text x=\"" << kLeft << "\" y=\"22\" font-size=\"14\">" << r.scene << ": seconds over " << (over_views ? "views" : "voxels") << ", "
      << (over_views ? std::to_string(common[0]) + "×" + std::to_string(common[1]) + "×" + std::to_string(common[2]) : std::to_string(common[0]) + " views")
      << ", CPU on " << r.threads << " threads</text>\n";
    for (double y = y_low; y <= y_high * 1.001; y *= 10)
        s << "<line x1=\"" << kLeft << "\" x2=\"" << kWidth - kRight << "\" y1=\"" << py(y) << "\" y2=\"" << py(y) << "\" stroke=\"#ddd\"/><text x=\""
          << kLeft - 8 << "\" y=\"" << py(y) + 4 << "\" text-anchor=\"end\">" << y << " s</text>\n";
    // Labels that would lie on each other take turns on two lines.
    double last_x = -1e9;
    bool low = false;
    for (const auto& [x, label] : ticks) {
        low = px(x) - last_x < 90 && !low;
        last_x = px(x);
        s << "<text x=\"" << px(x) << "\" y=\"" << kHeight - kBottom + (low ? 32 : 18) << "\" text-anchor=\"middle\">" << label << (over_views ? " views" : "")
          << "</text>\n";
    }
    int shown = 0;
    for (Line& line : lines) {
        if (line.points.empty()) continue;
        std::sort(line.points.begin(), line.points.end());
        s << "<polyline fill=\"none\" stroke=\"" << line.colour << "\" stroke-width=\"2\" points=\"";
        for (const auto& [x, y] : line.points) s << px(x) << "," << py(y) << " ";
        s << "\"/>\n";
        for (const auto& [x, y] : line.points) s << "<circle cx=\"" << px(x) << "\" cy=\"" << py(y) << "\" r=\"3\" fill=\"" << line.colour << "\"/>\n";
        s << "<text x=\"" << kLeft - 50 + 245 * (shown % 3) << "\" y=\"" << kHeight - 46 + 16 * (shown / 3) << "\" fill=\"" << line.colour << "\">" << line.name
          << "</text>\n";
        ++shown;
    }
    s << "</svg>\n";
    return s.str();
}

void write_bench_svgs(const BenchResult& result, const std::filesystem::path& file) {
    std::filesystem::path over_views = file;
    over_views.replace_filename(over_views.stem().string() + "_views.svg");
    write_file(file, bench_svg(result, false));
    write_file(over_views, bench_svg(result, true));
}

}  // namespace vdbcarve
