// SPDX-License-Identifier: Apache-2.0
// OpenCV's FileStorage (YAML, XML, JSON): a calibration (camera_matrix, distortion_coefficients) with each view's rvec and tvec, world to camera; or 3x4
// matrices, whatever they are called. Calibrations of chessboards count pixels from the first one's centre; those of ChArUco boards and AprilTags from its
// corner: --pixel-centre corner.
#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "views/formats/camera_formats.h"
#include "base/text.h"

namespace vdbcarve::io {
namespace {

cv::FileStorage opened(const fs::path& file) {
    try {
        // OpenCV would log what it cannot parse; whether it is one of its files is asked first.
        std::ifstream in(file, std::ios::binary);
        std::string head(4096, '\0');
        in.read(head.data(), static_cast<std::streamsize>(head.size()));
        head.resize(static_cast<size_t>(in.gcount()));
        const std::string extension = file.extension().string();
        const bool ours = extension == ".xml"    ? head.find("<opencv_storage>") != std::string::npos
                          : extension == ".json" ? head.find("\"opencv-matrix\"") != std::string::npos
                                                 : head.rfind("%YAML", 0) == 0;
        if (ours) return {file.string(), cv::FileStorage::READ};
    } catch (const cv::Exception&) {
    }
    return {};
}

bool is_matrix(const cv::FileNode& node) { return node.isMap() && !node["data"].empty() && !node["rows"].empty(); }

cv::Mat matrix_of(const cv::FileNode& node) {
    cv::Mat out;
    if (is_matrix(node)) {
        node >> out;
    } else if (node.isSeq()) {  // plain numbers
        std::vector<double> numbers;
        for (const cv::FileNode& n : node) {
            if (!n.isReal() && !n.isInt()) return {};
            numbers.push_back(static_cast<double>(n));
        }
        out = cv::Mat(numbers, true).reshape(1, 1);
    }
    if (!out.empty()) out.convertTo(out, CV_64F);
    return out;
}

struct Named {
    std::string name;
    cv::FileNode node;
};

/// What a map or a sequence holds, maps in natural order of their names.
std::vector<Named> children(const cv::FileNode& node, const std::string& name) {
    std::vector<Named> out;
    for (const cv::FileNode& n : node) out.push_back({node.isMap() ? n.name() : name, n});
    if (node.isMap()) std::stable_sort(out.begin(), out.end(), [](const Named& a, const Named& b) { return natural_less(a.name, b.name); });
    return out;
}

struct Found {
    std::vector<NamedProjection> projections;
    struct Pose {
        std::string name;
        cv::Mat rvec, tvec;
    };
    std::vector<Pose> poses;
};

void search(const cv::FileNode& node, const std::string& name, Found& out) {
    if (is_matrix(node)) {
        const cv::Mat m = matrix_of(node);
        if (m.rows == 3 && m.cols == 4) {
            Mat34d p;
            for (int r = 0; r < 3; ++r)
                for (int c = 0; c < 4; ++c) p(r, c) = m.at<double>(r, c);
            out.projections.push_back({"", p});
        } else if (m.cols == 6 && name.find("extrinsic") != std::string::npos) {  // a row a view: rvec, tvec
            for (int r = 0; r < m.rows; ++r) out.poses.push_back({"", m(cv::Rect(0, r, 3, 1)).clone(), m(cv::Rect(3, r, 3, 1)).clone()});
        }
        return;
    }
    if (node.isMap() && !node["rvec"].empty() && !node["tvec"].empty()) {
        std::string own;
        for (const char* key : {"name", "file", "image", "filename"})
            if (own.empty() && node[key].isString()) own = static_cast<std::string>(node[key]);
        out.poses.push_back({own, matrix_of(node["rvec"]), matrix_of(node["tvec"])});
        return;
    }
    if (node.isMap() && !node["rvecs"].empty() && !node["tvecs"].empty()) {
        const std::vector<Named> r = children(node["rvecs"], ""), t = children(node["tvecs"], "");
        for (size_t i = 0; i < std::min(r.size(), t.size()); ++i) out.poses.push_back({"", matrix_of(r[i].node), matrix_of(t[i].node)});
    }
    if (node.isMap() || node.isSeq())
        for (const Named& n : children(node, name))
            if (n.name != "rvecs" && n.name != "tvecs") search(n.node, n.name, out);
}

Found everything_in(const cv::FileStorage& storage) {
    Found out;
    search(storage.root(), "", out);
    return out;
}

cv::FileNode first_of(const cv::FileNode& root, std::initializer_list<const char*> names) {
    for (const char* name : names)
        if (!root[name].empty()) return root[name];
    return {};
}

}  // namespace

bool understands_filestorage(const fs::path& file) {
    const std::string extension = file.extension().string();
    if (!fs::is_regular_file(file) || (extension != ".yml" && extension != ".yaml" && extension != ".xml" && extension != ".json")) return false;
    try {
        const cv::FileStorage storage = opened(file);
        if (!storage.isOpened()) return false;
        const Found found = everything_in(storage);
        return !found.projections.empty() || !found.poses.empty();
    } catch (const cv::Exception&) {
        return false;
    }
}

Imported read_filestorage(const fs::path& file) {
    try {
        const cv::FileStorage storage = opened(file);
        const Found found = everything_in(storage);
        if (found.poses.empty()) return imported_projections(file, found.projections);
        const cv::FileNode root = storage.root();
        const cv::Mat k = matrix_of(first_of(root, {"camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M1"})),
                      d = matrix_of(first_of(root, {"distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "D", "D1"}));
        if (k.rows != 3 || k.cols != 3) throw InputError(file.string() + ": has poses (rvec, tvec) but no 3x3 camera_matrix");
        Imported out;
        out.integer_pixel_centres = true;
        out.notes.push_back(
            "pixels are taken as counted from the first one's centre, as chessboard calibrations do. For ChArUco boards and AprilTags: --pixel-centre corner");
        Lens lens;
        std::vector<double> c(static_cast<size_t>(d.total()));
        for (size_t i = 0; i < c.size(); ++i) c[i] = d.at<double>(static_cast<int>(i));
        for (size_t i = 8; i < c.size(); ++i)
            if (c[i] != 0)
                throw InputError(file.string() + ": distortion_coefficients has thin-prism or tilt terms (number " + std::to_string(i + 1) +
                                 " is not 0); the first 8 are supported. Remedy: calibrate without them");
        c.resize(std::min<size_t>(c.size(), 8));
        const bool any = std::any_of(c.begin(), c.end(), [](double x) { return x != 0; });
        if (any && c.size() > 4) {
            c.resize(8, 0);
            lens = {Lens::Model::FullOpenCV, c};
        } else if (any) {
            c.resize(4, 0);
            lens = {Lens::Model::OpenCV, c};
        }
        const auto size_of = [&](std::initializer_list<const char*> names) {
            const cv::FileNode n = first_of(root, names);
            return n.isInt() ? static_cast<int>(n) : 0;
        };
        for (const Found::Pose& p : found.poses) {
            if (p.rvec.total() != 3 || p.tvec.total() != 3)
                throw InputError(file.string() + ": view " + (p.name.empty() ? std::to_string(out.views.size()) : p.name) +
                                 ": rvec and tvec must have 3 numbers each");
            ImportedView v;
            v.view.name = p.name;
            v.view.lens = lens;
            v.view.camera.intrinsics = {k.at<double>(0, 0),
                                        k.at<double>(1, 1),
                                        k.at<double>(0, 1),
                                        k.at<double>(0, 2),
                                        k.at<double>(1, 2),
                                        size_of({"image_width", "imageWidth", "width"}),
                                        size_of({"image_height", "imageHeight", "height"}),
                                        false};
            cv::Mat r;
            cv::Rodrigues(p.rvec, r);
            for (int a = 0; a < 3; ++a) {
                for (int b = 0; b < 3; ++b) v.view.camera.camera_from_world.rotation(a, b) = r.at<double>(a, b);
                v.view.camera.camera_from_world.translation[a] = p.tvec.at<double>(a);
            }
            out.views.push_back(v);
        }
        const auto nameless = static_cast<size_t>(std::count_if(out.views.begin(), out.views.end(), [](const ImportedView& v) { return v.view.name.empty(); }));
        if (nameless != 0 && nameless != out.views.size())
            throw InputError(file.string() + ": " + counted(nameless, "view") + " of " + std::to_string(out.views.size()) +
                             " without a name. Remedy: a name for all, or for none (then they are the images in natural order)");
        return out;
    } catch (const cv::Exception& e) {
        throw InputError(file.string() + ": " + e.what());
    }
}

}  // namespace vdbcarve::io
