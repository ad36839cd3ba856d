// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/app/report.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/atomic_file.h"
#include "mesh/gltf.h"
#include "image/image_io.h"
#include "base/text.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/decimate.h"
#include "vdbcarve/error.h"
#include "vdbcarve/file_frame.h"
#include "vdbcarve/result.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/render.h"
#include "vdbcarve/version.h"
#include "vdbcarve/views.h"

#if defined(VDBCARVE_WITH_VIEWER)
extern "C" const char vdbcarve_viewer_begin[], vdbcarve_viewer_end[];
#endif

namespace vdbcarve {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

std::string escaped(const std::string& text) {
    std::string out;
    for (const char c : text) {
        if (c == '<') out += "&lt;";
        else if (c == '>') out += "&gt;";
        else if (c == '&') out += "&amp;";
        else if (c == '"') out += "&quot;";
        else out += c;
    }
    return out;
}

std::string base64(const uint8_t* bytes, size_t size) {
    static const char* const digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string out;
    out.reserve((size + 2) / 3 * 4);
    for (size_t i = 0; i < size; i += 3) {
        const uint32_t b =
            static_cast<uint32_t>(bytes[i]) << 16 | (i + 1 < size ? static_cast<uint32_t>(bytes[i + 1]) << 8 : 0) | (i + 2 < size ? bytes[i + 2] : 0);
        out += digits[b >> 18];
        out += digits[b >> 12 & 63];
        out += i + 1 < size ? digits[b >> 6 & 63] : '=';
        out += i + 2 < size ? digits[b & 63] : '=';
    }
    return out;
}

std::string data_uri(const char* type, const std::vector<uint8_t>& bytes) {
    return std::string("data:") + type + ";base64," + base64(bytes.data(), bytes.size());
}

std::string bytes_text(double bytes) {
    return bytes >= 1e9 ? text_of("%.2f GB", bytes / 1e9) : bytes >= 1e6 ? text_of("%.0f MB", bytes / 1e6) : text_of("%.0f kB", bytes / 1e3);
}

/// Thousands set apart.
std::string count_text(double n) {
    std::string digits = text_of("%.0f", n);
    for (size_t at = digits.size(); at > 3; at -= 3) digits.insert(at - 3, "\u202f");
    return digits;
}

/// A number as people read it; other values as JSON has them.
std::string value_text(const json& v) {
    if (v.is_string()) return v.get<std::string>();
    if (v.is_number_integer()) return count_text(v.get<double>());
    if (v.is_number()) return text_of("%.6g", v.get<double>());
    if (v.is_boolean()) return v.get<bool>() ? "yes" : "no";
    if (v.is_null()) return "–";
    if (v.is_array() && v.size() <= 6 && std::none_of(v.begin(), v.end(), [](const json& e) { return e.is_structured(); })) {
        std::string out;
        for (const json& e : v) out += (out.empty() ? "" : ", ") + value_text(e);
        return out;
    }
    return v.is_array() ? std::to_string(v.size()) + " entries" : v.dump();
}

constexpr double kGood_iou = 0.98, kWeak_iou = 0.9;
const char* grade(bool used, double iou) { return !used ? "unused" : iou >= kGood_iou ? "good" : iou >= kWeak_iou ? "fair" : "bad"; }

struct SeenView {
    std::string name, mask_origin;
    bool used = false;
    double iou = 0, p95_px = 0;
    const View* view = nullptr;  ///< null: without a camera
    size_t number = 0;           ///< among the result's
};

class Page {
  public:
    Page(const fs::path& result, const ReportOptions& options, Progress& progress, const Mesh* mesh)
        : result_(result), options_(options), progress_(progress), given_(mesh) {}

    std::string html() {
        load();
        progress_.begin("report", seen_.size() + 2);
        const fs::path whole = fs::absolute(result_).lexically_normal();
        body_ << "<header><h1>" << escaped((whole.has_filename() ? whole : whole.parent_path()).filename().string()) << "</h1><p class=sub>"
              << escaped(report_["scene"].value("folder", "")) << "</p></header>\n";
        contradiction();
        summary();
        warnings();
        const size_t model_at = static_cast<size_t>(body_.tellp());
        depths();
        photographs();
        orbit();
        stages();
        figures();
        settings();
        body_ << "<footer>vdbcarve " << escaped(report_.value("version", "")) << "</footer>\n";
        const std::string text = body_.str();
        const std::string start = text.substr(0, model_at), rest = text.substr(model_at);
        return head() + start + model(start.size() + rest.size()) + rest + "</main></body></html>\n";
    }

  private:
    void load() {
        const fs::path file = result_ / "report.json";
        if (!fs::exists(file)) throw InputError(file.string() + ": is not there. Remedy: the folder of a result, which `vdbcarve reconstruct` makes");
        try {
            std::ifstream in(file);
            report_ = json::parse(in);
        } catch (const json::exception& e) {
            throw InputError(file.string() + ": " + e.what());
        }
        if (!report_.contains("mesh") || !report_.contains("views"))
            throw InputError(file.string() + ": is not of a finished reconstruct. Remedy: `vdbcarve reconstruct` with the same -o goes on");
        if (!given_) {
            fs::path mesh_file;
            for (const char* name : {"mesh.ply", "mesh.glb", "mesh.obj", "mesh.stl"})
                if (mesh_file.empty() && fs::exists(result_ / name)) mesh_file = result_ / name;
            if (mesh_file.empty()) throw InputError(result_.string() + ": holds no mesh of vdbcarve's");
            read_ = in_frame(read_mesh(mesh_file), inverse(frame_from_scene(result_, mesh_file.filename().string())));
        }
        faces_ = mesh().triangles.size();
        views_ = result_views(result_, options_.images, progress_);
        cameras_ = views_.cameras();
        if (views_.up.empty()) views_.up = report_["cameras"].value("up", "");
        std::map<std::string, size_t> number;
        // cameras.json leaves folders out of names where that leaves them unique.
        for (size_t i = 0; i < views_.views.size(); ++i) number[views_.views[i].name] = i;
        const auto find = [&](const std::string& name) {
            const auto whole = number.find(name);
            return whole != number.end() ? whole : number.find(fs::path(name).filename().string());
        };
        for (const json& v : report_["views"]) {
            SeenView s;
            s.name = v.value("name", "");
            s.used = v.value("used", false);
            s.iou = v.value("silhouette_iou", 0.0);
            s.p95_px = v.value("contour_p95_px", 0.0);
            s.mask_origin = v.value("mask", "");
            if (const auto found = find(s.name); found != number.end()) {
                s.number = found->second;
                s.view = &views_.views[s.number];
            }
            seen_.push_back(s);
        }
        std::stable_sort(seen_.begin(), seen_.end(),
                         [](const SeenView& a, const SeenView& b) { return std::pair(!a.used, a.iou) < std::pair(!b.used, b.iou); });
    }

    static std::string head() {
        std::string out = R"(<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>vdbcarve report</title>
<style>
:root{color-scheme:light dark;--bg:#fff;--fg:#1d2126;--dim:#667080;--card:#f4f5f7;--line:#dfe3e8;--good:#2a8f4d;--fair:#b97a00;--bad:#c8372d;--accent:#2f6fde}
@media(prefers-color-scheme:dark){:root{--bg:#14171b;--fg:#e6e9ee;--dim:#98a2b0;--card:#1e2329;--line:#323a44;--good:#4cc274;--fair:#e0a63a;--bad:#f0665b;--accent:#77a6ff}}
*{box-sizing:border-box}body{margin:0;background:var(--bg);color:var(--fg);font:15px/1.5 system-ui,sans-serif}main{max-width:1200px;margin:0 auto;padding:16px}
h1{margin:.2em 0 0;font-size:1.7em;overflow-wrap:anywhere}h2{margin:1.6em 0 .5em;font-size:1.2em}.sub,footer,small{color:var(--dim);overflow-wrap:anywhere}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:10px;margin-top:14px}.tile{background:var(--card);border-radius:8px;padding:10px 12px}.tile b{display:block;font-size:1.25em}
.warn{border-left:4px solid var(--fair);background:var(--card);padding:8px 12px;margin:8px 0;border-radius:0 8px 8px 0;overflow-wrap:anywhere}.wrong{border-color:var(--bad)}.warn i{display:block;color:var(--dim)}
model-viewer,.poster{width:100%;height:min(70vh,640px);background:var(--card);border-radius:8px;display:block}.poster{object-fit:contain}
.photos{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,270px),1fr));gap:12px}.photos figure{margin:0;background:var(--card);border-radius:8px;overflow:hidden}.photos img{width:100%;display:block}
figcaption{padding:6px 10px;overflow-wrap:anywhere}.good{color:var(--good)}.fair{color:var(--fair)}.bad{color:var(--bad)}.unused{color:var(--dim)}
.scroll{overflow-x:auto}table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:4px 10px;border-bottom:1px solid var(--line);vertical-align:top}td.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
.bar{background:var(--accent);height:.8em;border-radius:3px;min-width:1px}svg{width:100%;height:auto;background:var(--card);border-radius:8px}svg text{fill:var(--dim);font:13px system-ui,sans-serif}
.two{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,340px),1fr));gap:12px}pre{background:var(--card);padding:12px;border-radius:8px;overflow-x:auto}summary{cursor:pointer;font-weight:600}footer{margin:2.5em 0 1em}
.key span{display:inline-block;width:1.6em;height:.35em;vertical-align:middle;margin:0 .3em 0 1em;border-radius:2px}
</style>
)";
#if defined(VDBCARVE_WITH_VIEWER)
        out += "<script>";
        out.append(vdbcarve_viewer_begin, vdbcarve_viewer_end);
        out += "</script>\n";
#endif
        return out + "</head><body><main>\n";
    }

    void tile(const std::string& what, const std::string& value, const std::string& kind = "") {
        body_ << "<div class=tile><small>" << what << "</small><b class=\"" << kind << "\">" << value << "</b></div>";
    }

    void summary() {
        const json& mesh = report_["mesh"];
        double seconds = 0;
        for (const json& s : report_["stages"]) seconds += s.value("seconds", 0.0);
        size_t used = 0;
        for (const SeenView& v : seen_) used += v.used;
        const double median = report_["silhouette_iou"].value("median", 0.0), least = report_["silhouette_iou"].value("minimum", 0.0);
        body_ << "<div class=tiles>";
        tile("silhouettes agree (IoU, median)", text_of("%.4f", median), grade(true, median));
        tile("the worst view", text_of("%.4f", least), grade(true, least));
        tile("views", std::to_string(used) + (used < seen_.size() ? " of " + std::to_string(seen_.size()) : ""));
        tile("mesh", mesh.value("manifold", false) ? "closed" : "NOT closed", mesh.value("manifold", false) ? "good" : "bad");
        tile("faces", count_text(mesh.value("faces", 0.0)));
        if (report_.contains("grid") && report_["grid"].contains("dims")) {
            const auto d = report_["grid"]["dims"];
            tile("voxels", text_of("%d × %d × %d", d[0].get<int>(), d[1].get<int>(), d[2].get<int>()));
        }
        tile("time", text_of("%.1f s", seconds));
        tile("memory", bytes_text(report_.value("peak_rss_bytes", 0.0)));
        body_ << "</div>\n";
    }

    void contradiction() {
        const std::string text = report_.value("contradiction", "");
        if (!text.empty()) body_ << "<div class=\"warn wrong\"><b class=bad>Cameras and masks contradict each other</b><br>" << escaped(text) << "</div>\n";
    }

    void warnings() {
        const auto all = report_.value("warnings", std::vector<std::string>());
        if (all.empty()) return;
        body_ << "<h2>Warnings</h2>\n";
        for (const std::string& w : all) {
            const size_t at = w.find(". Remedy: ");
            body_ << "<div class=warn>" << escaped(w.substr(0, at)) << (at == std::string::npos ? "" : "<i>Remedy: " + escaped(w.substr(at + 10)) + "</i>")
                  << "</div>\n";
        }
    }

    /// The model, and a picture of it for where there is no viewer, or no script.
    std::string model(size_t bytes_so_far) {
        std::ostringstream out;
        out << "<h2>The model</h2>\n";
        Box3d box;
        for (const auto& v : mesh().vertices) box.extend(Vec3d(v[0], v[1], v[2]));
        RenderOptions o;
        o.background.reset();
        o.color = options_.photos;
        o.up = up_direction(views_.up, cameras_);
        OrbitView from;
        from.width_px = 960;
        from.height_px = 640;
        const Image8 picture = render(mesh(), orbit_camera(box, o.up, from), o);
        const std::string poster = data_uri("image/png", io::encode_png(picture));
        progress_.step();
        if (!report_has_viewer() || options_.most_faces == 0) {
            out << "<img class=poster alt=\"the model\" src=\"" << poster << "\">\n<p><small>"
                << (report_has_viewer()
                        ? "A picture only, as was asked for."
                        : "This vdbcarve was built without the 3-D viewer (model-viewer, from npm): a picture instead; mesh.glb opens in any 3-D program.")
                << "</small></p>\n";
            return out.str();
        }
        const Eigen::Quaterniond upright = Eigen::Quaterniond::FromTwoVectors(o.up, Vec3d::UnitY());  // as the viewer has it
        Mesh small;
        std::string uri;
        for (size_t faces = options_.most_faces;; faces = faces * 2 / 3) {
            if (faces_ > 4 * faces) {  // decimating takes 4 us a face
                small = simplified_for_display(mesh(), faces);
            } else {
                small = mesh();
                if (faces_ > faces) decimate(small, {faces, 0, 60}, progress_);
            }
            small.normals.clear();
            if (!options_.photos) small.colors.clear();
            for (auto& v : small.vertices) {
                const Vec3d p = upright * (Vec3d(v[0], v[1], v[2]) - box.center());
                v = {static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z())};
            }
            std::ostringstream glb;
            write_glb(glb, small, result_ / "report.html");
            const std::string bytes = glb.str();
            uri = "data:model/gltf-binary;base64," + base64(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size());
            if (bytes_so_far + poster.size() + uri.size() + 1'200'000 <= options_.most_bytes || faces < 2000) break;
        }
        out << "<model-viewer camera-controls touch-action=pan-y interaction-prompt=none shadow-intensity=0.6 tone-mapping=neutral alt=\"the model\" poster=\""
            << poster << "\" src=\"" << uri << "\"></model-viewer>\n<noscript><img class=poster alt=\"the model\" src=\"" << poster
            << "\"></noscript>\n<p><small>Drag to turn, wheel or two fingers to come nearer."
            << (small.triangles.size() < faces_
                    ? " " + count_text(static_cast<double>(small.triangles.size())) + " of " + count_text(static_cast<double>(faces_)) + " faces."
                    : "")
            << "</small></p>\n";
        return out.str();
    }

    static bool on_edge(const Image8& m, int x, int y) {
        if (m.at(x, y) < 128) return false;
        return x == 0 || y == 0 || x + 1 == m.width || y + 1 == m.height || m.at(x - 1, y) < 128 || m.at(x + 1, y) < 128 || m.at(x, y - 1) < 128 ||
               m.at(x, y + 1) < 128;
    }

    /// The photograph, with the mask's and the hull's contours.
    Image8 overlay(const SeenView& v) {
        const Intrinsics& k = cameras_[v.number].intrinsics;
        const Camera camera = scaled(cameras_[v.number], std::min(1.0, static_cast<double>(options_.photo_width_px) / k.width_px));
        const int width = camera.intrinsics.width_px, height = camera.intrinsics.height_px;
        Image8 out(width, height, 3, 24);
        Image8 photo;
        if (options_.photos && !v.view->image_path.empty()) {
            try {
                photo = io::downscale(load_photo8(*v.view).view(), width, height);
            } catch (const InputError& e) {
                progress_.warn(std::string(e.what()) + "; the report shows it black");
            }
        }
        Image8 mask;
        if (const fs::path file = result_ / "masks" / mask_names_[v.number]; fs::exists(file))
            mask = io::downscale(io::read_image8(file).view(), width, height);
        const Image8 hull = silhouette_of(mesh(), camera);
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                if (!photo.empty())
                    for (int c = 0; c < 3; ++c) out.at(x, y, c) = photo.at(x, y, photo.channels >= 3 ? c : 0);
                const auto set = [&](int r, int g, int b) {
                    out.at(x, y, 0) = static_cast<uint8_t>(r), out.at(x, y, 1) = static_cast<uint8_t>(g), out.at(x, y, 2) = static_cast<uint8_t>(b);
                };
                if (!mask.empty() && mask.channels == 1 && on_edge(mask, x, y)) set(70, 230, 90);
                if (on_edge(hull, x, y)) set(255, 60, 200);
            }
        return out;
    }

    /// What stereo drew.
    void depths() {
        const fs::path file = result_ / "stereo.png";
        if (!report_.contains("stereo") || !fs::exists(file)) return;
        const json& s = report_["stereo"];
        if (!s.value("used", true)) return;
        body_ << "<h2>Concavities</h2>\n<p>"
              << text_of(
                     "%.0f %% of the object's pixels have a depth that other views bear out; depths took %.2f %% off the hull's volume. Orange surface was "
                     "carved by depth; grey surface is where the hull stands.",
                     100 * s.value("trusted_share", 0.0), 100 * (1 - s.value("volume", 0.0) / std::max(s.value("volume_before", 1.0), 1e-300)))
              << "</p>\n<div class=scroll><img style=\"width:100%;min-width:640px\" alt=\"photographs, their depths, and where these carved the hull\" src=\""
              << data_uri("image/jpeg", io::encode_jpeg(io::read_image8(file).view(), 85, 0)) << "\"></div>\n";
    }

    void photographs() {
        mask_names_ = mask_names(views_);
        std::vector<const SeenView*> shown;
        for (const SeenView& v : seen_)
            if (v.view && shown.size() < options_.most_photos) shown.push_back(&v);
        std::vector<std::string> uris(shown.size());
        tbb::parallel_for(size_t{0}, shown.size(), [&](size_t i) {
            progress_.check();
            uris[i] = data_uri("image/jpeg", io::encode_jpeg(overlay(*shown[i]).view(), 82, 0));
            progress_.step();
        });
        body_ << "<h2>Photographs, worst first</h2>\n<p class=key><span style=\"background:#ff3cc8\"></span>the model's contour<span "
                 "style=\"background:#46e65a\"></span>the mask's, where they differ</p>\n<div class=photos>\n";
        for (size_t i = 0; i < shown.size(); ++i) {
            const SeenView& v = *shown[i];
            body_ << "<figure><img loading=lazy alt=\"" << escaped(v.name) << "\" src=\"" << uris[i] << "\"><figcaption>" << escaped(v.name)
                  << "<br><b class=" << grade(v.used, v.iou) << ">" << (v.used ? text_of("IoU %.4f", v.iou) : "not used") << "</b> <small>"
                  << (v.used ? text_of("contours within %.1f px (95 %%)", v.p95_px) : "") << "</small></figcaption></figure>\n";
        }
        body_ << "</div>\n";
        const auto with_camera = static_cast<size_t>(std::count_if(seen_.begin(), seen_.end(), [](const SeenView& v) { return v.view != nullptr; }));
        if (shown.size() < with_camera) body_ << "<p><small>" << with_camera - shown.size() << " more views are in report.json.</small></p>\n";
        if (with_camera < seen_.size())
            body_ << "<p><small>" << counted(seen_.size() - with_camera, "view") << " of the camera file without a photograph.</small></p>\n";
    }

    /// From above and from the side.
    void orbit() {
        if (cameras_.empty()) return;
        const Vec3d up = up_direction(views_.up, cameras_), first = std::fabs(up.x()) > 0.9 ? Vec3d::UnitY() : Vec3d::UnitX(),
                    x = (first - first.dot(up) * up).normalized(), y = up.cross(x);
        Box3d box;
        for (const auto& v : mesh().vertices) box.extend(Vec3d(v[0], v[1], v[2]));
        const Vec3d middle = box.center();
        double reach = 0.5 * box.diagonal().norm();
        for (const SeenView& v : seen_)
            if (v.view && !cameras_[v.number].intrinsics.orthographic) reach = std::max(reach, (cameras_[v.number].centre_world() - middle).norm());
        const double scale = 180 / reach;
        // The model itself, thinned to a few thousand points.
        const size_t every = std::max<size_t>(1, mesh().vertices.size() / 3000);
        body_ << "<h2>Cameras</h2>\n<div class=two>\n";
        for (const bool above : {true, false}) {
            const auto place = [&](const Vec3d& p) {
                const Vec3d d = p - middle;
                return Vec2d(200 + scale * d.dot(x), 200 - scale * d.dot(above ? y : up));
            };
            body_ << "<svg viewBox=\"0 0 400 420\" role=img><path fill=none stroke=currentColor stroke-opacity=.25 stroke-width=1.5 stroke-linecap=round d=\"";
            for (size_t n = 0; n < mesh().vertices.size(); n += every) {
                const auto& v = mesh().vertices[n];
                const Vec2d p = place(Vec3d(v[0], v[1], v[2]));
                body_ << text_of("M%.1f %.1fh0", p.x(), p.y());
            }
            body_ << "\"/>\n";
            for (const SeenView& v : seen_) {
                if (!v.view || cameras_[v.number].intrinsics.orthographic) continue;
                const Camera& c = cameras_[v.number];
                const Vec2d from = place(c.centre_world()), to = place(c.centre_world() + 0.12 * reach * c.forward_world());
                body_ << text_of("<g class=%s><title>%s", grade(v.used, v.iou), escaped(v.name).c_str())
                      << (v.used ? text_of(", IoU %.4f", v.iou) : ", not used")
                      << text_of("</title><path stroke=currentColor d=\"M%.1f %.1fL%.1f %.1f\"/><circle cx=%.1f cy=%.1f r=4 fill=currentColor /></g>\n",
                                 from.x(), from.y(), to.x(), to.y(), from.x(), from.y());
            }
            body_ << "<text x=8 y=412>" << (above ? "from above" : "from the side") << "</text></svg>\n";
        }
        body_ << "</div>\n<p><small>" << escaped(report_["cameras"].value("file", "")) << " (" << escaped(report_["cameras"].value("format", ""))
              << ")</small></p>\n";
    }

    void stages() {
        double longest = 1e-9;
        for (const json& s : report_["stages"]) longest = std::max(longest, s.value("seconds", 0.0));
        body_ << "<h2>Stages</h2>\n<div class=scroll><table><tr><th>stage<th>seconds<th style=\"width:40%\"><th>memory<th>where</tr>\n";
        for (const json& s : report_["stages"])
            body_ << "<tr><td>" << escaped(s.value("name", "")) << "<td class=n>" << text_of("%.2f", s.value("seconds", 0.0))
                  << "<td><div class=bar style=\"width:" << text_of("%.1f", 100 * s.value("seconds", 0.0) / longest) << "%\"></div><td class=n>"
                  << bytes_text(s.value("peak_rss_bytes", 0.0)) << "<td>" << (s.value("reused", false) ? "already there" : escaped(s.value("backend", "")))
                  << "</tr>\n";
        body_ << "</table></div>\n";
    }

    void figures() {
        body_ << "<h2>Figures</h2>\n<div class=two>\n";
        for (const char* part : {"mesh", "grid", "color", "filter", "fair", "slack", "extrapolated", "floor", "align", "smooth"}) {
            if (!report_.contains(part)) continue;
            body_ << "<div class=scroll><table><tr><th colspan=2>" << part << "</tr>\n";
            for (const auto& [key, value] : report_[part].items()) {
                if (value.is_object() || (value.is_array() && value.size() > 6)) continue;
                std::string words = key;
                std::replace(words.begin(), words.end(), '_', ' ');
                body_ << "<tr><td>" << escaped(words) << "<td class=n style=\"white-space:normal\">" << escaped(value_text(value)) << "</tr>\n";
            }
            body_ << "</table></div>\n";
        }
        body_ << "</div>\n";
    }

    void settings() {
        const std::string text = fs::exists(result_ / "config.toml") ? read_file(result_ / "config.toml") : "";
        if (!text.empty())
            body_ << "<h2>Settings</h2>\n<details><summary>config.toml, which repeats the run</summary><pre>" << escaped(text) << "</pre></details>\n";
    }

    const fs::path result_;
    const ReportOptions& options_;
    Progress& progress_;
    json report_;
    const Mesh* given_;
    Mesh read_;  ///< where none was given
    /// In the scene's frame.
    const Mesh& mesh() const { return given_ ? *given_ : read_; }
    size_t faces_ = 0;
    Views views_;
    std::vector<Camera> cameras_;
    std::vector<std::string> mask_names_;
    std::vector<SeenView> seen_;  ///< worst first, those not used last
    std::ostringstream body_;
};

}  // namespace

bool report_has_viewer() {
#if defined(VDBCARVE_WITH_VIEWER)
    return true;
#else
    return false;
#endif
}

std::string report_html(const fs::path& result, const ReportOptions& options, Progress& progress, const Mesh* mesh) {
    return Page(result, options, progress, mesh).html();
}

size_t write_report(const fs::path& result, const fs::path& file, const ReportOptions& options, Progress& progress, const Mesh* mesh) {
    const std::string html = report_html(result, options, progress, mesh);
    write_file(file, html);
    return html.size();
}

}  // namespace vdbcarve
