// SPDX-License-Identifier: Apache-2.0
#include "camera_files.h"

#include <fstream>
#include <iomanip>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>

namespace vdbcarve::test {

std::string middlebury_text(const Views& views) {
    std::ostringstream out;
    out << std::setprecision(17) << views.views.size() << "\n";
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        const Rigid3& t = v.camera.camera_from_world;
        out << v.name << " " << k.fx << " " << k.skew << " " << k.cx - 0.5 << " 0 " << k.fy << " " << k.cy - 0.5 << " 0 0 1";
        for (int i = 0; i < 9; ++i) out << " " << t.rotation(i / 3, i % 3);
        for (int i = 0; i < 3; ++i) out << " " << t.translation[i];
        out << "\n";
    }
    return out.str();
}

std::string transforms_text(const Views& views) {
    nlohmann::json j;
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        const Mat3d& r = v.camera.camera_from_world.rotation;
        const Vec3d c = -r.transpose() * v.camera.camera_from_world.translation;
        nlohmann::json m = nlohmann::json::array();
        // OpenGL: columns are right, up, backward.
        for (int i = 0; i < 3; ++i) m.push_back({r(0, i), -r(1, i), -r(2, i), c[i]});
        m.push_back({0.0, 0.0, 0.0, 1.0});
        j["frames"].push_back({{"file_path", "images/" + v.name},
                               {"transform_matrix", m},
                               {"fl_x", k.fx},
                               {"fl_y", k.fy},
                               {"cx", k.cx},
                               {"cy", k.cy},
                               {"w", k.width_px},
                               {"h", k.height_px}});
    }
    return j.dump();
}

std::string projection_text(const View& view, double factor) {
    const Intrinsics& k = view.camera.intrinsics;
    Mat3d a;
    a << k.fx, k.skew, k.cx - 0.5, 0, k.fy, k.cy - 0.5, 0, 0, 1;
    Mat34d p;
    p << view.camera.camera_from_world.rotation, view.camera.camera_from_world.translation;
    p = factor * a * p;
    std::ostringstream out;
    out << std::setprecision(17);
    for (int r = 0; r < 3; ++r) out << p(r, 0) << " " << p(r, 1) << " " << p(r, 2) << " " << p(r, 3) << "\n";
    return out.str();
}

std::string opencv_calibration_text(const Views& views, bool named) {
    const Intrinsics& k = views.views[0].camera.intrinsics;
    std::ostringstream out;
    out << std::setprecision(17) << "%YAML:1.0\n---\nimage_width: " << k.width_px << "\nimage_height: " << k.height_px
        << "\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ " << k.fx << ", " << k.skew << ", " << k.cx - 0.5 << ", 0., " << k.fy
        << ", " << k.cy - 0.5
        << ", 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0., 0., 0., 0., 0. ]\nviews:\n";
    for (const View& v : views.views) {
        const Eigen::AngleAxisd turn(v.camera.camera_from_world.rotation);
        const Vec3d r = turn.angle() * turn.axis(), t = v.camera.camera_from_world.translation;
        out << "   - { " << (named ? "name: \"" + v.name + "\", " : "") << "rvec: [ " << r[0] << ", " << r[1] << ", " << r[2] << " ], tvec: [ " << t[0] << ", "
            << t[1] << ", " << t[2] << " ] }\n";
    }
    return out.str();
}

std::string opencv_projections_xml(const Views& views) {
    std::ostringstream out;
    out << std::setprecision(17) << "<?xml version=\"1.0\"?>\n<opencv_storage>\n";
    for (size_t n = 0; n < views.views.size(); ++n) {
        const size_t i = views.views.size() - 1 - n;
        out << "<P_" << 3 * i << " type_id=\"opencv-matrix\"><rows>3</rows><cols>4</cols><dt>d</dt><data>" << projection_text(views.views[i], -0.3)
            << "</data></P_" << 3 * i << ">\n";
    }
    return out.str() + "</opencv_storage>\n";
}

std::string metashape_text(const Views& views, const std::string& distortion) {
    const Mat3d turn(Eigen::AngleAxisd(0.7, Vec3d(1, 2, 3).normalized()));
    const Vec3d moved(10, -20, 5);
    const double scale = 2.5;
    std::ostringstream out;
    out << std::setprecision(17)
        << "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\"><chunk label=\"Chunk 1\" enabled=\"true\">\n<sensors>\n";
    for (size_t i = 0; i < views.views.size(); ++i) {
        const Intrinsics& k = views.views[i].camera.intrinsics;
        out << "<sensor id=\"" << i << "\" label=\"a lens\" type=\"frame\"><resolution width=\"" << k.width_px << "\" height=\"" << k.height_px
            << "\"/><calibration type=\"frame\" class=\"initial\"><resolution width=\"" << k.width_px << "\" height=\"" << k.height_px
            << "\"/><f>1</f></calibration><calibration type=\"frame\" class=\"adjusted\"><resolution width=\"" << k.width_px << "\" height=\"" << k.height_px
            << "\"/><f>" << k.fy << "</f><cx>" << k.cx - 0.5 * k.width_px << "</cx><cy>" << k.cy - 0.5 * k.height_px << "</cy><b1>" << k.fx - k.fy
            << "</b1><b2>" << k.skew << "</b2>" << distortion << "</calibration></sensor>\n";
    }
    out << "</sensors>\n<components><component id=\"3\" label=\"Component 1\"><transform><rotation locked=\"true\">";
    for (int a = 0; a < 9; ++a) out << turn(a / 3, a % 3) << " ";
    out << "</rotation><translation locked=\"true\">" << moved[0] << " " << moved[1] << " " << moved[2] << "</translation><scale locked=\"true\">" << scale
        << "</scale></transform></component></components>\n<cameras>\n<group id=\"0\">\n";
    for (size_t i = 0; i < views.views.size(); ++i) {
        const Rigid3& pose = views.views[i].camera.camera_from_world;
        const Mat3d chunk_from_camera = turn.transpose() * pose.rotation.transpose();
        const Vec3d centre = turn.transpose() * (-(pose.rotation.transpose() * pose.translation) - moved) / scale;
        out << "<camera id=\"" << i << "\" sensor_id=\"" << i << "\" component_id=\"3\" label=\"" << std::filesystem::path(views.views[i].name).stem().string()
            << "\"><transform>";
        for (int r = 0; r < 3; ++r)
            out << chunk_from_camera(r, 0) << " " << chunk_from_camera(r, 1) << " " << chunk_from_camera(r, 2) << " " << centre[r] << " ";
        out << "0 0 0 1</transform></camera>\n";
    }
    return out.str() + "</group>\n<camera id=\"99\" sensor_id=\"0\" label=\"lost\"></camera></cameras></chunk></document>\n";
}

std::string bundler_text(const Views& views) {
    std::ostringstream out;
    out << std::setprecision(17) << "# Bundle file v0.3\n" << views.views.size() + 1 << " 1\n";
    for (size_t i = 0; i < views.views.size(); ++i) {
        if (i + 1 == views.views.size()) out << "0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n";
        const Camera& c = views.views[i].camera;
        const Mat3d& r = c.camera_from_world.rotation;
        const Vec3d& t = c.camera_from_world.translation;
        out << c.intrinsics.fx << " 0 0\n"
            << r(0, 0) << " " << r(0, 1) << " " << r(0, 2) << "\n"
            << -r(1, 0) << " " << -r(1, 1) << " " << -r(1, 2) << "\n"
            << -r(2, 0) << " " << -r(2, 1) << " " << -r(2, 2) << "\n"
            << t[0] << " " << -t[1] << " " << -t[2] << "\n";
    }
    return out.str() + "1 2 3\n255 0 0\n2 0 5 1.5 -2.5 1 6 0.5 0.25\n";
}

std::string nvm_text(const Views& views) {
    std::ostringstream out;
    out << std::setprecision(17) << "NVM_V3 \n\n" << views.views.size() << "\n";
    for (const View& v : views.views) {
        const Eigen::Quaterniond q(v.camera.camera_from_world.rotation);
        const Vec3d c = v.camera.centre_world();
        out << "images/" << v.name << "\t" << v.camera.intrinsics.fx << " " << q.w() << " " << q.x() << " " << q.y() << " " << q.z() << " " << c[0] << " "
            << c[1] << " " << c[2] << " 0 0\n";
    }
    return out.str() + "\n0\n";
}

std::string openmvg_text(const Views& views) {
    std::ostringstream v, k, x;
    for (std::ostringstream* o : {&v, &k, &x}) *o << std::setprecision(17);
    const size_t n = views.views.size();
    for (size_t i = 0; i <= n; ++i) {
        const std::string name = i < n ? views.views[i].name : "lost.png";
        v << (i ? "," : "") << "{\"key\":" << i << ",\"value\":{\"polymorphic_id\":1073741824,\"ptr_wrapper\":{\"id\":" << 2147483649 + i
          << ",\"data\":{\"local_path\":\"/\",\"filename\":\"" << name << "\",\"width\":40,\"height\":30,\"id_view\":" << i << ",\"id_intrinsic\":" << i
          << ",\"id_pose\":" << i << "}}}}";
        if (i == n) break;
        const Camera& c = views.views[i].camera;
        k << (i ? "," : "") << "{\"key\":" << i << ",\"value\":{\"polymorphic_name\":\"pinhole\",\"ptr_wrapper\":{\"data\":{\"width\":" << c.intrinsics.width_px
          << ",\"height\":" << c.intrinsics.height_px << ",\"focal_length\":" << c.intrinsics.fx << ",\"principal_point\":[" << c.intrinsics.cx - 0.5 << ","
          << c.intrinsics.cy - 0.5 << "]}}}}";
        const Mat3d& r = c.camera_from_world.rotation;
        const Vec3d centre = c.centre_world();
        x << (i ? "," : "") << "{\"key\":" << i << ",\"value\":{\"rotation\":[";
        for (int a = 0; a < 3; ++a) x << (a ? "," : "") << "[" << r(a, 0) << "," << r(a, 1) << "," << r(a, 2) << "]";
        x << "],\"center\":[" << centre[0] << "," << centre[1] << "," << centre[2] << "]}}";
    }
    return "{\"sfm_data_version\":\"0.3\",\"root_path\":\"/elsewhere\",\"views\":[" + v.str() + "],\"intrinsics\":[" + k.str() + "],\"extrinsics\":[" +
           x.str() + "],\"structure\":[],\"control_points\":[]}";
}

std::string meshroom_text(const Views& views, bool millimetres) {
    std::ostringstream v, k, x;
    for (std::ostringstream* o : {&v, &k, &x}) *o << std::setprecision(17);
    const size_t n = views.views.size();
    const auto quoted = [](double d) {
        std::ostringstream out;
        out << std::setprecision(17) << '"' << d << '"';
        return out.str();
    };
    for (size_t i = 0; i < n; ++i) {
        const Camera& c = views.views[i].camera;
        const Intrinsics& in = c.intrinsics;
        v << (i ? "," : "") << "{\"viewId\":\"" << 100 + i << "\",\"poseId\":\"" << 100 + i << "\",\"intrinsicId\":\"" << 7 + i << "\",\"path\":\"/home/me/"
          << views.views[i].name << "\",\"width\":\"" << in.width_px << "\",\"height\":\"" << in.height_px << "\"}";
        k << (i ? "," : "") << "{\"intrinsicId\":\"" << 7 + i << "\",\"width\":\"" << in.width_px << "\",\"height\":\"" << in.height_px << "\",\"type\":\""
          << (millimetres ? "pinhole" : "radial3") << "\",";
        if (millimetres)
            k << "\"sensorWidth\":\"36\",\"focalLength\":" << quoted(in.fx * 36 / in.width_px) << ",\"pixelRatio\":\"1\",\"distortionType\":\"none\",";
        else k << "\"pxFocalLength\":" << quoted(in.fx) << ",\"distortionParams\":[\"0\",\"0\",\"0\"],";
        k << "\"principalPoint\":[" << quoted(in.cx - 0.5 - (millimetres ? 0.5 * in.width_px : 0)) << ","
          << quoted(in.cy - 0.5 - (millimetres ? 0.5 * in.height_px : 0)) << "]}";
        x << (i ? "," : "") << "{\"poseId\":\"" << 100 + i << "\",\"pose\":{\"transform\":{\"rotation\":[";
        for (int a = 0; a < 9; ++a) x << (a ? "," : "") << quoted(c.camera_from_world.rotation(a % 3, a / 3));
        const Vec3d centre = c.centre_world();
        x << "],\"center\":[" << quoted(centre[0]) << "," << quoted(centre[1]) << "," << quoted(centre[2]) << "]},\"locked\":\"0\"}}";
    }
    return std::string("{\"version\":[") + (millimetres ? "\"1\",\"2\",\"6\"" : "\"1\",\"0\",\"0\"") + "],\"views\":[" + v.str() + "],\"intrinsics\":[" +
           k.str() + "],\"poses\":[" + x.str() + "]}";
}

std::string realitycapture_text(const Views& views) {
    std::ostringstream out;
    out << std::setprecision(17) << "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n";
    for (const View& v : views.views) {
        const Camera& c = v.camera;
        const Vec3d centre = c.centre_world();
        // Rz(-heading) Rx(pitch) Ry(roll), from the entries of the rotation of OpenGL's axes into the world.
        const Mat3d m = c.camera_from_world.rotation.transpose() * Vec3d(1, -1, -1).asDiagonal();
        const double degrees = 180 / std::numbers::pi;
        const double pitch = std::asin(m(2, 1)), roll = std::atan2(-m(2, 0), m(2, 2)), yaw = std::atan2(-m(0, 1), m(1, 1));
        const double per_mm = std::max(c.intrinsics.width_px, c.intrinsics.height_px) / 36.0;
        out << v.name << "," << centre[0] << "," << centre[1] << "," << centre[2] << "," << -yaw * degrees << "," << pitch * degrees << "," << roll * degrees
            << "," << c.intrinsics.fx / per_mm << "," << (c.intrinsics.cx - 0.5 * c.intrinsics.width_px) / per_mm << ","
            << (c.intrinsics.cy - 0.5 * c.intrinsics.height_px) / per_mm << ",0,0,0,0,0,0\n";
    }
    return out.str();
}

std::string matlab_bytes(const Views& views) {
    std::string out;
    const auto put = [](std::string& to, auto value) { to.append(reinterpret_cast<const char*>(&value), sizeof value); };
    const auto element = [&](uint32_t type, const std::string& content) {
        std::string e;
        put(e, type);
        put(e, static_cast<uint32_t>(content.size()));
        e += content;
        e.resize((e.size() + 7) / 8 * 8, '\0');
        return e;
    };
    const auto array = [&](uint32_t matlab_class, const std::vector<int32_t>& dims, const std::string& name, const std::string& content) {
        std::string flags, sides;
        put(flags, matlab_class);
        put(flags, uint32_t{0});
        for (const int32_t d : dims) put(sides, d);
        return element(14, element(6, flags) + element(5, sides) + element(1, name) + content);
    };
    std::string cells;
    for (const View& v : views.views) {
        std::istringstream in(projection_text(v, 1.5));
        double p[12];
        for (double& x : p) in >> x;
        std::string numbers;
        for (int column = 0; column < 4; ++column)
            for (int row = 0; row < 3; ++row) put(numbers, p[4 * row + column]);
        cells += array(6, {3, 4}, "", element(9, numbers));
    }
    out = "MATLAB 5.0 MAT-file, written for a test";
    out.resize(124, ' ');
    put(out, uint16_t{0x0100});
    out += "IM";
    return out + array(1, {1, static_cast<int32_t>(views.views.size())}, "P", cells);
}

void write_colmap_text(const std::filesystem::path& folder, const Views& views) {
    std::ofstream cameras(folder / "cameras.txt"), images(folder / "images.txt");
    cameras << std::setprecision(17) << "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n";
    images << std::setprecision(17) << "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n";
    for (size_t i = 0; i < views.views.size(); ++i) {
        const Camera& c = views.views[i].camera;
        const Intrinsics& k = c.intrinsics;
        const Eigen::Quaterniond q(c.camera_from_world.rotation);
        const Vec3d& t = c.camera_from_world.translation;
        cameras << i + 5 << " PINHOLE " << k.width_px << " " << k.height_px << " " << k.fx << " " << k.fy << " " << k.cx << " " << k.cy << "\n";
        images << i + 1 << " " << q.w() << " " << q.x() << " " << q.y() << " " << q.z() << " " << t[0] << " " << t[1] << " " << t[2] << " " << i + 5 << " "
               << views.views[i].name << "\n"
               << (i % 2 ? "" : "1.5 2.5 -1 3.5 4.5 17") << "\n";
    }
}

void write_colmap_binary(const std::filesystem::path& folder, const Views& views) {
    std::ofstream cameras(folder / "cameras.bin", std::ios::binary), images(folder / "images.bin", std::ios::binary);
    const auto put = [](std::ofstream& out, auto value) { out.write(reinterpret_cast<const char*>(&value), sizeof value); };
    put(cameras, static_cast<uint64_t>(views.views.size()));
    put(images, static_cast<uint64_t>(views.views.size()));
    for (size_t i = 0; i < views.views.size(); ++i) {
        const Camera& c = views.views[i].camera;
        const Intrinsics& k = c.intrinsics;
        const Eigen::Quaterniond q(c.camera_from_world.rotation);
        put(cameras, static_cast<uint32_t>(i + 5));
        put(cameras, int32_t{1});  // PINHOLE
        put(cameras, static_cast<uint64_t>(k.width_px));
        put(cameras, static_cast<uint64_t>(k.height_px));
        for (double p : {k.fx, k.fy, k.cx, k.cy}) put(cameras, p);
        put(images, static_cast<uint32_t>(i + 1));
        for (double x :
             {q.w(), q.x(), q.y(), q.z(), c.camera_from_world.translation[0], c.camera_from_world.translation[1], c.camera_from_world.translation[2]})
            put(images, x);
        put(images, static_cast<uint32_t>(i + 5));
        images << views.views[i].name << '\0';
        const uint64_t points = i % 3;
        put(images, points);
        for (uint64_t n = 0; n < points; ++n) {
            put(images, 1.5);
            put(images, 2.5);
            put(images, int64_t{-1});
        }
    }
}

}  // namespace vdbcarve::test
