// SPDX-License-Identifier: Apache-2.0
// OpenMVG's sfm_data.json and Meshroom's (AliceVision's) .sfm. Both give a rotation of the camera from the world and its centre, axes as
// OpenCV's, and count pixels as their feature detectors do, the first one's centre at (0, 0).
#include <map>

#include "views/formats/json_file.h"
#include "base/text.h"

namespace vdbcarve::io {
namespace {

using nlohmann::json;

bool is_openmvg(const json& j) { return j.is_object() && j.contains("sfm_data_version") && j.contains("views") && j.contains("extrinsics"); }
bool is_meshroom(const json& j) {
    return j.is_object() && j.contains("version") && j["version"].is_array() && j.contains("views") && j.contains("intrinsics") && j.contains("poses");
}

/// AliceVision writes numbers as strings.
double number_of(const json& j) { return j.is_string() ? number_in(j.get<std::string>(), "a value") : j.get<double>(); }
double number_of(const json& j, const char* key) { return number_of(j.at(key)); }
std::string text_in(const json& j) { return j.is_string() ? j.get<std::string>() : j.dump(); }

struct Lensed {
    Intrinsics intrinsics;
    Lens lens;
};

/// Radial and tangential terms by the names that both programs give them; OpenCV's formulas.
Lens lens_of(const std::string& type, const std::vector<double>& c, const std::string& where) {
    const auto at = [&](size_t i) { return i < c.size() ? c[i] : 0.0; };
    const auto ends = [&](const char* with) {
        return type.size() >= std::string(with).size() && type.compare(type.size() - std::string(with).size(), std::string::npos, with) == 0;
    };
    bool any = false;
    for (const double x : c) any |= x != 0;
    if (!any || type == "pinhole") return {};
    if (ends("radial1") || ends("radial_k1")) return {Lens::Model::SimpleRadial, {at(0)}};
    if (ends("radial3") || ends("radial_k3")) return {Lens::Model::FullOpenCV, {at(0), at(1), 0, 0, at(2), 0, 0, 0}};
    if (ends("brown") || ends("brown_t2")) return {Lens::Model::FullOpenCV, {at(0), at(1), at(3), at(4), at(2), 0, 0, 0}};
    if (ends("fisheye4") || ends("fisheye")) return {Lens::Model::OpenCVFisheye, {at(0), at(1), at(2), at(3)}};
    throw InputError(where + ": lens '" + type + "' is not supported (supported: pinhole, radial 1 and 3, brown, fisheye). Remedy: export undistorted images");
}

Rigid3 pose_of(const Mat3d& rotation, const Vec3d& centre) { return {rotation, -(rotation * centre)}; }

Imported read_openmvg(const fs::path& file, const json& top) {
    Imported out;
    out.integer_pixel_centres = true;
    std::map<uint64_t, Lensed> cameras;
    for (const json& entry : top.at("intrinsics")) {
        const json& value = entry.at("value");
        const json& said = value.at("ptr_wrapper").at("data");
        const json& data = said.contains("value0") ? said["value0"] : said;  // some versions wrap the pinhole part
        Lensed c;
        Intrinsics& k = c.intrinsics;
        k.width_px = data.at("width").get<int>();
        k.height_px = data.at("height").get<int>();
        k.fx = k.fy = data.at("focal_length").get<double>();
        k.cx = data.at("principal_point").at(0).get<double>();
        k.cy = data.at("principal_point").at(1).get<double>();
        std::string type = value.value("polymorphic_name", "pinhole");
        std::vector<double> terms;
        for (const char* name : {"disto_k1", "disto_k3", "disto_t2", "fisheye"})
            if (said.contains(name)) terms = said[name].get<std::vector<double>>();
        c.lens = lens_of(type, terms, file.string() + ": intrinsic " + text_in(entry.at("key")));
        cameras[entry.at("key").get<uint64_t>()] = c;
    }
    std::map<uint64_t, Rigid3> poses;
    for (const json& entry : top.at("extrinsics")) {
        Mat3d rotation;
        Vec3d centre;
        for (int i = 0; i < 9; ++i)
            rotation(i / 3, i % 3) = entry.at("value").at("rotation").at(static_cast<size_t>(i / 3)).at(static_cast<size_t>(i % 3)).get<double>();
        for (int i = 0; i < 3; ++i) centre[i] = entry.at("value").at("center").at(static_cast<size_t>(i)).get<double>();
        poses[entry.at("key").get<uint64_t>()] = pose_of(rotation, centre);
    }
    std::vector<std::string> without;
    for (const json& entry : top.at("views")) {
        const json& data = entry.at("value").at("ptr_wrapper").at("data");
        ImportedView v;
        v.view.name = (fs::path(data.value("local_path", "")) / data.at("filename").get<std::string>()).generic_string();
        while (!v.view.name.empty() && v.view.name.front() == '/') v.view.name.erase(0, 1);
        const auto pose = poses.find(data.at("id_pose").get<uint64_t>());
        const auto camera = cameras.find(data.at("id_intrinsic").get<uint64_t>());
        if (pose == poses.end() || camera == cameras.end()) {
            without.push_back(v.view.name);
            continue;
        }
        v.view.camera.intrinsics = camera->second.intrinsics;
        v.view.lens = camera->second.lens;
        v.view.camera.camera_from_world = pose->second;
        out.views.push_back(v);
    }
    if (!without.empty()) out.warnings.push_back(counted(without.size(), "image") + " without a pose: left out: " + some_of(without));
    return out;
}

Imported read_meshroom(const fs::path& file, const json& top) {
    Imported out;
    out.integer_pixel_centres = true;
    const json& version = top["version"];
    const auto part = [&](size_t i) { return i < version.size() ? static_cast<int>(number_of(version[i])) : 0; };
    const auto since = [&](int a, int b, int c) { return std::array{part(0), part(1), part(2)} >= std::array{a, b, c}; };
    std::map<std::string, Lensed> cameras;
    for (const json& i : top.at("intrinsics")) {
        Lensed c;
        const std::string id = text_in(i.at("intrinsicId")), where = file.string() + ": intrinsic " + id;
        Intrinsics& k = c.intrinsics;
        k.width_px = static_cast<int>(number_of(i, "width"));
        k.height_px = static_cast<int>(number_of(i, "height"));
        if (i.contains("pxFocalLength")) {
            const json& f = i["pxFocalLength"];
            k.fx = number_of(f.is_array() ? f.at(0) : f);
            k.fy = f.is_array() && f.size() > 1 ? number_of(f.at(1)) : k.fx;
        } else {  // millimetres since 1.2.2
            k.fx = k.fy = number_of(i, "focalLength") / number_of(i, "sensorWidth") * k.width_px;
            if (i.contains("pixelRatio") && std::abs(number_of(i, "pixelRatio") - 1) > 1e-9)
                throw InputError(where + ": has a pixel ratio of " + text_in(i["pixelRatio"]) + ", which is not supported. Remedy: export undistorted images");
        }
        const json& p = i.at("principalPoint");
        k.cx = number_of(p.at(0));
        k.cy = number_of(p.at(1));
        if (since(1, 2, 1)) {  // from the image's middle on
            k.cx += 0.5 * k.width_px;
            k.cy += 0.5 * k.height_px;
        }
        std::vector<double> terms;
        for (const char* name : {"distortionParams"})
            if (i.contains(name) && i[name].is_array())
                for (const json& x : i[name]) terms.push_back(number_of(x));
        const std::string type =
            i.contains("distortionType") && i["distortionType"] != "none" ? i["distortionType"].get<std::string>() : i.value("type", "pinhole");
        c.lens = lens_of(type, terms, where);
        cameras[id] = c;
    }
    std::map<std::string, Rigid3> poses;
    for (const json& entry : top.at("poses")) {
        const json& t = entry.at("pose").at("transform");
        Mat3d rotation;
        Vec3d centre;
        for (int i = 0; i < 9; ++i) rotation(i % 3, i / 3) = number_of(t.at("rotation").at(static_cast<size_t>(i)));  // column after column
        for (int i = 0; i < 3; ++i) centre[i] = number_of(t.at("center").at(static_cast<size_t>(i)));
        poses[text_in(entry.at("poseId"))] = pose_of(rotation, centre);
    }
    std::vector<std::string> without;
    for (const json& entry : top.at("views")) {
        ImportedView v;
        v.view.name = fs::path(entry.at("path").get<std::string>()).filename().string();  // an absolute path, often of another machine
        if (entry.contains("rigId"))
            throw InputError(file.string() + ": view " + v.view.name + " belongs to a rig of cameras, which is not supported. Remedy: export as COLMAP");
        const auto pose = poses.find(text_in(entry.contains("poseId") ? entry["poseId"] : entry.at("viewId")));
        const auto camera = entry.contains("intrinsicId") ? cameras.find(text_in(entry["intrinsicId"])) : cameras.end();
        if (pose == poses.end() || camera == cameras.end()) {
            without.push_back(v.view.name);
            continue;
        }
        v.view.camera.intrinsics = camera->second.intrinsics;
        v.view.lens = camera->second.lens;
        v.view.camera.camera_from_world = pose->second;
        out.views.push_back(v);
    }
    if (!without.empty()) out.warnings.push_back(counted(without.size(), "image") + " without a pose: left out: " + some_of(without));
    return out;
}

}  // namespace

bool understands_sfm(const fs::path& file) {
    if (!fs::is_regular_file(file) || (file.extension() != ".sfm" && file.extension() != ".json")) return false;
    try {
        const json j = parse_json(file);
        return is_openmvg(j) || is_meshroom(j);
    } catch (const Error&) {
        return false;
    }
}

Imported read_sfm(const fs::path& file) {
    const json j = parse_json(file);
    try {
        return is_openmvg(j) ? read_openmvg(file, j) : read_meshroom(file, j);
    } catch (const json::exception& e) {
        throw InputError(file.string() + ": " + e.what());
    }
}

}  // namespace vdbcarve::io
