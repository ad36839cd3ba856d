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

#include "io_cameras.h"
#include "io_exif.h"
#include "io_image.h"

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

std::pair<int, int> image_size(const fs::path& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(file.string() + ": cannot be opened");
    std::array<unsigned char, 26> head{};
    in.read(reinterpret_cast<char*>(head.data()), head.size());
    const auto big = [&](size_t at) { return (head[at] << 24) | (head[at + 1] << 16) | (head[at + 2] << 8) | head[at + 3]; };
    if (in && head[0] == 0x89 && head[1] == 'P' && head[2] == 'N' && head[3] == 'G') return {big(16), big(20)};
    // Everything else through the decoder (JPEG headers are not simple: EXIF may turn the picture).
    const Image8 image = io::read_image8(file);
    return {image.width, image.height};
}

namespace {

using io::Importer;
using io::in_scene;

constexpr Importer kTransforms{"transforms.json", io::understands_transforms, io::read_transforms};
constexpr Importer kColmap{"COLMAP", io::understands_colmap, io::read_colmap};
constexpr Importer kMiddlebury{"Middlebury", io::understands_middlebury, io::read_middlebury};
constexpr Importer kProjections{"projection matrices", io::understands_projections, io::read_projections};
constexpr Importer kFileStorage{"OpenCV", io::understands_filestorage, io::read_filestorage};
constexpr Importer kMetashape{"Metashape", io::understands_metashape, io::read_metashape};
constexpr Importer kBundler{"Bundler", io::understands_bundler, io::read_bundler};
constexpr Importer kNvm{"VisualSFM", io::understands_nvm, io::read_nvm};
constexpr const Importer* kImporters[] = {&kTransforms, &kColmap, &kMiddlebury, &kProjections, &kFileStorage, &kMetashape, &kBundler, &kNvm};

struct Candidate {
    fs::path path;
    const Importer* importer;
};

std::vector<fs::path> files_ending(const fs::path& folder, const std::string& ending) {
    std::vector<fs::path> out;
    for (const auto& entry : fs::directory_iterator(folder)) {
        const std::string name = entry.path().filename().string();
        if (name.size() >= ending.size() && name.compare(name.size() - ending.size(), ending.size(), ending) == 0)
            out.push_back(entry.path());
    }
    std::sort(out.begin(), out.end());
    return out;
}

/// None where there is no file and none is needed.
std::optional<Candidate> find_camera_file(const ViewsOptions& options, Progress& progress) {
    if (options.cameras == "none") {
        if (!options.allow_unposed) throw UsageError("--cameras none: this needs cameras. Remedy: vdbcarve align SCENE -o OUT, then --cameras OUT/cameras.json");
        return std::nullopt;
    }
    if (!options.cameras.empty()) {
        const fs::path given = in_scene(options.cameras, options.scene);
        if (!fs::exists(given)) throw InputError(given.string() + ": camera file not found");
        for (const Importer* importer : kImporters)
            if (importer->understands(given)) return Candidate{given, importer};
        throw InputError(given.string() +
                         ": not a camera file that is understood (transforms.json, COLMAP folder, *_par.txt, "
                         "3x4 matrices as .pa or text, OpenCV's .yml, .xml or .json, Metashape's .xml, Bundler's .out, VisualSFM's .nvm)");
    }
    std::vector<fs::path> candidates;
    for (const char* name : {"transforms.json", "transforms_train.json", "cameras.json", "sparse/0", "sparse", "colmap", "."})
        candidates.push_back(name == std::string(".") ? options.scene : options.scene / name);
    for (const fs::path& f : files_ending(options.scene, "_par.txt")) candidates.push_back(f);
    const std::vector<fs::path> pa = files_ending(options.scene, ".pa");
    if (!pa.empty()) candidates.push_back(pa.front());
    for (const char* ending : {".xml", ".yml", ".yaml", ".out", ".nvm"})
        for (const fs::path& f : files_ending(options.scene, ending)) candidates.push_back(f);
    for (const fs::path& candidate : candidates) {
        if (!fs::exists(candidate)) continue;
        for (const Importer* importer : kImporters) {
            // A folder holding .pa files would answer for the scene itself before *_par.txt was asked.
            if (candidate == options.scene && importer != &kColmap) continue;
            if (importer->understands(candidate)) return Candidate{candidate, importer};
        }
        if (candidate != options.scene) progress.note(candidate.string() + " is not a camera file that is understood: skipped");
    }
    if (options.allow_unposed) return std::nullopt;
    throw InputError(options.scene.string() +
                     ": no cameras found (looked for transforms.json, transforms_train.json, cameras.json, COLMAP in "
                     "sparse/0, sparse, colmap or the folder itself, *_par.txt, *.pa, *.xml, *.yml, *.out, *.nvm). Remedy: --cameras FILE, or vdbcarve align to find them");
}

/// Finds image files by the names that camera files use.
class ImageFinder {
  public:
    ImageFinder(const ViewsOptions& options, fs::path camera_folder)
        : images_(in_scene(options.images, options.scene)), scene_(options.scene), camera_folder_(std::move(camera_folder)) {
        if (!images_.empty() && !fs::is_directory(images_))
            throw InputError(images_.string() + ": --images is not a folder");
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
            if (fs::is_regular_file(place)) return place;
            for (const char* ext : {".png", ".jpg", ".jpeg", ".JPG", ".JPEG", ".PNG", ".tif", ".tiff", ".ppm", ".pgm", ".bmp", ".webp"}) {
                fs::path with = place;
                with += ext;
                if (fs::is_regular_file(with)) return with;
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
            if (std::all_of(names.begin(), names.end(), [&](const std::string& n) { return !find(n).empty(); }))
                with_all.push_back(entry.path());
        }
        subfolder_ = with_all.size() == 1 ? with_all.front() : fs::path();
        return !subfolder_.empty();
    }
    fs::path subfolder() const { return subfolder_; }

  private:
    fs::path images_, scene_, camera_folder_, subfolder_;
};

fs::path photo_folder(const ViewsOptions& options) {
    const fs::path folder = in_scene(options.images, options.scene);
    if (!folder.empty()) return folder;
    return fs::is_directory(options.scene / "images") ? options.scene / "images" : options.scene;
}

std::vector<std::string> photos_in(const fs::path& folder) {
    if (!fs::is_directory(folder)) throw InputError(folder.string() + ": no such folder");
    std::vector<std::string> names;
    static const std::set<std::string> extensions{".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm", ".pgm", ".bmp", ".webp"};
    for (const auto& entry : fs::directory_iterator(folder)) {
        std::string ext = entry.path().extension().string();
        std::transform(ext.begin(), ext.end(), ext.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
        if (entry.is_regular_file() && extensions.count(ext)) names.push_back(entry.path().filename().string());
    }
    std::sort(names.begin(), names.end(), natural_less);
    return names;
}

/// Photographs alone, or, where there are none, masks.
Views unposed_views(const ViewsOptions& options, Progress& progress) {
    fs::path folder = photo_folder(options);
    std::vector<std::string> names = photos_in(folder);
    if (names.empty() && options.images.empty() && fs::is_directory(options.scene / "masks")) names = photos_in(folder = options.scene / "masks");
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
        std::tie(k.width_px, k.height_px) = image_size(v.image_path);
        k.fx = k.fy = io::exif_focal_px(v.image_path, k.width_px, k.height_px);
        k.cx = 0.5 * k.width_px;
        k.cy = 0.5 * k.height_px;
        known += k.fx > 0;
    }
    // A focal length for some helps nobody: they are compared with each other.
    progress.note(options.scene.string() + (options.cameras == "none" ? ": cameras are to be found (--cameras none)" : ": no camera file: cameras are to be found"));
    if (known < names.size())
        for (View& v : out.views) v.camera.intrinsics.fx = v.camera.intrinsics.fy = 0;
    else progress.note("focal length from the photographs: " + std::to_string(std::lround(out.views.front().camera.intrinsics.fx)) + " px");
    return out;
}

}  // namespace

Views load_views(const ViewsOptions& options, Progress& progress) {
    if (!fs::is_directory(options.scene)) {
        if (fs::is_regular_file(options.scene))
            throw InputError(options.scene.string() + ": is a file; a scene is a folder with photographs (video is not read yet)");
        throw InputError(options.scene.string() + ": no such folder");
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

    const bool nameless = std::all_of(imported.views.begin(), imported.views.end(),
                                      [](const io::ImportedView& v) { return v.view.name.empty(); });
    if (nameless) {
        const std::vector<std::string> photos = photos_in(photo_folder(options));
        if (photos.size() != imported.views.size())
            throw InputError(found.path.string() + ": holds " + std::to_string(imported.views.size()) +
                             " cameras without names, but the scene has " + std::to_string(photos.size()) + " images");
        for (size_t i = 0; i < photos.size(); ++i) imported.views[i].view.name = photos[i];
    }

    const fs::path camera_folder = fs::is_directory(found.path) ? found.path : found.path.parent_path();
    ImageFinder finder(options, camera_folder);
    std::vector<std::string> names;
    for (const io::ImportedView& v : imported.views) names.push_back(v.view.name);
    const bool none_found =
        std::all_of(names.begin(), names.end(), [&](const std::string& n) { return finder.find(n).empty(); });
    if (none_found && finder.adopt_subfolder(names))
        progress.note("images found in " + finder.subfolder().string());

    const bool integer_centres = options.pixel_centre == PixelCentre::Default ? imported.integer_pixel_centres
                                                                              : options.pixel_centre == PixelCentre::Integer;
    for (io::ImportedView& v : imported.views) {
        View& view = v.view;
        Intrinsics& k = view.camera.intrinsics;
        const std::string where = found.path.string() + ": view " + view.name;
        view.image_path = finder.find(view.name);
        const bool sizes_known = k.width_px > 0 && k.height_px > 0 && v.angle_x_rad == 0;
        if (view.image_path.empty() && !(options.cameras_only && sizes_known)) {
            if (options.allow_missing) {
                out.left_out.push_back(view.name);
                progress.warn(where + ": image not found; the view is left out");
                continue;
            }
            throw InputError(where + ": image not found in " + (options.images.empty() ? options.scene : options.images).string() +
                             " or its images/. Remedy: --images DIR, or --allow-missing to leave such views out");
        }
        if (!view.mask_path.empty() && view.mask_path.is_relative()) view.mask_path = camera_folder / view.mask_path;
        if (k.width_px == 0 || k.height_px == 0 || v.angle_x_rad > 0) {
            const auto [width, height] = image_size(view.image_path);
            if (k.width_px == 0) k.width_px = width;
            if (k.height_px == 0) k.height_px = height;
        }
        if (v.angle_x_rad > 0) k.fx = k.fy = 0.5 * k.width_px / std::tan(0.5 * v.angle_x_rad);
        if (k.cx == -1e9) k.cx = 0.5 * k.width_px;
        else if (integer_centres) k.cx += 0.5;
        if (k.cy == -1e9) k.cy = 0.5 * k.height_px;
        else if (integer_centres) k.cy += 0.5;
        if (std::none_of(out.sittings.begin(), out.sittings.end(), [&](const Sitting& x) { return x.id == view.sitting; }))
            throw InputError(where + ": names sitting '" + view.sitting + "', which the file does not describe");
        // Files written with few digits are orthonormal to those digits only; what is exact stays untouched.
        Mat3d& rotation = view.camera.camera_from_world.rotation;
        if (is_rotation(rotation) && !is_rotation(rotation, 1e-14)) rotation = nearest_rotation(rotation);
        out.views.push_back(view);
    }
    std::map<fs::path, std::string> taken;
    for (const View& v : out.views) {
        if (v.image_path.empty()) continue;
        const auto [other, fresh] = taken.emplace(v.image_path, v.name);
        if (!fresh && other->second != v.name)
            throw InputError(v.image_path.string() + ": is the image of both " + other->second + " and " + v.name + ". Remedy: keep the camera file's folders");
    }
    if (out.views.empty()) throw InputError(found.path.string() + ": no view has an image");
    std::stable_sort(out.views.begin(), out.views.end(),
                     [](const View& a, const View& b) { return natural_less(a.name, b.name); });
    for (size_t i = 1; i < out.views.size(); ++i)
        if (out.views[i].name == out.views[i - 1].name)
            throw InputError(found.path.string() + ": view " + out.views[i].name + " is listed twice");
    check_views(out);
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
        for (int i = 0; i < 3; ++i)
            number(("t" + std::to_string(i + 1)).c_str(), pose.translation[i], false);
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

Photo load_photo(const View& view) {
    Photo photo = io::read_photo(view.image_path);
    const Intrinsics& k = view.camera.intrinsics;
    const PhotoView size = view_of(photo);
    if (size.width() != k.width_px || size.height() != k.height_px)
        throw InputError(view.image_path.string() + ": has " + std::to_string(size.width()) + " x " + std::to_string(size.height()) + " pixels, the camera of view " + view.name + " " + std::to_string(k.width_px) + " x " +
                         std::to_string(k.height_px));
    return view.lens.distorts() ? io::undistort(photo, view.camera.intrinsics, view.lens) : photo;
}

}  // namespace vdbcarve
