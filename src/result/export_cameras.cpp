// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/export_cameras.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cctype>
#include <fstream>
#include <iomanip>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "base/atomic_file.h"
#include "base/output_names.h"
#include "image/image_io.h"
#include "base/text.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/error.h"
#include "vdbcarve/file_frame.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

constexpr size_t kMostPoints = 100000;
constexpr int kJpegQuality = 96;

bool is_lossy(const fs::path& file) {
    std::string extension = file.extension().string();
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return extension == ".jpg" || extension == ".jpeg" || extension == ".heic" || extension == ".heif" || extension == ".webp" || extension == ".avif";
}

/// Without the folders that all names begin with.
void remove_common_folder(std::vector<std::string>& names) {
    fs::path common = fs::path(names.front()).parent_path();
    for (const std::string& name : names) {
        const fs::path folder = fs::path(name).parent_path();
        fs::path both;
        for (auto a = common.begin(), b = folder.begin(); a != common.end() && b != folder.end() && *a == *b; ++a, ++b) both /= *a;
        common = both;
    }
    if (common.empty()) return;
    for (std::string& name : names) name = fs::path(name).lexically_relative(common).generic_string();
}

/// The photograph's name in the exported set; folders only where names need them. What is written (`undistort`) gets a name inside images/, whatever the camera
/// file calls it; a photograph that stays where it is keeps the camera file's name.
std::vector<std::string> names_for(const Views& views, bool undistort) {
    std::set<std::string> bases;
    for (const View& v : views.views) bases.insert(fs::path(v.name).stem().string());
    const bool unique = bases.size() == views.views.size();
    std::vector<std::string> out;
    bool leave_folder = false;
    for (const View& v : views.views) {
        fs::path name = v.image_path.empty() ? fs::path(v.name) : fs::path(v.name).parent_path() / v.image_path.filename();
        if (unique) name = name.filename();
        if (undistort) name.replace_extension(is_lossy(v.image_path) ? ".jpg" : ".png");
        leave_folder |= name.is_absolute() || std::find(name.begin(), name.end(), fs::path("..")) != name.end();
        out.push_back(name.generic_string());
    }
    if (!undistort) return out;
    if (leave_folder) remove_common_folder(out);  // ring1/0001.jpg, not home/user/photos/ring1/0001.jpg
    return output_names(out, Folders::Kept);
}

void check(const Views& views, const CameraExportOptions& options, Progress& progress) {
    std::vector<std::string> turned, missing;
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        if (k.orthographic)
            throw InputError(views.camera_file.string() + ": view " + v.name + " is a parallel projection, which neither COLMAP nor transforms.json has");
        if (std::abs(k.skew) > 1e-9 * k.fx)
            throw InputError(views.camera_file.string() + ": view " + v.name + " has skewed pixels (" + std::to_string(k.skew) +
                             "), which neither COLMAP nor transforms.json has");
        if (v.orientation != 1) turned.push_back(v.name);
        if (v.image_path.empty()) missing.push_back(v.name);
    }
    if (options.undistort && !missing.empty())
        throw InputError("--undistort: the photographs of " + counted(missing.size(), "view") + " are not there: " + some_of(missing) +
                         ". Remedy: --images DIR");
    if (!options.undistort && !turned.empty())
        progress.warn("cameras of " + counted(turned.size(), "view") + " belong to the photograph turned as its EXIF says, which not every program does: " +
                      some_of(turned) + ". Remedy: --undistort, which writes them turned");
    if (!views.unverified.empty()) progress.warn("these cameras are UNVERIFIED: " + some_of(views.unverified));
}

/// What write_pictures() writes for a view.
struct Pictures {
    fs::path photo, mask, mask_from;  ///< the last two empty where there is no mask
};

std::vector<Pictures> pictures_to_write(const std::vector<std::string>& names, const std::vector<std::string>& masks, const fs::path& folder,
                                        const CameraExportOptions& options) {
    std::vector<Pictures> out(names.size());
    for (size_t i = 0; i < names.size(); ++i) {
        out[i].photo = folder / "images" / names[i];
        if (options.masks.empty() || !fs::exists(options.masks / masks[i])) continue;
        out[i].mask_from = options.masks / masks[i];
        out[i].mask = folder / "masks" / (names[i] + ".png");
    }
    return out;
}

/// The first line of our cameras.txt, by which an earlier export of ours is known.
constexpr const char* kColmapHead = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]";

/// Throws OutputError where the folder holds a COLMAP model of somebody else's.
void check_model(const fs::path& model) {
    std::string first;
    std::getline(std::ifstream(model / "cameras.txt"), first);
    for (const char* file : {"cameras.txt", "images.txt", "points3D.txt", "cameras.bin", "images.bin", "points3D.bin"})
        if (first != kColmapHead && fs::exists(model / file))
            throw OutputError((model / file).string() + ": is of a model that vdbcarve did not write. Remedy: another -o");
}

/// Throws OutputError where the export would replace photographs, masks or cameras, or mix its own with those of the scene.
void check_target(const Views& views, const std::vector<Pictures>& pictures, const fs::path& target, const CameraExportOptions& options) {
    const bool transforms = target.extension() == ".json";
    const auto folder_of = [](const fs::path& file) { return file.has_parent_path() ? file.parent_path() : fs::path("."); };
    const fs::path folder = transforms ? folder_of(target) : target, model = folder / "sparse" / "0";
    FilesRead read;
    std::set<fs::path> photos, masks;
    for (const View& v : views.views) {
        read.add(v.image_path);
        read.add(v.mask_path);
        if (!v.image_path.empty()) photos.insert(folder_of(v.image_path));
        if (!v.mask_path.empty()) masks.insert(folder_of(v.mask_path));
    }
    read.add(views.camera_file);
    read.add(options.masks);
    if (!options.masks.empty()) masks.insert(options.masks);
    const auto refuse_where = [&](const std::set<fs::path>& inputs, std::initializer_list<fs::path> written) {
        for (const fs::path& place : written)
            for (const fs::path& input : inputs)
                if (is_same_place(input, place))
                    throw OutputError(target.string() + ": the export would write into " + input.string() + ", which it reads from. Remedy: another -o");
    };
    if (options.undistort || !transforms) refuse_where(photos, {folder, folder / "images"});
    if (options.undistort) refuse_where(masks, {folder / "masks"});
    if (!transforms && !views.camera_file.empty()) refuse_where({views.camera_file, folder_of(views.camera_file)}, {folder, folder / "sparse", model});
    for (const Pictures& p : pictures)
        for (const fs::path& file : {p.photo, p.mask}) read.refuse(file);
    if (transforms) read.refuse(target);
    else check_model(model);
}

void write_pictures(const Views& views, const std::vector<Pictures>& pictures, Progress& progress) {
    progress.begin("undistort", views.views.size());
    tbb::parallel_for(size_t{0}, views.views.size(), [&](size_t i) {
        const Pictures& to = pictures[i];
        make_folder(to.photo.parent_path());
        const Image8 picture = load_photo8(views.views[i]);
        const auto bytes = to.photo.extension() == ".jpg" && picture.channels != 4 ? io::encode_jpeg(picture, kJpegQuality, 0) : io::encode_png(picture);
        write_file(to.photo, bytes.data(), bytes.size());
        if (!to.mask.empty()) {
            make_folder(to.mask.parent_path());
            place_copy(to.mask_from, to.mask);
        }
        progress.step();
    });
}

struct ColmapModel {
    std::string name;
    std::vector<double> parameters;
};

ColmapModel colmap_model(const Intrinsics& k, const Lens& lens) {
    std::vector<double> p{k.fx, k.fy, k.cx, k.cy};
    const auto with = [&](const char* name, size_t count) {
        std::vector<double> c = lens.coefficients;
        c.resize(count, 0);
        p.insert(p.end(), c.begin(), c.end());
        return ColmapModel{name, p};
    };
    if (!lens.distorts()) return {"PINHOLE", p};
    switch (lens.model) {
        case Lens::Model::OpenCVFisheye:
            return with("OPENCV_FISHEYE", 4);
        case Lens::Model::FullOpenCV:
            return with("FULL_OPENCV", 8);
        default:
            return with("OPENCV", 4);  // of which the radial ones have the first terms
    }
}

void write_colmap(const Views& views, const std::vector<std::string>& names, const fs::path& folder, const CameraExportOptions& options) {
    const std::vector<Camera> posed = views.cameras();
    std::ostringstream cameras, images, points;
    for (std::ostringstream* out : {&cameras, &images, &points}) *out << std::setprecision(17);
    cameras << kColmapHead << "\n";
    images << "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n";
    points << "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n";
    std::map<std::string, size_t> known;  // one camera for all photographs that share it
    for (size_t i = 0; i < posed.size(); ++i) {
        const Intrinsics& k = posed[i].intrinsics;
        const ColmapModel model = colmap_model(k, options.undistort ? Lens() : views.views[i].lens);
        std::ostringstream text;
        text << std::setprecision(17) << model.name << " " << k.width_px << " " << k.height_px;
        for (const double p : model.parameters) text << " " << p;
        const auto [camera, fresh] = known.emplace(text.str(), known.size() + 1);
        if (fresh) cameras << camera->second << " " << camera->first << "\n";
        const Eigen::Quaterniond q(posed[i].camera_from_world.rotation);
        const Vec3d& t = posed[i].camera_from_world.translation;
        images << i + 1 << " " << q.w() << " " << q.x() << " " << q.y() << " " << q.z() << " " << t.x() << " " << t.y() << " " << t.z() << " " << camera->second
               << " " << names[i] << "\n\n";
    }
    const Mesh& m = options.points;
    const size_t every = std::max<size_t>(1, (m.vertices.size() + kMostPoints - 1) / kMostPoints);
    for (size_t v = 0, id = 1; v < m.vertices.size(); v += every, ++id) {
        const auto& p = m.vertices[v];
        points << id << " " << p[0] << " " << p[1] << " " << p[2];
        for (size_t c = 0; c < 3; ++c) points << " " << (m.colors.empty() ? 128 : static_cast<int>(srgb8_from_linear(m.colors[v][c])));
        points << " 0\n";
    }
    const fs::path model = folder / "sparse" / "0";
    make_folder(model);
    write_file(model / "cameras.txt", cameras.str());
    write_file(model / "points3D.txt", points.str());
    write_file(model / "images.txt", images.str());
}

void write_transforms(const Views& views, const std::vector<std::string>& names, const std::vector<Pictures>& pictures, const fs::path& file,
                      const CameraExportOptions& options) {
    Views out = views;
    const FileFrame z_up = file_frame(".ply", {views.up, "", views.up.empty() ? Dcc::None : Dcc::Blender, false});
    Mat3d turn;
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) turn(r, c) = z_up.axes[static_cast<size_t>(r)][static_cast<size_t>(c)];
    const std::vector<Camera> posed = views.cameras();
    const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
    for (size_t i = 0; i < posed.size(); ++i) {
        View& v = out.views[i];
        v.camera = posed[i];
        v.camera.camera_from_world.rotation = posed[i].camera_from_world.rotation * turn.transpose();
        v.sitting = "0";
        if (options.undistort) {
            v.lens = {};
            v.orientation = 1;
        }
    }
    out.sittings = {Sitting{}};
    nlohmann::json j = nlohmann::json::parse(cameras_json(out));
    j.erase("vdbcarve");
    std::set<std::string> models;
    for (size_t i = 0; i < posed.size(); ++i) {
        nlohmann::json& f = j["frames"][i];
        f.erase("vdbcarve");
        const fs::path& photo = views.views[i].image_path;
        f["file_path"] = options.undistort ? "images/" + names[i] : photo.empty() ? views.views[i].name : fs::proximate(photo, folder).generic_string();
        if (options.undistort && !pictures[i].mask.empty()) f["mask_path"] = "masks/" + names[i] + ".png";
        models.insert(f["camera_model"].get<std::string>());
    }
    if (models.size() == 1) j["camera_model"] = *models.begin() == "PINHOLE" ? "OPENCV" : *models.begin();  // nerfstudio has no pinhole of its own
    if (turn != Mat3d::Identity()) {
        j["applied_transform"] = nlohmann::json::array();
        for (int r = 0; r < 3; ++r) j["applied_transform"].push_back({turn(r, 0), turn(r, 1), turn(r, 2), 0.0});
    }
    make_folder(folder);
    write_file(file, j.dump(1) + "\n");
}

}  // namespace

void export_cameras(const Views& all, const fs::path& target, const CameraExportOptions& options, Progress& progress) {
    Views views = all;
    views.views.clear();
    std::vector<std::string> unused, masks, masks_of_all = mask_names(all);  // a view that is not used has a mask, too
    for (size_t i = 0; i < all.views.size(); ++i) {
        const View& v = all.views[i];
        if (v.unused.empty()) {
            views.views.push_back(v);
            masks.push_back(masks_of_all[i]);
        } else {
            unused.push_back(v.name + " (" + v.unused + ")");
        }
    }
    if (!unused.empty()) progress.warn(counted(unused.size(), "view") + " left out, as the camera file says not to use: " + some_of(unused));
    check(views, options, progress);
    const std::vector<std::string> names = names_for(views, options.undistort);
    const bool transforms = target.extension() == ".json";
    const fs::path folder = transforms ? (target.has_parent_path() ? target.parent_path() : fs::path(".")) : target;
    const std::vector<Pictures> pictures = options.undistort ? pictures_to_write(names, masks, folder, options) : std::vector<Pictures>();
    check_target(views, pictures, target, options);
    if (options.undistort) write_pictures(views, pictures, progress);
    if (transforms) write_transforms(views, names, pictures, target, options);
    else write_colmap(views, names, folder, options);
}

}  // namespace vdbcarve
