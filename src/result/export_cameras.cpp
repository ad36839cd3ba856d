// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/export_cameras.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cctype>
#include <iomanip>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>

#include "base/atomic_file.h"
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

/// The photograph's name in the exported set; folders only where names need them.
std::vector<std::string> names_for(const Views& views, bool undistort) {
    std::set<std::string> bases;
    for (const View& v : views.views) bases.insert(fs::path(v.name).stem().string());
    const bool unique = bases.size() == views.views.size();
    std::vector<std::string> out;
    for (const View& v : views.views) {
        fs::path name = v.image_path.empty() ? fs::path(v.name) : fs::path(v.name).parent_path() / v.image_path.filename();
        if (unique) name = name.filename();
        if (undistort) name.replace_extension(is_lossy(v.image_path) ? ".jpg" : ".png");
        out.push_back(name.generic_string());
    }
    return out;
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

void write_pictures(const Views& views, const std::vector<std::string>& names, const fs::path& folder, const CameraExportOptions& options, Progress& progress) {
    std::vector<std::string> masks = mask_names(views);
    progress.begin("undistort", views.views.size());
    tbb::parallel_for(size_t{0}, views.views.size(), [&](size_t i) {
        const fs::path file = folder / "images" / names[i];
        make_folder(file.parent_path());
        const Image8 picture = load_photo8(views.views[i]);
        const auto bytes = file.extension() == ".jpg" && picture.channels != 4 ? io::encode_jpeg(picture, kJpegQuality, 0) : io::encode_png(picture);
        write_file(file, bytes.data(), bytes.size());
        if (const fs::path mask = options.masks / masks[i]; !options.masks.empty() && fs::exists(mask)) {
            fs::path to = folder / "masks" / names[i];
            to += ".png";
            make_folder(to.parent_path());
            place_copy(mask, to);
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
    cameras << "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
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

void write_transforms(const Views& views, const std::vector<std::string>& names, const fs::path& file, const CameraExportOptions& options) {
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
        if (options.undistort && fs::exists(folder / "masks" / (names[i] + ".png"))) f["mask_path"] = "masks/" + names[i] + ".png";
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
    std::vector<std::string> unused;
    for (const View& v : all.views)
        if (!v.unused.empty()) unused.push_back(v.name + " (" + v.unused + ")");
    std::erase_if(views.views, [](const View& v) { return !v.unused.empty(); });
    if (!unused.empty()) progress.warn(counted(unused.size(), "view") + " left out, as the camera file says not to use: " + some_of(unused));
    check(views, options, progress);
    const std::vector<std::string> names = names_for(views, options.undistort);
    const bool transforms = target.extension() == ".json";
    const fs::path folder = transforms ? (target.has_parent_path() ? target.parent_path() : fs::path(".")) : target;
    if (options.undistort) write_pictures(views, names, folder, options, progress);
    if (transforms) write_transforms(views, names, target, options);
    else write_colmap(views, names, folder, options);
}

}  // namespace vdbcarve
