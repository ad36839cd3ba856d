// SPDX-License-Identifier: Apache-2.0
// An oracle that shares no line with the product: OpenCV projects random points into the raw masks. For every
// camera format, the hull and the raw masks may differ only within a pixel of a contour.
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <openvdb/tools/Interpolation.h>

#include <random>

#include "image/image_io.h"
#include "support/camera_files.h"
#include "support/scenes.h"
#include "vdbcarve/mask.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

struct Format {
    const char* name;
    std::function<void(const fs::path&, const Views&)> write;
    double aspect;
};

void PrintTo(const Format& f, std::ostream* out) { *out << f.name; }

class Oracle : public testing::TestWithParam<Format> {};

TEST_P(Oracle, ProjectedPointsAgreeWithRawMasks) {
    openvdb::initialize();
    SyntheticSpec spec = small_spec("ellipsoids", 10, 240, 180);
    spec.photos = false;
    spec.rig.kind = Rig::Kind::Dome;
    spec.rig.pixel_aspect = GetParam().aspect;
    spec.rig.shake_angle_deg = spec.rig.shake_roll_deg = 5;
    spec.rig.shake_position = spec.rig.shake_look_at = 0.02;
    Progress quiet;
    const SyntheticScene truth = synthesize(spec, quiet);
    TemporaryFolder folder;
    Views views = truth.views;
    for (const char* sub : {"images", "masks"}) fs::create_directories(folder / sub);
    for (size_t i = 0; i < views.views.size(); ++i) {
        views.views[i].name = fs::path(views.views[i].name).filename().string();
        const auto png = io::encode_png(truth.masks[i].coverage);
        for (const char* sub : {"images/", "masks/"}) write_text(folder / (sub + views.views[i].name), {png.begin(), png.end()});
    }
    GetParam().write(folder.path(), views);

    // The product: importer, masks, fields, carve.
    ViewsOptions where;
    where.scene = folder.path();
    const Views read = load_views(where, quiet);
    const Masks masks = make_masks(read, folder.path(), {}, {}, quiet);
    std::vector<MaskView> mask_views;
    for (const Mask& m : masks.masks) mask_views.push_back(view_of(m));
    const auto fields = distance_fields(mask_views, {}, quiet);
    std::vector<CarveInput> inputs;
    for (size_t i = 0; i < fields.size(); ++i) inputs.push_back({read.views[i].name, read.cameras()[i], &fields[i]});
    CarveOptions o;
    o.bounds_world = automatic_bounds(inputs, o, quiet);
    o.lattice.voxel_size = o.bounds_world.sizes().maxCoeff() / 240;
    const auto hull = carve(inputs, o, quiet).hull;
    openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> sample(*hull);

    // The oracle: the scene's own cameras, in OpenCV's integer-centre convention, raw mask files.
    std::mt19937 engine(11);
    std::vector<cv::Point3d> points;
    for (int n = 0; n < 100000; ++n) {
        cv::Point3d p;
        double* c[3] = {&p.x, &p.y, &p.z};
        for (int a = 0; a < 3; ++a) *c[a] = o.bounds_world.min()[a] + (o.bounds_world.sizes()[a]) * static_cast<double>(engine()) / 4294967295.0;
        points.push_back(p);
    }
    std::vector<bool> inside(points.size(), true);
    std::vector<double> nearest(points.size(), 1e9);
    for (const View& v : views.views) {
        const Intrinsics& k = v.camera.intrinsics;
        const cv::Mat mask = cv::imread((folder / ("masks/" + v.name)).string(), cv::IMREAD_GRAYSCALE);
        cv::Mat to_object, to_background, binary = mask >= 128;
        cv::distanceTransform(~binary, to_object, cv::DIST_L2, cv::DIST_MASK_PRECISE);
        cv::distanceTransform(binary, to_background, cv::DIST_L2, cv::DIST_MASK_PRECISE);
        cv::Mat rotation(3, 3, CV_64F), rvec, camera = (cv::Mat_<double>(3, 3) << k.fx, 0, k.cx - 0.5, 0, k.fy, k.cy - 0.5, 0, 0, 1);
        for (int i = 0; i < 9; ++i) rotation.at<double>(i / 3, i % 3) = v.camera.camera_from_world.rotation(i / 3, i % 3);
        cv::Rodrigues(rotation, rvec);
        const cv::Vec3d t(v.camera.camera_from_world.translation[0], v.camera.camera_from_world.translation[1], v.camera.camera_from_world.translation[2]);
        std::vector<cv::Point2d> projected;
        cv::projectPoints(points, rvec, t, camera, cv::noArray(), projected);
        for (size_t n = 0; n < points.size(); ++n) {
            const int x = cvRound(projected[n].x), y = cvRound(projected[n].y);
            if (x < 0 || y < 0 || x >= mask.cols || y >= mask.rows) continue;  // says nothing
            if (!binary.at<uint8_t>(y, x)) inside[n] = false;
            nearest[n] = std::min<double>(nearest[n], std::max(to_object.at<float>(y, x), to_background.at<float>(y, x)));
        }
    }
    size_t disagree = 0, unexplained = 0, in = 0;
    for (size_t n = 0; n < points.size(); ++n) {
        in += inside[n];
        const bool hull_inside = sample.wsSample(openvdb::Vec3d(points[n].x, points[n].y, points[n].z)) < 0;
        if (hull_inside == inside[n]) continue;
        ++disagree;
        unexplained += nearest[n] > 1.0 + 1e-6;  // distances between pixel centres: 1 is next to the contour
    }
    RecordProperty("disagree", static_cast<int>(disagree));
    std::cout << GetParam().name << ": " << disagree << " of 100000 points disagree (" << in << " inside), " << unexplained
              << " farther than 1 px from a contour\n";
    EXPECT_EQ(unexplained, 0u);
    EXPECT_GT(in, 5000u);
    EXPECT_LT(disagree, 1500u);
}

void write_pa(const fs::path& folder, const Views& views) {
    for (const View& v : views.views) write_text(folder / (fs::path(v.name).stem().string() + ".pa"), projection_text(v, -0.7));
}
void write_colmap(const fs::path& folder, const Views& views, bool binary) {
    fs::create_directories(folder / "sparse/0");
    binary ? write_colmap_binary(folder / "sparse/0", views) : write_colmap_text(folder / "sparse/0", views);
}

INSTANTIATE_TEST_SUITE_P(
    Formats, Oracle,
    testing::Values(Format{"middlebury", [](const fs::path& f, const Views& v) { write_text(f / "s_par.txt", middlebury_text(v)); }, 1.2},
                    Format{"transforms", [](const fs::path& f, const Views& v) { write_text(f / "transforms.json", transforms_text(v)); }, 0.9},
                    Format{"colmap_text", [](const fs::path& f, const Views& v) { write_colmap(f, v, false); }, 1.1},
                    Format{"colmap_binary", [](const fs::path& f, const Views& v) { write_colmap(f, v, true); }, 1.1},
                    Format{"projection_matrices", write_pa, 1.05},
                    Format{"cameras_json", [](const fs::path& f, const Views& v) { write_text(f / "cameras.json", cameras_json(v)); }, 1.3}),
    [](const auto& instance) { return std::string(instance.param.name); });

}  // namespace
}  // namespace vdbcarve::test
