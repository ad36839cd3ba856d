// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/app/bundle.h"

#include <openvdb/version.h>
#include <sys/utsname.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/core/version.hpp>
#include <thread>

#include "base/atomic_file.h"
#include "image/image_io.h"
#include "pipeline/out_folder.h"
#include "result/result_json.h"
#include "base/memory.h"
#include "base/tar_gz.h"
#include "vdbcarve/backend.h"
#include "vdbcarve/error.h"
#include "vdbcarve/pipeline.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/app/report.h"
#include "vdbcarve/version.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

std::string versions() {
    json out{{"vdbcarve", kVersion},    {"openvdb", OPENVDB_LIBRARY_VERSION_STRING},      {"opencv", CV_VERSION},
             {"compiler", __VERSION__}, {"threads", std::thread::hardware_concurrency()}, {"memory_bytes", machine_memory_bytes()}};
    utsname system{};
    if (uname(&system) == 0) out["system"] = std::string(system.sysname) + " " + system.release + " " + system.machine;
    std::ifstream release("/etc/os-release");
    for (std::string line; std::getline(release, line);)
        if (line.rfind("PRETTY_NAME=", 0) == 0) out["distribution"] = line.substr(12);
    out["cuda"] = why_no_cuda();
    for (const DeviceInfo& d : cuda_devices()) out["devices"].push_back({{"name", d.name}, {"memory_bytes", d.memory_bytes}});
    return out.dump(1) + "\n";
}

/// Of a folder that need not be there.
std::vector<fs::path> sorted_files(const fs::path& folder) {
    std::vector<fs::path> out;
    if (fs::is_directory(folder))
        for (const auto& entry : fs::directory_iterator(folder))
            if (entry.is_regular_file()) out.push_back(entry.path());
    std::sort(out.begin(), out.end());
    return out;
}

constexpr const char* kReadMe = R"(A bundle that `vdbcarve bundle` made.

report.json, report.html   what came of the run, where it was finished
config.toml                its options
failure/                   of the last run, where it was not finished: what it ended with, its options and cameras
unverified/                cameras that were found and are not to be trusted, and why
versions.json              of program, libraries and machine
scene/                     masks and cameras; lenses are removed, pictures made smaller and cameras with them

The run again, as far as masks and cameras decide it:

    vdbcarve reconstruct scene -o out

with the options of config.toml for grid, carving and result. What masks ignored is not here.
)";

/// What the run says about itself.
void add_run(TarGz& archive, const fs::path& result, const BundleOptions& options) {
    for (const char* name : {"report.json", "config.toml"})
        if (fs::exists(result / name)) archive.add(name, read_file(result / name));
    if (fs::exists(result / "stages" / "failure.json"))
        for (const char* name : {"failure.json", "failure.toml", "cameras.json"})
            if (fs::exists(result / "stages" / name)) archive.add(std::string("failure/") + name, read_file(result / "stages" / name));
    for (const fs::path& left : sorted_files(result / pipeline::kUnverified)) {
        const bool shows_photographs = left.extension() == ".png" && left.filename() != "energy_map.png";
        if (options.photos || !shows_photographs) archive.add("unverified/" + left.filename().string(), read_file(left));
    }
}

/// A mask, and the view that it is of (or null): its camera without lens, and its photograph. The view is changed to what the archive has of it.
void add_view(TarGz& archive, const std::string& name, const fs::path& mask_file, View* view, const BundleOptions& options, Progress& progress) {
    Image8 mask = io::read_image8(mask_file);
    const double factor = options.width_px > 0 ? std::min(1.0, static_cast<double>(options.width_px) / mask.width) : 1.0;
    int width = static_cast<int>(std::lround(factor * mask.width)), height = static_cast<int>(std::lround(factor * mask.height));
    const Camera as_it_is = view ? view->camera : Camera();
    if (view) {
        view->camera = scaled(view->camera, factor);
        width = view->camera.intrinsics.width_px;
        height = view->camera.intrinsics.height_px;
    }
    const auto smaller = [&](Image8 image) { return image.width == width && image.height == height ? image : io::downscale(image.view(), width, height); };
    if (view && options.photos && !view->image_path.empty()) {
        View whole = *view;
        whole.camera = as_it_is;
        view->image_path.clear();
        try {
            const auto jpeg = io::encode_jpeg(smaller(load_photo8(whole)).view(), 88, 0);
            view->image_path = "images/" + fs::path(name).stem().string() + ".jpg";
            archive.add("scene/" + view->image_path.string(), {reinterpret_cast<const char*>(jpeg.data()), jpeg.size()});
        } catch (const InputError& e) {
            progress.note(std::string("without a photograph: ") + e.what());
        }
    }
    if (view && (!options.photos || view->image_path.empty())) view->image_path = "masks/" + name;
    const auto png = io::encode_png(smaller(std::move(mask)));
    archive.add("scene/masks/" + name, {reinterpret_cast<const char*>(png.data()), png.size()});
    if (view) {
        view->lens = {};
        view->orientation = 1;
        view->name = view->image_path.string();
    }
}

/// Files by their name in OUT/masks.
std::map<std::string, fs::path> masks_of_last_run(const fs::path& result) {
    std::map<std::string, fs::path> out;
    const json named = parse_or_empty(result / kUnfinishedMasks);
    for (const auto& [name, where] : named.items())
        if (where.is_string()) out[name] = result / where.get<std::string>();
    if (out.empty())
        for (const fs::path& mask : sorted_files(result / "masks"))
            if (mask.extension() == ".png") out[mask.filename().string()] = mask;
    return out;
}

}  // namespace

size_t bundle(const fs::path& result, const fs::path& file, const BundleOptions& options, Progress& progress) {
    if (!fs::is_directory(result))
        throw InputError(result.string() +
                         ": no such folder. Remedy: the folder given to reconstruct as -o; of a run that ended before it made one, what the program said is "
                         "all there is to send");
    if (!fs::exists(result / kMarker)) throw InputError(result.string() + ": was not made by vdbcarve. Remedy: the folder given to reconstruct as -o");
    if (options.width_px < 0) throw UsageError("bundle: masks cannot be " + std::to_string(options.width_px) + " pixels wide");
    const std::string said = file.filename().string();
    if (!said.ends_with(".tar.gz") && !said.ends_with(".tgz")) throw UsageError(file.string() + ": a bundle is a .tar.gz. Remedy: -o NAME.tar.gz");
    TarGz archive("vdbcarve-bundle");
    archive.add("README.txt", kReadMe);
    archive.add("versions.json", versions());
    add_run(archive, result, options);

    const std::map<std::string, fs::path> masks = masks_of_last_run(result);
    if (masks.empty())
        throw InputError((result / "masks").string() +
                         ": holds no masks: the run ended before there were any. Remedy: send config.toml and what the program said");
    Views views;
    std::vector<std::string> names;
    try {
        // Masks are the last run's; so are its cameras, where it had got as far as that.
        views = fs::exists(result / "stages" / "cameras.json") ? last_views(result, options.images, progress) : result_views(result, options.images, progress);
        names = mask_names(views);
    } catch (const InputError& e) {
        progress.note(std::string("without cameras: ") + e.what());  // masks alone are a scene, too
    }
    progress.begin("bundle", masks.size() + 1);
    std::vector<View> kept;
    for (const auto& [name, mask_file] : masks) {
        const auto found = std::find(names.begin(), names.end(), name);
        View* view = found == names.end() ? nullptr : &views.views[static_cast<size_t>(found - names.begin())];
        add_view(archive, name, mask_file, view, options, progress);
        if (view) kept.push_back(*view);
        progress.step();
    }
    if (!kept.empty()) {
        views.views = kept;
        archive.add("scene/cameras.json", cameras_json(views, "."));
    }
    if (fs::exists(result / "report.html")) {
        ReportOptions page;
        page.images = options.images;
        page.photos = options.photos;
        page.most_faces = 60'000;
        page.most_bytes = 6'000'000;
        try {
            archive.add("report.html", report_html(result, page, progress));
        } catch (const InputError& e) {
            progress.note(std::string("without report.html: ") + e.what());
        }
    }
    progress.step();
    return archive.write(file);
}

}  // namespace vdbcarve
