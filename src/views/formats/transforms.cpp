// SPDX-License-Identifier: Apache-2.0
// transforms.json (nerfstudio, instant-ngp, NeRF synthetic) and our own cameras.json, which extends it.
// camera-to-world 4x4 in OpenGL axes (y up, looking along -z); pixel centres at (0.5, 0.5).
#include <set>

#include "base/atomic_file.h"
#include "views/formats/json_file.h"

namespace vdbcarve::io {
namespace {

using nlohmann::json;

/// Frame value, else the file's, else the fallback.
double number(const json& frame, const json& top, const char* key, double fallback) {
    for (const json* j : {&frame, &top}) {
        const auto it = j->find(key);
        if (it == j->end() || it->is_null()) continue;
        if (!it->is_number()) throw InputError(std::string("'") + key + "' is not a number");
        return it->get<double>();
    }
    return fallback;
}

Mat4d matrix(const json& rows, const char* key) {
    Mat4d m = Mat4d::Identity();
    if (!rows.is_array() || (rows.size() != 3 && rows.size() != 4)) throw InputError(std::string("'") + key + "' is not a 3x4 or 4x4 matrix");
    for (size_t r = 0; r < rows.size(); ++r) {
        if (!rows[r].is_array() || rows[r].size() != 4) throw InputError(std::string("'") + key + "' has a row without 4 numbers");
        for (size_t c = 0; c < 4; ++c) {
            // JSON has no NaN; writers put null or a string there.
            m(static_cast<int>(r), static_cast<int>(c)) = rows[r][c].is_number() ? rows[r][c].get<double>() : std::numeric_limits<double>::quiet_NaN();
        }
    }
    return m;
}

Lens lens_of(const json& frame, const json& top) {
    const auto get = [&](const char* key) { return number(frame, top, key, 0.0); };
    std::string model;
    for (const json* j : {&top, &frame})
        if (j->contains("camera_model") && (*j)["camera_model"].is_string()) model = (*j)["camera_model"];
    Lens lens;
    const bool fisheye = model == "OPENCV_FISHEYE" || get("is_fisheye") != 0;
    if (fisheye) {
        lens.model = Lens::Model::OpenCVFisheye;
        lens.coefficients = {get("k1"), get("k2"), get("k3"), get("k4")};
        return lens;
    }
    if (!model.empty() && model != "OPENCV" && model != "PINHOLE" && model != "SIMPLE_PINHOLE" && model != "FULL_OPENCV" && model != "SIMPLE_RADIAL" &&
        model != "RADIAL" && model != "ORTHOGRAPHIC")
        throw InputError("camera_model " + model + " is not supported (supported: PINHOLE, OPENCV, FULL_OPENCV, OPENCV_FISHEYE)");
    const double k1 = get("k1"), k2 = get("k2"), k3 = get("k3"), k4 = get("k4"), k5 = get("k5"), k6 = get("k6");
    const double p1 = get("p1"), p2 = get("p2");
    if (k3 != 0 || k4 != 0 || k5 != 0 || k6 != 0) {
        if (k4 != 0 && model != "FULL_OPENCV") throw InputError("k4 is set without camera_model FULL_OPENCV or OPENCV_FISHEYE: which lens is meant?");
        lens.model = Lens::Model::FullOpenCV;
        lens.coefficients = {k1, k2, p1, p2, k3, k4, k5, k6};
    } else if (k1 != 0 || k2 != 0 || p1 != 0 || p2 != 0) {
        lens.model = Lens::Model::OpenCV;
        lens.coefficients = {k1, k2, p1, p2};
    }
    return lens;
}

const Mat3d& flip_yz() {
    static const Mat3d m = Vec3d(1, -1, -1).asDiagonal();
    return m;
}

Rigid3 camera_from_world_of(const Mat4d& world_from_camera_gl) {
    Mat3d r = world_from_camera_gl.topLeftCorner<3, 3>();
    if (!world_from_camera_gl.allFinite()) throw InputError("'transform_matrix' has a value that is not finite");
    const double det = r.determinant();
    if (det < 0)
        throw InputError("'transform_matrix' is left-handed (its rotation has determinant " + std::to_string(det) +
                         "): a camera cannot be mirrored. Remedy: export with a right-handed world");
    if (!is_rotation(r, 1e-2))
        throw InputError("'transform_matrix' has no rotation in its upper left 3x3 (determinant " + std::to_string(det) +
                         "): remove the scale or shear from it");
    // Files written in single precision are orthonormal to 1e-7 only; what is exact stays untouched.
    if (!is_rotation(r, 1e-14)) r = nearest_rotation(r);
    return Rigid3{r * flip_yz(), world_from_camera_gl.topRightCorner<3, 1>()}.inverse();
}

}  // namespace

bool understands_transforms(const fs::path& file) {
    if (!fs::is_regular_file(file) || file.extension() != ".json") return false;
    try {
        const json j = parse_json(file);
        return j.is_object() && j.contains("frames") && j["frames"].is_array() && !j["frames"].empty() && j["frames"][0].is_object() &&
               j["frames"][0].contains("transform_matrix");
    } catch (const Error&) {
        return false;
    }
}

namespace {

Imported read_checked(const fs::path& file, const json& top);

}  // namespace

Imported read_transforms(const fs::path& file) {
    const json top = parse_json(file);
    try {
        return read_checked(file, top);
    } catch (const json::exception& e) {
        throw InputError(file.string() + ": " + e.what());
    }
}

namespace {

Imported read_checked(const fs::path& file, const json& top) {
    Imported out;
    const json* ours = top.contains("vdbcarve") ? &top["vdbcarve"] : nullptr;
    if (ours && ours->value("schema", 0) != 1)
        throw InputError(file.string() + ": was written by a newer vdbcarve (cameras.json schema " + std::to_string(ours->value("schema", 0)) +
                         ", this program reads 1)");
    out.up = ours ? ours->value("up", "") : "z";
    Mat4d original_from_world = Mat4d::Identity();
    if (top.contains("applied_transform") && !ours) {
        try {
            original_from_world = matrix(top["applied_transform"], "applied_transform").inverse();
        } catch (const Error& e) {
            throw InputError(file.string() + ": " + e.what());
        }
        out.up = "";
        out.notes.push_back("applied_transform undone: the world is the one that the cameras were found in");
    }
    if (!out.up.empty() && out.up != "x" && out.up != "y" && out.up != "z" && out.up != "-x" && out.up != "-y" && out.up != "-z")
        throw InputError(file.string() + ": 'up' is '" + out.up + "', none of x, y, z, -x, -y, -z");
    if (ours) {
        out.units = ours->value("units", "");
        if (ours->contains("floor") && !out.up.empty()) out.floor = ours->at("floor").get<double>();
        out.unverified = ours->value("unverified", out.unverified);
        if (ours->contains("sittings")) {
            out.sittings.clear();
            for (const json& s : (*ours)["sittings"]) {
                Sitting sitting;
                sitting.id = s.value("id", "0");
                sitting.scale = s.value("scale", 1.0);
                const Mat4d m = matrix(s.at("scene_from_sitting"), "scene_from_sitting");
                sitting.scene_from_sitting = {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
                out.sittings.push_back(sitting);
            }
        }
    }
    size_t index = 0;
    for (const json& frame : top["frames"]) {
        ImportedView v;
        v.view.name = frame.value("file_path", "");
        const std::string where = file.string() + ": frame " + std::to_string(index) + " (" + v.view.name + "): ";
        try {
            if (v.view.name.empty()) throw InputError("has no 'file_path'");
            while (v.view.name.rfind("./", 0) == 0) v.view.name.erase(0, 2);
            if (!frame.contains("transform_matrix")) throw InputError("has no 'transform_matrix'");
            Mat4d world_from_camera = original_from_world * matrix(frame["transform_matrix"], "transform_matrix");
            if (!original_from_world.isIdentity()) {
                const double scale = std::cbrt(std::abs(original_from_world.topLeftCorner<3, 3>().determinant()));
                world_from_camera.topLeftCorner<3, 3>() /= scale;
            }
            v.view.camera.camera_from_world = camera_from_world_of(world_from_camera);
            Intrinsics& k = v.view.camera.intrinsics;
            k.width_px = static_cast<int>(number(frame, top, "w", 0));
            k.height_px = static_cast<int>(number(frame, top, "h", 0));
            k.fx = number(frame, top, "fl_x", 0);
            k.fy = number(frame, top, "fl_y", k.fx);
            k.cx = number(frame, top, "cx", -1e9);
            k.cy = number(frame, top, "cy", -1e9);
            if (k.fx == 0) v.angle_x_rad = number(frame, top, "camera_angle_x", 0);
            if (k.fx == 0 && v.angle_x_rad == 0) throw InputError("no focal length: neither 'fl_x' nor 'camera_angle_x'");
            v.view.lens = lens_of(frame, top);
            if (frame.contains("mask_path") && frame["mask_path"].is_string()) v.view.mask_path = frame["mask_path"].get<std::string>();
            if (frame.contains("vdbcarve")) {
                const json& extra = frame["vdbcarve"];
                k.skew = extra.value("skew", 0.0);
                k.orthographic = extra.value("orthographic", false);
                v.view.sitting = extra.value("sitting", "0");
                v.view.unused = extra.value("unused", "");
                v.view.orientation = std::clamp(extra.value("orientation", 1), 1, 8);
            }
        } catch (const json::exception& e) {
            throw InputError(where + e.what());
        } catch (const Error& e) {
            throw InputError(where + e.what());
        }
        out.views.push_back(v);
        ++index;
    }
    return out;
}

}  // namespace
}  // namespace vdbcarve::io

namespace vdbcarve {
namespace {

nlohmann::json rows_of(const Mat4d& m) {
    nlohmann::json rows = nlohmann::json::array();
    for (int i = 0; i < 4; ++i) rows.push_back({m(i, 0), m(i, 1), m(i, 2), m(i, 3)});
    return rows;
}

}  // namespace

std::string cameras_json(const Views& views, const std::filesystem::path& relative_to) {
    using nlohmann::json;
    json top;
    json& frames = top["frames"] = json::array();
    // Base names where they tell the views apart, also without extension (masks are named so), else the camera file's own names, folders included.
    std::set<std::string> base_names;
    for (const View& view : views.views)
        base_names.insert(std::filesystem::path(view.image_path.empty() ? view.name : view.image_path.string()).stem().string());
    const bool unique = base_names.size() == views.views.size();
    for (const View& view : views.views) {
        const Intrinsics& k = view.camera.intrinsics;
        json f;
        const auto& path = view.image_path.empty() ? std::filesystem::path(view.name) : view.image_path;
        if (!relative_to.empty()) f["file_path"] = std::filesystem::proximate(path, relative_to).generic_string();
        else f["file_path"] = unique ? path.filename().string() : view.name;
        f["fl_x"] = k.fx;
        f["fl_y"] = k.fy;
        f["cx"] = k.cx;
        f["cy"] = k.cy;
        f["w"] = k.width_px;
        f["h"] = k.height_px;
        const std::vector<double>& c = view.lens.coefficients;
        const auto set = [&](std::initializer_list<const char*> names) {
            size_t i = 0;
            for (const char* name : names) {
                if (i < c.size()) f[name] = c[i];
                ++i;
            }
        };
        switch (view.lens.model) {
            case Lens::Model::None:
                f["camera_model"] = k.orthographic ? "ORTHOGRAPHIC" : "PINHOLE";
                break;
            case Lens::Model::SimpleRadial:
                f["camera_model"] = "OPENCV";
                set({"k1"});
                break;
            case Lens::Model::Radial:
                f["camera_model"] = "OPENCV";
                set({"k1", "k2"});
                break;
            case Lens::Model::OpenCV:
                f["camera_model"] = "OPENCV";
                set({"k1", "k2", "p1", "p2"});
                break;
            case Lens::Model::OpenCVFisheye:
                f["camera_model"] = "OPENCV_FISHEYE";
                set({"k1", "k2", "k3", "k4"});
                break;
            case Lens::Model::FullOpenCV:
                f["camera_model"] = "FULL_OPENCV";
                set({"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"});
                break;
        }
        const Rigid3 world_from_camera = view.camera.camera_from_world.inverse();
        Mat4d gl = world_from_camera.matrix();
        gl.topLeftCorner<3, 3>() = world_from_camera.rotation * Mat3d(Vec3d(1, -1, -1).asDiagonal());
        f["transform_matrix"] = rows_of(gl);
        f["vdbcarve"] = {{"sitting", view.sitting}, {"skew", k.skew}, {"orthographic", k.orthographic}};
        if (view.orientation != 1) f["vdbcarve"]["orientation"] = view.orientation;
        if (!view.unused.empty()) f["vdbcarve"]["unused"] = view.unused;
        frames.push_back(f);
    }
    json& ours = top["vdbcarve"];
    ours["schema"] = 1;
    ours["up"] = views.up;
    ours["units"] = views.units;
    if (views.floor) ours["floor"] = *views.floor;
    if (!views.unverified.empty()) ours["unverified"] = views.unverified;
    json& sittings = ours["sittings"] = json::array();
    for (const Sitting& s : views.sittings) {
        sittings.push_back({{"id", s.id}, {"scale", s.scale}, {"scene_from_sitting", rows_of(s.scene_from_sitting.matrix())}});
    }
    return top.dump(1) + "\n";
}

void write_cameras(const Views& views, const std::filesystem::path& file) {
    write_file(file, cameras_json(views, file.has_parent_path() ? file.parent_path() : std::filesystem::path(".")));
}

}  // namespace vdbcarve
