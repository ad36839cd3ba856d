// SPDX-License-Identifier: Apache-2.0
// Agisoft Metashape's cameras as XML ("Export Cameras"): camera-to-chunk 4x4 in OpenCV's axes, and a component's or the chunk's own transform from there to the
// world. Principal points count from the image's middle, p1 and p2 are the other way round than OpenCV's (Metashape's manual, appendix "Camera models").
#include <map>
#include <pugixml.hpp>

#include "views/formats/camera_formats.h"
#include "base/text.h"
#include "vdbcarve/geometry.h"

namespace vdbcarve::io {
namespace {

std::vector<double> numbers_of(const char* text, size_t count, const std::string& where) {
    std::vector<double> out;
    std::istringstream in(text);
    for (std::string word; in >> word;) out.push_back(number_in(word, where));
    if (out.size() != count) throw InputError(where + ": " + counted(out.size(), "number") + ", expected " + std::to_string(count));
    return out;
}

struct Sensor {
    Intrinsics intrinsics;
    Lens lens;
};

Sensor read_sensor(const pugi::xml_node& node, const std::string& where) {
    Sensor out;
    const std::string type = node.attribute("type").as_string("frame");
    if (type != "frame")
        throw InputError(where + ": is of type " + type +
                         "; frame is supported. Remedy: convert the photographs (in Metashape: undistort), or another camera format");
    pugi::xml_node calibration;
    for (const pugi::xml_node& c : node.children("calibration"))
        if (!calibration || std::string(c.attribute("class").as_string()) == "adjusted") calibration = c;
    const pugi::xml_node resolution = calibration.child("resolution") ? calibration.child("resolution") : node.child("resolution");
    Intrinsics& k = out.intrinsics;
    k.width_px = resolution.attribute("width").as_int();
    k.height_px = resolution.attribute("height").as_int();
    if (k.width_px <= 0 || k.height_px <= 0) throw InputError(where + ": has no resolution");
    const auto value = [&](const char* name) {
        const pugi::xml_node n = calibration.child(name);
        return n ? number_in(n.child_value(), where + ": " + name) : 0.0;
    };
    const double f = value("f");
    if (!(f > 0)) throw InputError(where + ": has no focal length. Remedy: align the cameras in Metashape before exporting them");
    k.fx = f + value("b1");
    k.fy = f;
    k.skew = value("b2");
    k.cx = 0.5 * k.width_px + value("cx");
    k.cy = 0.5 * k.height_px + value("cy");
    if (value("k4") != 0 || value("p3") != 0 || value("p4") != 0)
        throw InputError(where + ": k4, p3 or p4 is not 0; k1 to k3, p1 and p2 are supported. Remedy: optimise the cameras in Metashape without them");
    const double k1 = value("k1"), k2 = value("k2"), k3 = value("k3"), p1 = value("p2"), p2 = value("p1");
    if (k3 != 0) out.lens = {Lens::Model::FullOpenCV, {k1, k2, p1, p2, k3, 0, 0, 0}};
    else if (k1 != 0 || k2 != 0 || p1 != 0 || p2 != 0) out.lens = {Lens::Model::OpenCV, {k1, k2, p1, p2}};
    return out;
}

/// Of a <transform> with <rotation>, <translation> and <scale>; parts that are missing are none.
Similarity read_similarity(const pugi::xml_node& node, const std::string& where) {
    Similarity out;
    if (const pugi::xml_node r = node.child("rotation")) {
        const auto v = numbers_of(r.child_value(), 9, where + ": rotation");
        for (int i = 0; i < 9; ++i) out.rotation(i / 3, i % 3) = v[static_cast<size_t>(i)];
    }
    if (const pugi::xml_node t = node.child("translation")) {
        const auto v = numbers_of(t.child_value(), 3, where + ": translation");
        out.translation = Vec3d(v[0], v[1], v[2]);
    }
    if (const pugi::xml_node s = node.child("scale")) out.scale = number_in(s.child_value(), where + ": scale");
    return out;
}

}  // namespace

bool understands_metashape(const fs::path& file) {
    if (!fs::is_regular_file(file) || file.extension() != ".xml") return false;
    pugi::xml_document document;
    return document.load_file(file.c_str()) && document.child("document").child("chunk").child("cameras");
}

Imported read_metashape(const fs::path& file) {
    pugi::xml_document document;
    if (const pugi::xml_parse_result parsed = document.load_file(file.c_str()); !parsed)
        throw InputError(file.string() + ": is not XML: " + parsed.description());
    const pugi::xml_node chunk = document.child("document").child("chunk");
    std::map<std::string, Sensor> sensors;
    std::map<std::string, std::string> broken;  // said only where a camera needs it
    for (const pugi::xml_node& s : chunk.child("sensors").children("sensor")) {
        const std::string id = s.attribute("id").as_string();
        try {
            sensors[id] = read_sensor(s, file.string() + ": sensor " + s.attribute("label").as_string(id.c_str()));
        } catch (const InputError& e) {
            broken[id] = e.what();
        }
    }
    std::map<std::string, Similarity> components;
    for (const pugi::xml_node& c : chunk.child("components").children("component"))
        if (c.child("transform"))
            components[c.attribute("id").as_string()] =
                read_similarity(c.child("transform"), file.string() + ": component " + c.attribute("label").as_string());
    const Similarity whole = chunk.child("transform") ? read_similarity(chunk.child("transform"), file.string() + ": chunk") : Similarity();

    Imported out;
    std::vector<std::string> unaligned, disabled;
    std::map<std::string, size_t> views_of_component;
    const auto add = [&](const pugi::xml_node& c) {
        ImportedView v;
        v.view.name = c.attribute("label").as_string();
        const std::string where = file.string() + ": camera " + v.view.name;
        const std::string enabled = c.attribute("enabled").as_string("true");
        if (enabled == "0" || enabled == "false") {
            disabled.push_back(v.view.name);
            return;
        }
        if (!c.child("transform")) {
            unaligned.push_back(v.view.name);
            return;
        }
        const std::string sensor = c.attribute("sensor_id").as_string();
        if (broken.count(sensor)) throw InputError(broken[sensor]);
        if (!sensors.count(sensor)) throw InputError(where + ": names sensor '" + sensor + "', which is not there");
        v.view.camera.intrinsics = sensors[sensor].intrinsics;
        v.view.lens = sensors[sensor].lens;
        const std::vector<double> m = numbers_of(c.child("transform").child_value(), 16, where + ": transform");
        Mat3d world_from_camera;
        for (int r = 0; r < 3; ++r)
            for (int k = 0; k < 3; ++k) world_from_camera(r, k) = m[static_cast<size_t>(4 * r + k)];
        const Vec3d centre(m[3], m[7], m[11]);
        const std::string component = c.attribute("component_id").as_string();
        const Similarity& world = components.count(component) ? components[component] : whole;
        ++views_of_component[component];
        Rigid3& pose = v.view.camera.camera_from_world;
        pose.rotation = (world.rotation * world_from_camera).transpose();
        pose.translation = -(pose.rotation * (world * centre));
        out.views.push_back(v);
    };
    for (const pugi::xml_node& c : chunk.child("cameras").children()) {
        if (std::string(c.name()) == "camera") add(c);
        else if (std::string(c.name()) == "group")
            for (const pugi::xml_node& inner : c.children("camera")) add(inner);
    }
    if (!unaligned.empty())
        out.warnings.push_back(counted(unaligned.size(), "camera") + " without a transform, not aligned by Metashape: left out: " + some_of(unaligned));
    if (!disabled.empty()) out.notes.push_back(counted(disabled.size(), "camera") + " switched off in Metashape: left out: " + some_of(disabled));
    if (views_of_component.size() > 1)
        out.warnings.push_back("cameras of " + std::to_string(views_of_component.size()) +
                               " components: do they lie in one world? Remedy: merge components in Metashape, or export one");
    return out;
}

}  // namespace vdbcarve::io
