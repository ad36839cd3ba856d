// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/views.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <tuple>
#include <type_traits>

#include "views/formats/camera_formats.h"
#include "views/scene_path.h"
#include "image/exif.h"
#include "image/image_io.h"
#include "views/formats/json_file.h"
#include "base/statistics.h"
#include "base/text.h"
#include "views/view_called.h"

namespace vdbcarve {

namespace fs = std::filesystem;

bool natural_less(const std::string& a, const std::string& b) {
    const auto digit = [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; };
    size_t i = 0, j = 0;
    while (i < a.size() && j < b.size()) {
        if (digit(a[i]) && digit(b[j])) {
            size_t ie = i, je = j;
            while (ie < a.size() && digit(a[ie])) ++ie;
            while (je < b.size() && digit(b[je])) ++je;
            size_t is = i, js = j;
            while (is + 1 < ie && a[is] == '0') ++is;
            while (js + 1 < je && b[js] == '0') ++js;
            if (ie - is != je - js) return ie - is < je - js;
            const int order = a.compare(is, ie - is, b, js, je - js);
            if (order != 0) return order < 0;
            i = ie;
            j = je;
        } else {
            if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]);
            ++i;
            ++j;
        }
    }
    const size_t rest_a = a.size() - i, rest_b = b.size() - j;
    return rest_a != rest_b ? rest_a < rest_b : a < b;  // "img01" and "img1" still have an order
}

namespace {

using io::Importer;
using io::in_scene;

constexpr double kZoomed = 0.02;  ///< of the focal length: more than focusing does

constexpr Importer kTransforms{"transforms.json", io::understands_transforms, io::read_transforms};
constexpr Importer kColmap{"COLMAP", io::understands_colmap, io::read_colmap};
constexpr Importer kMiddlebury{"Middlebury", io::understands_middlebury, io::read_middlebury};
constexpr Importer kProjections{"projection matrices", io::understands_projections, io::read_projections};
constexpr Importer kFileStorage{"OpenCV", io::understands_filestorage, io::read_filestorage};
constexpr Importer kMetashape{"Metashape", io::understands_metashape, io::read_metashape};
constexpr Importer kBundler{"Bundler", io::understands_bundler, io::read_bundler};
constexpr Importer kNvm{"VisualSFM", io::understands_nvm, io::read_nvm};
constexpr Importer kSfm{"OpenMVG or Meshroom", io::understands_sfm, io::read_sfm};
constexpr Importer kRealityCapture{"RealityCapture", io::understands_realitycapture, io::read_realitycapture};
constexpr Importer kMatlab{"MATLAB", io::understands_matlab, io::read_matlab};
constexpr const Importer* kImporters[] = {&kTransforms, &kColmap, &kMiddlebury, &kProjections,    &kFileStorage, &kMetashape,
                                          &kBundler,    &kNvm,    &kSfm,        &kRealityCapture, &kMatlab};

std::string upper_case(std::string text) {
    for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    return text;
}

struct Candidate {
    fs::path path;
    const Importer* importer;
};

std::vector<fs::path> files_ending(const fs::path& folder, const std::string& ending) {
    std::vector<fs::path> out;
    for (const auto& entry : fs::directory_iterator(folder)) {
        const std::string name = entry.path().filename().string();
        if (name.size() >= ending.size() && name.compare(name.size() - ending.size(), ending.size(), ending) == 0) out.push_back(entry.path());
    }
    std::sort(out.begin(), out.end());
    return out;
}

/// None where there is no file and none is needed.
std::optional<Candidate> find_camera_file(const ViewsOptions& options, Progress& progress) {
    if (options.cameras == "none") {
        if (!options.allow_unposed)
            throw UsageError("--cameras none: this needs cameras. Remedy: vdbcarve align SCENE -o OUT, then --cameras OUT/cameras.json");
        return std::nullopt;
    }
    if (!options.cameras.empty()) {
        const fs::path given = in_scene(options.cameras, options.scene);
        if (!fs::exists(given)) throw InputError(given.string() + ": camera file not found");
        for (const Importer* importer : kImporters)
            if (importer->understands(given)) return Candidate{given, importer};
        throw InputError(given.string() +
                         ": not a camera file that is understood (transforms.json, COLMAP folder, *_par.txt, "
                         "3x4 matrices as .pa or text, OpenCV's .yml, .xml or .json, Metashape's .xml, Bundler's .out, VisualSFM's .nvm, OpenMVG's .json, "
                         "Meshroom's .sfm, RealityCapture's .csv, MATLAB's .mat)");
    }
    std::vector<fs::path> candidates;
    for (const char* name : {"transforms.json", "transforms_train.json", "cameras.json", "sfm_data.json", "sparse/0", "sparse", "colmap", "."})
        candidates.push_back(name == std::string(".") ? options.scene : options.scene / name);
    for (const fs::path& f : files_ending(options.scene, "_par.txt")) candidates.push_back(f);
    const std::vector<fs::path> pa = files_ending(options.scene, ".pa");
    if (!pa.empty()) candidates.push_back(pa.front());
    for (const char* ending : {".xml", ".yml", ".yaml", ".mat", ".out", ".nvm", ".sfm", ".csv"})
        for (const fs::path& f : files_ending(options.scene, ending)) candidates.push_back(f);
    for (const fs::path& candidate : candidates) {
        if (!fs::exists(candidate)) continue;
        for (const Importer* importer : kImporters) {
            // A folder holding .pa files would answer for the scene itself before *_par.txt was asked.
            if (candidate == options.scene && importer != &kColmap) continue;
            if (importer->understands(candidate)) return Candidate{candidate, importer};
        }
        // What is called like a camera file and is damaged must not be passed over.
        if (candidate.extension() == ".json" && fs::is_regular_file(candidate)) io::parse_json(candidate);
        if (candidate != options.scene) progress.note(candidate.string() + " is not a camera file that is understood: skipped");
    }
    if (options.allow_unposed) return std::nullopt;
    throw InputError(options.scene.string() +
                     ": no cameras found (looked for transforms.json, transforms_train.json, cameras.json, COLMAP in "
                     "sparse/0, sparse, colmap or the folder itself, *_par.txt, *.pa, *.xml, *.yml, *.mat, *.out, *.nvm, *.sfm, *.csv). Remedy: --cameras "
                     "FILE, or vdbcarve align to find them");
}

/// Finds image files by the names that camera files use.
class ImageFinder {
  public:
    ImageFinder(const ViewsOptions& options, fs::path camera_folder)
        : images_(in_scene(options.images, options.scene)), scene_(options.scene), camera_folder_(std::move(camera_folder)), is_whole_(options.is_whole) {
        if (!images_.empty() && !fs::is_directory(images_)) throw InputError(images_.string() + ": --images is not a folder");
    }

    fs::path find(const std::string& name) const {
        const fs::path n(name);
        std::vector<fs::path> places;
        if (!images_.empty()) places = {images_ / n, images_ / n.filename()};
        else {
            places = {camera_folder_ / n, scene_ / "images" / n, scene_ / n, scene_ / "images" / n.filename(), scene_ / n.filename()};
            if (!subfolder_.empty()) places.insert(places.end(), {subfolder_ / n, subfolder_ / n.filename()});
        }
        for (const fs::path& place : places) {
            if (is_there(place)) return place;
            for (const std::string& ext : io::kPictureExtensions)
                for (const bool shout : {false, true}) {
                    fs::path with = place;
                    with += shout ? upper_case(ext) : ext;
                    if (is_there(with)) return with;
                }
        }
        return {};
    }

    /// If no usual place has the images but exactly one subfolder of the scene has them all, use that.
    bool adopt_subfolder(const std::vector<std::string>& names) {
        if (!images_.empty()) return false;
        std::vector<fs::path> with_all;
        for (const auto& entry : fs::directory_iterator(scene_)) {
            if (!entry.is_directory()) continue;
            subfolder_ = entry.path();
            if (std::all_of(names.begin(), names.end(), [&](const std::string& n) { return !find(n).empty(); })) with_all.push_back(entry.path());
        }
        subfolder_ = with_all.size() == 1 ? with_all.front() : fs::path();
        return !subfolder_.empty();
    }
    fs::path subfolder() const { return subfolder_; }

  private:
    bool is_there(const fs::path& file) const { return fs::is_regular_file(file) && (!is_whole_ || is_whole_(file)); }

    fs::path images_, scene_, camera_folder_, subfolder_;
    std::function<bool(const fs::path&)> is_whole_;
};

fs::path photo_folder(const ViewsOptions& options) {
    const fs::path folder = in_scene(options.images, options.scene);
    if (!folder.empty()) return folder;
    return fs::is_directory(options.scene / "images") ? options.scene / "images" : options.scene;
}

std::vector<std::string> photos_in(const fs::path& folder) {
    if (!fs::is_directory(folder)) throw InputError(folder.string() + ": no such folder");
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder)) {
        if (entry.is_regular_file() && io::is_picture(entry.path())) names.push_back(entry.path().filename().string());
    }
    std::sort(names.begin(), names.end(), natural_less);
    return names;
}

/// What EXIF says of the lens; and where somebody zoomed, which views.
void say_focal_lengths(const Views& views, Progress& progress) {
    const auto share = [](const View& v) { return v.camera.intrinsics.fx / std::max(v.camera.intrinsics.width_px, v.camera.intrinsics.height_px); };
    std::vector<double> shares;
    for (const View& v : views.views) shares.push_back(share(v));
    const double middle = median(shares);
    std::vector<std::string> others;
    for (const View& v : views.views)
        if (std::abs(share(v) / middle - 1) > kZoomed) others.push_back(v.name + " (" + std::to_string(std::lround(36 * share(v))) + " mm)");
    progress.note("focal length from the photographs: " + std::to_string(std::lround(36 * middle)) + " mm on 35 mm film, " +
                  std::to_string(std::lround(views.views.front().camera.intrinsics.fx)) + " px");
    if (!others.empty())
        progress.warn("the lens was zoomed: most photographs say " + std::to_string(std::lround(36 * middle)) + " mm on 35 mm film, not so " + some_of(others) +
                      ". Cameras are found for one lens. Remedy: take these out (or the others, if they are few), or cameras of another program");
}

/// Pictures of several sizes are of several cameras, or were cropped.
void say_sizes(const Views& views, Progress& progress) {
    std::map<std::pair<int, int>, std::vector<std::string>> sizes;
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        sizes[{std::max(k.width_px, k.height_px), std::min(k.width_px, k.height_px)}].push_back(v.name);  // a camera may be held both ways
    }
    if (sizes.size() < 2) return;
    std::string text;
    for (const auto& [size, names] : sizes)
        text += (text.empty() ? "" : "; ") + std::to_string(size.first) + " x " + std::to_string(size.second) + ": " + some_of(names);
    progress.warn("photographs have different sizes: " + text +
                  ". They are taken for the whole pictures of one lens, made smaller; what was cropped, or is another camera's, does not fit. Remedy: pictures "
                  "as they came from the camera");
}

/// Photographs alone, or, where there are none, masks.
Views unposed_views(const ViewsOptions& options, Progress& progress) {
    fs::path folder = photo_folder(options);
    std::vector<std::string> names = photos_in(folder);
    if (names.empty() && options.images.empty() && fs::is_directory(options.scene / "masks")) names = photos_in(folder = options.scene / "masks");
    if (options.is_whole) std::erase_if(names, [&](const std::string& name) { return !options.is_whole(folder / name); });
    if (names.empty()) throw InputError(folder.string() + ": neither cameras nor photographs. Remedy: a folder with photographs, or with images/ or masks/");
    Views out;
    out.posed = false;
    out.format = "photographs";
    out.camera_file = folder;
    out.up = options.up;
    out.units = options.units;
    out.views.resize(names.size());
    size_t known = 0;
    for (size_t i = 0; i < names.size(); ++i) {
        View& v = out.views[i];
        v.name = names[i];
        v.image_path = folder / names[i];
        Intrinsics& k = v.camera.intrinsics;
        std::tie(k.width_px, k.height_px) = io::stored_size(v.image_path);
        v.orientation = io::exif_orientation(v.image_path);
        if (v.orientation >= 5) std::swap(k.width_px, k.height_px);
        k.fx = k.fy = io::exif_focal_px(v.image_path, k.width_px, k.height_px);
        k.cx = 0.5 * k.width_px;
        k.cy = 0.5 * k.height_px;
        known += k.fx > 0;
    }
    // A focal length for some helps nobody: they are compared with each other.
    progress.note(options.scene.string() +
                  (options.cameras == "none" ? ": cameras are to be found (--cameras none)" : ": no camera file: cameras are to be found"));
    if (const auto turned = std::count_if(out.views.begin(), out.views.end(), [](const View& v) { return v.orientation != 1; }); turned > 0)
        progress.note(counted(static_cast<size_t>(turned), "photograph") + " turned as EXIF says");
    if (known < names.size())
        for (View& v : out.views) v.camera.intrinsics.fx = v.camera.intrinsics.fy = 0;
    else say_focal_lengths(out, progress);
    say_sizes(out, progress);
    return out;
}

/// Pictures beside the views' photographs that are none of them, nor called like one (a mask).
std::vector<std::string> without_camera(const std::vector<View>& views, const std::map<fs::path, std::string>& photos) {
    std::set<fs::path> folders;
    std::vector<std::string> out;
    for (const View& v : views) folders.insert(v.image_path.parent_path());
    for (const fs::path& folder : folders)
        for (const std::string& name : fs::is_directory(folder) ? photos_in(folder) : std::vector<std::string>())
            if (!photos.count(folder / name) && std::none_of(views.begin(), views.end(), [&](const View& v) { return is_called_like(name, v.image_path); }))
                out.push_back((folder / name).string());
    return out;
}

/// What the camera file leaves to its photographs: size, orientation, focal length; and the first pixel's centre at (0.5, 0.5).
void settle_view(io::ImportedView& imported, const fs::path& camera_folder, bool integer_centres) {
    View& view = imported.view;
    Intrinsics& k = view.camera.intrinsics;
    if (!view.mask_path.empty() && view.mask_path.is_relative()) view.mask_path = camera_folder / view.mask_path;
    if (k.width_px == 0 || k.height_px == 0 || imported.angle_x_rad > 0 || imported.focal_36mm > 0) {
        const auto [width, height] = io::stored_size(view.image_path);
        if (k.width_px == 0) k.width_px = width;
        if (k.height_px == 0) k.height_px = height;
    }
    // A camera file that gives the size of the turned photograph was made by a program that turned it. (Ours says so.)
    if (view.orientation == 1 && !view.image_path.empty() && k.width_px != k.height_px) {
        const int said = io::exif_orientation(view.image_path);
        if (said >= 5 && io::stored_size(view.image_path) == std::pair{k.height_px, k.width_px}) view.orientation = said;
    }
    if (imported.angle_x_rad > 0) k.fx = k.fy = 0.5 * k.width_px / std::tan(0.5 * imported.angle_x_rad);
    if (imported.focal_36mm > 0) {
        const double per_mm = std::max(k.width_px, k.height_px) / 36.0;
        k.fx = k.fy = imported.focal_36mm * per_mm;
        k.cx = 0.5 * k.width_px + imported.centre_36mm.x() * per_mm;
        k.cy = 0.5 * k.height_px + imported.centre_36mm.y() * per_mm;
    }
    if (k.cx == -1e9) k.cx = 0.5 * k.width_px;
    else if (integer_centres) k.cx += 0.5;
    if (k.cy == -1e9) k.cy = 0.5 * k.height_px;
    else if (integer_centres) k.cy += 0.5;
    // Files written with few digits are orthonormal to those digits only; what is exact stays untouched.
    Mat3d& rotation = view.camera.camera_from_world.rotation;
    if (is_rotation(rotation) && !is_rotation(rotation, 1e-14)) rotation = nearest_rotation(rotation);
}

/// By the photograph, the view whose it is. Throws InputError where it is the one of two views.
std::map<fs::path, std::string> photographs_of(const Views& out) {
    std::map<fs::path, std::string> taken;
    for (const View& v : out.views) {
        if (v.image_path.empty()) continue;
        const auto [other, fresh] = taken.emplace(v.image_path, v.name);
        if (!fresh && other->second != v.name)
            throw InputError(v.image_path.string() + ": is the image of both " + other->second + " and " + v.name + ". Remedy: keep the camera file's folders");
    }
    return taken;
}

/// Cameras without names are those of the photographs in natural order.
void name_by_photographs(io::Imported& imported, const ViewsOptions& options, const fs::path& file) {
    if (!std::all_of(imported.views.begin(), imported.views.end(), [](const io::ImportedView& v) { return v.view.name.empty(); })) return;
    const std::vector<std::string> photos = photos_in(photo_folder(options));
    if (photos.size() != imported.views.size())
        throw InputError(file.string() + ": holds " + std::to_string(imported.views.size()) + " cameras without names, but the scene has " +
                         std::to_string(photos.size()) + " images");
    for (size_t i = 0; i < photos.size(); ++i) imported.views[i].view.name = photos[i];
}

Views load_scene(const ViewsOptions& options, Progress& progress) {
    if (!fs::is_directory(options.scene)) {
        if (fs::is_regular_file(options.scene))
            throw InputError(options.scene.string() +
                             ": is a file; a scene is a folder with photographs, or (reconstruct, align, mask, carve) a film such as .mp4, whose frames "
                             "`vdbcarve mask` puts into a folder in OUT/stages that is a scene");
        throw InputError(options.scene.string() + ": there is no such folder or film");
    }
    const std::optional<Candidate> candidate = find_camera_file(options, progress);
    if (!candidate) return unposed_views(options, progress);
    const Candidate& found = *candidate;
    io::Imported imported = found.importer->read(found.path);
    for (const std::string& n : imported.notes) progress.note(found.path.string() + ": " + n);
    for (const std::string& w : imported.warnings) progress.warn(found.path.string() + ": " + w);
    if (imported.views.empty()) throw InputError(found.path.string() + ": holds no views");
    if (!imported.metric && !options.accept_non_metric)
        throw InputError(found.path.string() +
                         ": these matrices belong to a projective (non-metric) world: pixels far from square or skewed. "
                         "Distances mean nothing in it. Remedy: --accept-non-metric to carve all the same");

    Views out;
    out.camera_file = found.path;
    out.format = found.importer->name;
    out.sittings = imported.sittings;
    out.up = options.up.empty() ? imported.up : options.up;
    out.units = options.units.empty() ? imported.units : options.units;
    if (out.up == imported.up) out.floor = imported.floor;  // a height along the file's own axis
    out.metric = imported.metric;
    out.unverified = imported.unverified;

    name_by_photographs(imported, options, found.path);
    const fs::path camera_folder = fs::is_directory(found.path) ? found.path : found.path.parent_path();
    ImageFinder finder(options, camera_folder);
    std::vector<std::string> names;
    for (const io::ImportedView& v : imported.views) names.push_back(v.view.name);
    const bool none_found = std::all_of(names.begin(), names.end(), [&](const std::string& n) { return finder.find(n).empty(); });
    if (none_found && finder.adopt_subfolder(names)) progress.note("images found in " + finder.subfolder().string());

    const bool integer_centres = options.pixel_centre == PixelCentre::Default ? imported.integer_pixel_centres : options.pixel_centre == PixelCentre::Integer;
    for (io::ImportedView& v : imported.views) {
        View& view = v.view;
        Intrinsics& k = view.camera.intrinsics;
        const std::string where = found.path.string() + ": view " + view.name;
        view.image_path = finder.find(view.name);
        const bool sizes_known = k.width_px > 0 && k.height_px > 0 && v.angle_x_rad == 0 && v.focal_36mm == 0;
        if (view.image_path.empty() && !(options.cameras_only && sizes_known)) {
            if (options.allow_missing) {
                out.left_out.push_back(view.name);
                continue;
            }
            throw InputError(where + ": image not found in " + (options.images.empty() ? options.scene : options.images).string() +
                             " or its images/. Remedy: --images DIR, or --allow-missing to leave such views out");
        }
        settle_view(v, camera_folder, integer_centres);
        if (std::none_of(out.sittings.begin(), out.sittings.end(), [&](const Sitting& x) { return x.id == view.sitting; }))
            throw InputError(where + ": names sitting '" + view.sitting + "', which the file does not describe");
        out.views.push_back(view);
    }
    const std::map<fs::path, std::string> taken = photographs_of(out);
    if (!out.left_out.empty() && !options.is_whole)
        progress.warn(found.path.string() + ": " + counted(out.left_out.size(), "view") + " left out, image not found: " + some_of(out.left_out));
    if (out.views.empty())
        throw InputError(found.path.string() +
                         (options.is_whole ? ": none of its " + counted(out.left_out.size(), "view") + " has a photograph yet" : ": no view has an image"));
    std::stable_sort(out.views.begin(), out.views.end(), [](const View& a, const View& b) { return natural_less(a.name, b.name); });
    for (size_t i = 1; i < out.views.size(); ++i)
        if (out.views[i].name == out.views[i - 1].name) throw InputError(found.path.string() + ": view " + out.views[i].name + " is listed twice");
    check_views(out);
    if (options.is_whole) out.without_camera = without_camera(out.views, taken);
    if (options.is_whole && !out.left_out.empty())
        progress.note(counted(out.left_out.size(), "view") + " of " + found.path.string() + " without a photograph so far");
    return out;
}

bool same_sitting(const Sitting& a, const Sitting& b) {
    return a.scale == b.scale && a.scene_from_sitting.rotation == b.scene_from_sitting.rotation &&
           a.scene_from_sitting.translation == b.scene_from_sitting.translation;
}

/// Takes over the views of another scene that are not there yet.
void add_scene(Views& views, const fs::path& scene, const ViewsOptions& options, Progress& progress) {
    ViewsOptions wanted = options;
    wanted.scene = scene;
    wanted.added.clear();
    std::error_code not_there;
    if (fs::equivalent(scene, options.scene, not_there)) return;  // its views are here, those that came lately too
    if (fs::is_regular_file(scene))
        throw UsageError("--add " + scene.string() +
                         ": is a file; a folder with photographs and cameras of the same world is needed. Remedy, where it is a film: vdbcarve mask FILM, then "
                         "its folder in OUT/stages, with cameras");
    wanted.images.clear();
    if (wanted.cameras != "none") wanted.cameras.clear();
    Views other = load_scene(wanted, progress);
    if (views.posed != other.posed)
        throw InputError(
            (other.posed ? options.scene : scene).string() + ": has no camera file, and " + (other.posed ? scene : options.scene).string() +
            " has: where its photographs were taken from in that world is not known. Remedy: cameras for all of them, or --cameras none to find them all anew");
    const auto differ = [&](const std::string& a, const std::string& b, const char* what) {
        if (!a.empty() && !b.empty() && a != b)
            throw InputError(scene.string() + ": its " + what + " is " + b + ", that of " + options.scene.string() + " " + a +
                             ". They are taken to be one world. Remedy: mend the camera file that is wrong");
    };
    differ(views.units, other.units, "unit");
    differ(views.up, other.up, "up axis");
    std::set<fs::path> photos;
    std::map<std::string, fs::path> names;
    for (const View& v : views.views) {
        if (!v.image_path.empty()) photos.insert(fs::weakly_canonical(v.image_path));
        names.emplace(v.name, v.image_path);
    }
    std::map<std::string, std::string> sitting_of;
    for (Sitting s : other.sittings) {
        const std::string id = s.id;
        const auto same = [&](const Sitting& have) { return have.id == s.id; };
        auto have = std::find_if(views.sittings.begin(), views.sittings.end(), same);
        while (have != views.sittings.end() && !same_sitting(*have, s)) {
            s.id += "'";
            have = std::find_if(views.sittings.begin(), views.sittings.end(), same);
        }
        if (have == views.sittings.end()) views.sittings.push_back(s);
        sitting_of[id] = s.id;
    }
    size_t fresh = 0;
    for (View& v : other.views) {
        if (!v.image_path.empty() && photos.count(fs::weakly_canonical(v.image_path))) continue;
        if (const auto taken = names.find(v.name); taken != names.end())
            throw InputError(v.image_path.string() + ": a view is called " + v.name + " already (" + taken->second.string() +
                             "). Remedy: another name for one of the photographs, also in its camera file");
        v.scene = scene;
        v.sitting = sitting_of[v.sitting];
        views.views.push_back(std::move(v));
        ++fresh;
    }
    if (views.up.empty()) views.up = other.up;
    if (views.units.empty()) views.units = other.units;
    views.left_out.insert(views.left_out.end(), other.left_out.begin(), other.left_out.end());
    std::sort(views.left_out.begin(), views.left_out.end());
    views.left_out.erase(std::unique(views.left_out.begin(), views.left_out.end()), views.left_out.end());
    for (const std::string& why : other.unverified)
        if (std::find(views.unverified.begin(), views.unverified.end(), why) == views.unverified.end()) views.unverified.push_back(why);
    if (fresh) progress.note(counted(fresh, "view") + " more from " + other.camera_file.string() + " (" + other.format + ")");
}

}  // namespace

Views load_views(const ViewsOptions& options, Progress& progress) {
    Views out = load_scene(options, progress);
    for (const fs::path& scene : options.added) add_scene(out, scene, options, progress);
    if (options.added.empty()) return out;
    std::stable_sort(out.views.begin(), out.views.end(), [](const View& a, const View& b) { return natural_less(a.name, b.name); });
    if (!out.posed) {  // a focal length for some helps nobody
        const bool known = std::all_of(out.views.begin(), out.views.end(), [](const View& v) { return v.camera.intrinsics.fx > 0; });
        for (View& v : out.views)
            if (!known) v.camera.intrinsics.fx = v.camera.intrinsics.fy = 0;
    }
    return out;
}

void check_views(const Views& views) {
    if (views.views.empty()) throw InputError(views.camera_file.string() + ": no views");
    for (const Sitting& s : views.sittings)
        if (!(s.scale > 0) || !std::isfinite(s.scale) || !is_rotation(s.scene_from_sitting.rotation) || !s.scene_from_sitting.translation.allFinite())
            throw InputError(views.camera_file.string() + ": sitting '" + s.id + "': its scale must be > 0 and its transform rigid");
    for (const View& view : views.views) {
        const Intrinsics& k = view.camera.intrinsics;
        const Rigid3& pose = view.camera.camera_from_world;
        std::string bad;
        const auto say = [&](const std::string& what) { bad += (bad.empty() ? "" : "; ") + what; };
        const auto number = [&](const char* name, double value, bool positive) {
            if (!std::isfinite(value)) say(std::string(name) + " is " + std::to_string(value));
            else if (positive && value <= 0) say(std::string(name) + " is " + std::to_string(value) + ", must be > 0");
        };
        number("fx", k.fx, true);
        number("fy", k.fy, true);
        number("skew", k.skew, false);
        number("cx", k.cx, false);
        number("cy", k.cy, false);
        if (k.width_px < 2 || k.height_px < 2 || k.width_px > 65536 || k.height_px > 65536)
            say("image size " + std::to_string(k.width_px) + " x " + std::to_string(k.height_px) + " is not within 2..65536");
        for (int i = 0; i < 3; ++i) number(("t" + std::to_string(i + 1)).c_str(), pose.translation[i], false);
        if (!pose.rotation.allFinite()) {
            for (int i = 0; i < 9; ++i)
                if (!std::isfinite(pose.rotation(i / 3, i % 3)))
                    say("r" + std::to_string(i / 3 + 1) + std::to_string(i % 3 + 1) + " is " + std::to_string(pose.rotation(i / 3, i % 3)));
        } else if (pose.rotation.determinant() < 0) {
            say("its rotation is left-handed (determinant " + std::to_string(pose.rotation.determinant()) +
                "): a camera cannot be mirrored; export with a right-handed world");
        } else if (!is_rotation(pose.rotation)) {
            say("its rotation is not orthonormal (determinant " + std::to_string(pose.rotation.determinant()) + ")");
        }
        for (double c : view.lens.coefficients) number("lens coefficient", c, false);
        if (!bad.empty()) throw InputError(views.camera_file.string() + ": view " + view.name + ": " + bad);
    }
}

namespace {

/// The photograph as its camera would have taken it without distortion, of whatever kind `read` returns.
template <class Read>
auto straightened(const View& view, const Read& read) {
    auto photo = read(view.image_path, view.orientation);
    const Intrinsics& k = view.camera.intrinsics;
    const auto [width, height] = [&] {
        if constexpr (std::is_same_v<decltype(photo), Photo>) return std::pair{view_of(photo).width(), view_of(photo).height()};
        else return std::pair{photo.width, photo.height};
    }();
    if (width != k.width_px || height != k.height_px) throw InputError(other_size(view.image_path.string(), width, height, view.name, k.width_px, k.height_px));
    if (!view.lens.distorts()) return photo;
    if constexpr (std::is_same_v<decltype(photo), Photo>) return io::undistort(photo, k, view.lens);
    else return io::undistort(photo, k, view.lens, nullptr);
}

}  // namespace

Photo load_photo(const View& view) { return straightened(view, io::read_photo); }

Image8 load_photo8(const View& view) { return straightened(view, io::read_photo8); }

}  // namespace vdbcarve
