// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/views.h"

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validation_results.hpp>
#include <valijson/validator.hpp>

#include "image/image_io.h"
#include "base/sha256.h"
#include "support/camera_files.h"
#include "support/scenes.h"
#include "vdbcarve/export_cameras.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

Views load(const fs::path& scene, const std::function<void(ViewsOptions&)>& change = {}) {
    ViewsOptions o;
    o.scene = scene;
    if (change) change(o);
    Progress quiet;
    return load_views(o, quiet);
}

void expect_same_cameras(const Views& a, const Views& b, double tolerance) {
    ASSERT_EQ(a.views.size(), b.views.size());
    for (size_t i = 0; i < a.views.size(); ++i) {
        const Camera &x = a.views[i].camera, &y = b.views[i].camera;
        const double scale = x.camera_from_world.translation.norm();
        EXPECT_LT((x.camera_from_world.rotation - y.camera_from_world.rotation).norm(), tolerance);
        EXPECT_LT((x.camera_from_world.translation - y.camera_from_world.translation).norm(), tolerance * scale);
        EXPECT_LT((x.intrinsics.matrix() - y.intrinsics.matrix()).norm(), tolerance * x.intrinsics.fx);
        EXPECT_EQ(x.intrinsics.width_px, y.intrinsics.width_px);
        EXPECT_EQ(x.intrinsics.height_px, y.intrinsics.height_px);
        EXPECT_EQ(x.intrinsics.orthographic, y.intrinsics.orthographic);
    }
}

/// Shaken views with non-square pixels, and their pictures in a folder.
struct Written {
    TemporaryFolder folder;
    SyntheticScene scene;

    explicit Written(double aspect = 1.1, bool centred = false) {
        SyntheticSpec spec = small_spec("torus", 4, 40, 30);
        spec.photos = false;
        spec.rig.pixel_aspect = aspect;
        spec.rig.shake_angle_deg = spec.rig.shake_roll_deg = 5;
        spec.rig.shake_position = 0.03;
        Progress quiet;
        scene = synthesize(spec, quiet);
        for (View& v : scene.views.views) {
            v.name = fs::path(v.name).filename().string();
            if (!centred) {
                v.camera.intrinsics.cx += 1.7;
                v.camera.intrinsics.cy -= 0.6;
            }
        }
        fs::create_directories(folder / "images");
        for (size_t i = 0; i < scene.views.views.size(); ++i) {
            const auto png = io::encode_png(scene.masks[i].coverage);
            write_text(folder / ("images/" + scene.views.views[i].name), {png.begin(), png.end()});
        }
    }
};

TEST(Importers, Middlebury) {
    Written w;
    write_text(w.folder / "x_par.txt", middlebury_text(w.scene.views));
    const Views read = load(w.folder.path());
    EXPECT_EQ(read.format, "Middlebury");
    expect_same_cameras(read, w.scene.views, 1e-12);
    // The pixel rule can be overridden: then the principal point is half a pixel less.
    const Views corner = load(w.folder.path(), [](ViewsOptions& o) { o.pixel_centre = PixelCentre::Corner; });
    EXPECT_NEAR(corner.views[0].camera.intrinsics.cx, read.views[0].camera.intrinsics.cx - 0.5, 1e-12);
}

TEST(Importers, ColmapTextAndBinary) {
    Written w;
    fs::create_directories(w.folder / "sparse/0");
    write_colmap_text(w.folder / "sparse/0", w.scene.views);
    const Views text = load(w.folder.path());
    EXPECT_EQ(text.format, "COLMAP");
    expect_same_cameras(text, w.scene.views, 1e-12);
    // Binary wins over text, so a broken text file beside it does no harm.
    write_colmap_binary(w.folder / "sparse/0", w.scene.views);
    write_text(w.folder / "sparse/0/cameras.txt", "nonsense\n");
    expect_same_cameras(load(w.folder.path()), w.scene.views, 1e-12);
}

TEST(Importers, ColmapModels) {
    Written w(1.0);
    const std::string images = "# header\n1 1 0 0 0 0 0 4 1 0000.png\n\n2 1 0 0 0 0 0 5 1 0001.png\n0.5 0.5 -1 7 8 -1\n";
    const struct {
        const char* line;
        Lens::Model model;
        size_t coefficients;
    } models[] = {{"1 SIMPLE_PINHOLE 40 30 50 20 15", Lens::Model::None, 0},
                  {"1 PINHOLE 40 30 50 51 20 15", Lens::Model::None, 0},
                  {"1 SIMPLE_RADIAL 40 30 50 20 15 0.1", Lens::Model::SimpleRadial, 1},
                  {"1 RADIAL 40 30 50 20 15 0.1 0.2", Lens::Model::Radial, 2},
                  {"1 OPENCV 40 30 50 51 20 15 0.1 0.2 0.3 0.4", Lens::Model::OpenCV, 4},
                  {"1 OPENCV_FISHEYE 40 30 50 51 20 15 0.1 0.2 0.3 0.4", Lens::Model::OpenCVFisheye, 4},
                  {"1 FULL_OPENCV 40 30 50 51 20 15 1 2 3 4 5 6 7 8", Lens::Model::FullOpenCV, 8}};
    fs::create_directories(w.folder / "sparse");
    write_text(w.folder / "sparse/images.txt", images);
    for (const auto& m : models) {
        write_text(w.folder / "sparse/cameras.txt", std::string(m.line) + "\n");
        const Views v = load(w.folder.path());
        ASSERT_EQ(v.views.size(), 2u);
        EXPECT_EQ(v.views[0].lens.model, m.model) << m.line;
        EXPECT_EQ(v.views[0].lens.coefficients.size(), m.coefficients) << m.line;
        EXPECT_EQ(v.views[0].camera.intrinsics.fx, 50);
        EXPECT_EQ(v.views[0].camera.intrinsics.cx, 20);
        EXPECT_EQ(v.views[0].camera.intrinsics.cy, 15);
        EXPECT_EQ(v.views[1].camera.camera_from_world.translation.z(), 5);
    }
    write_text(w.folder / "sparse/cameras.txt", "1 THIN_PRISM_FISHEYE 40 30 50 51 20 15 1 2 3 4 5 6 7 8\n");
    const std::string message = error_of(ExitCode::Input, [&] { load(w.folder.path()); });
    EXPECT_NE(message.find("THIN_PRISM_FISHEYE"), std::string::npos) << message;
}

TEST(Importers, ColmapNamesMayHoldSpacesAndFolders) {
    Written w;
    fs::create_directories(w.folder / "images/left eye");
    fs::rename(w.folder / "images/0000.png", w.folder / "images/left eye/a b.png");
    fs::create_directories(w.folder / "colmap");
    write_text(w.folder / "colmap/cameras.txt", "7 PINHOLE 40 30 50 51 20 15\n");
    write_text(w.folder / "colmap/images.txt", "1 1 0 0 0 0 0 4 7 left eye/a b.png\n\n");
    EXPECT_EQ(load(w.folder.path()).views[0].name, "left eye/a b.png");
}

TEST(Importers, TransformsJson) {
    Written w;
    write_text(w.folder / "transforms.json", transforms_text(w.scene.views));
    const Views read = load(w.folder.path());
    EXPECT_EQ(read.format, "transforms.json");
    expect_same_cameras(read, w.scene.views, 1e-12);
    EXPECT_EQ(read.up, "z");
}

TEST(Importers, TransformsWithAngleAndWithoutExtensions) {
    Written w(1.0, true);
    nlohmann::json j = nlohmann::json::parse(transforms_text(w.scene.views));
    const Intrinsics& k = w.scene.views.views[0].camera.intrinsics;
    j["camera_angle_x"] = 2 * std::atan(0.5 * k.width_px / k.fx);
    for (auto& f : j["frames"]) {
        for (const char* key : {"fl_x", "fl_y", "cx", "cy", "w", "h"}) f.erase(key);
        f["file_path"] = "./images/" + fs::path(f["file_path"].get<std::string>()).stem().string();
    }
    write_text(w.folder / "transforms_train.json", j.dump());
    expect_same_cameras(load(w.folder.path()), w.scene.views, 1e-12);
}

TEST(Importers, TransformsUndoTheAppliedTransform) {
    Written w;
    // What nerfstudio does: swap axes, negate one, here with a scale as well.
    Mat4d applied = Mat4d::Zero();
    applied(0, 0) = applied(1, 2) = 2;
    applied(2, 1) = -2;
    applied(0, 3) = 0.3;
    applied(3, 3) = 1;
    nlohmann::json j = nlohmann::json::parse(transforms_text(w.scene.views));
    j["applied_transform"] = {{2, 0, 0, 0.3}, {0, 0, 2, 0}, {0, -2, 0, 0}};
    for (auto& f : j["frames"]) {
        Mat4d m;
        for (int i = 0; i < 16; ++i) m(i / 4, i % 4) = f["transform_matrix"][static_cast<size_t>(i / 4)][static_cast<size_t>(i % 4)];
        m = applied * m;
        m.topLeftCorner<3, 3>() /= 2;
        for (int i = 0; i < 16; ++i) f["transform_matrix"][static_cast<size_t>(i / 4)][static_cast<size_t>(i % 4)] = m(i / 4, i % 4);
    }
    write_text(w.folder / "transforms.json", j.dump());
    expect_same_cameras(load(w.folder.path()), w.scene.views, 1e-12);
}

TEST(Importers, ProjectionMatricesOneFileAView) {
    Written w;
    for (const View& v : w.scene.views.views) write_text(w.folder / (fs::path(v.name).stem().string() + ".pa"), projection_text(v, -0.013));
    const Views read = load(w.folder.path());
    EXPECT_EQ(read.format, "projection matrices");
    expect_same_cameras(read, w.scene.views, 1e-9);
}

TEST(Importers, ProjectionMatricesInOneFile) {
    Written w;
    std::string all;
    for (const View& v : w.scene.views.views) all += projection_text(v, 2.5) + "\n";
    write_text(w.folder / "matrices.txt", all);
    expect_same_cameras(load(w.folder.path(), [](ViewsOptions& o) { o.cameras = "matrices.txt"; }), w.scene.views, 1e-9);
}

TEST(Importers, OpenCVCalibrations) {
    Written w;
    for (const bool named : {true, false}) {
        write_text(w.folder / "calibration.yml", opencv_calibration_text(w.scene.views, named));
        const Views read = load(w.folder.path());
        EXPECT_EQ(read.format, "OpenCV");
        expect_same_cameras(read, w.scene.views, 1e-12);
    }
    std::string text = opencv_calibration_text(w.scene.views, true);
    text.replace(text.find("0., 0., 0., 0., 0. ]"), 20, "0.1, -0.2, 0.01, 0.02, 0.3 ]");
    write_text(w.folder / "calibration.yml", text);
    const Lens lens = load(w.folder.path()).views[1].lens;
    EXPECT_EQ(lens.model, Lens::Model::FullOpenCV);
    EXPECT_EQ(lens.coefficients, (std::vector<double>{0.1, -0.2, 0.01, 0.02, 0.3, 0, 0, 0}));
    // A ChArUco board's corners count from the pixel's corner.
    EXPECT_NEAR(load(w.folder.path(), [](ViewsOptions& o) { o.pixel_centre = PixelCentre::Corner; }).views[0].camera.intrinsics.cx,
                w.scene.views.views[0].camera.intrinsics.cx - 0.5, 1e-12);
}

TEST(Importers, OpenCVProjectionsInNaturalOrder) {
    Written w;
    write_text(w.folder / "cameras.xml", opencv_projections_xml(w.scene.views));
    const Views read = load(w.folder.path());
    EXPECT_EQ(read.format, "OpenCV");
    expect_same_cameras(read, w.scene.views, 1e-9);
    fs::remove(w.folder / "images/0003.png");
    EXPECT_NE(error_of(ExitCode::Input, [&] { load(w.folder.path()); }).find("4 cameras without names, but the scene has 3 images"), std::string::npos);
}

TEST(Importers, Metashape) {
    Written w;
    write_text(w.folder / "cameras.xml", metashape_text(w.scene.views, ""));
    const Views read = load(w.folder.path());
    EXPECT_EQ(read.format, "Metashape");
    expect_same_cameras(read, w.scene.views, 1e-12);
    // The lens: Metashape's formula and OpenCV's, with what was read, put a point on the same pixel.
    const double k1 = 0.1, k2 = -0.05, k3 = 0.02, p1 = 0.003, p2 = -0.004;
    write_text(w.folder / "cameras.xml", metashape_text(w.scene.views, "<k1>0.1</k1><k2>-0.05</k2><k3>0.02</k3><p1>0.003</p1><p2>-0.004</p2>"));
    const Lens lens = load(w.folder.path()).views[0].lens;
    ASSERT_EQ(lens.coefficients.size(), 8u);
    const std::vector<double>& c = lens.coefficients;
    for (const auto& [x, y] : {std::pair{0.3, -0.2}, {-0.1, 0.4}}) {
        const double r2 = x * x + y * y, metashape = 1 + k1 * r2 + k2 * r2 * r2 + k3 * r2 * r2 * r2,
                     opencv = 1 + c[0] * r2 + c[1] * r2 * r2 + c[4] * r2 * r2 * r2;
        EXPECT_NEAR(x * opencv + 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x), x * metashape + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y, 1e-12);
        EXPECT_NEAR(y * opencv + c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y, y * metashape + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y, 1e-12);
    }
    write_text(w.folder / "cameras.xml", metashape_text(w.scene.views, "<k4>0.1</k4>"));
    EXPECT_NE(error_of(ExitCode::Input, [&] { load(w.folder.path()); }).find("k4, p3 or p4 is not 0"), std::string::npos);
}

TEST(Importers, BundlerAndVisualSfm) {
    Written w(1.0, true);
    write_text(w.folder / "bundle.out", bundler_text(w.scene.views));
    EXPECT_NE(error_of(ExitCode::Input, [&] { load(w.folder.path()); }).find("no list.txt"), std::string::npos);
    std::string list;
    for (size_t i = 0; i < 4; ++i) list += (i == 3 ? "lost.png\n" : "") + ("./images/" + w.scene.views.views[i].name) + " 0 500\n";
    write_text(w.folder / "list.txt", list);
    const Views bundler = load(w.folder.path());
    EXPECT_EQ(bundler.format, "Bundler");
    expect_same_cameras(bundler, w.scene.views, 1e-12);
    fs::remove(w.folder / "bundle.out");
    write_text(w.folder / "model.nvm", nvm_text(w.scene.views));
    const Views nvm = load(w.folder.path());
    EXPECT_EQ(nvm.format, "VisualSFM");
    expect_same_cameras(nvm, w.scene.views, 1e-12);
    std::string text = nvm_text(w.scene.views);
    text.replace(text.find(" 0 0\n"), 5, " -0.1 0\n");
    write_text(w.folder / "model.nvm", text);
    EXPECT_NE(error_of(ExitCode::Input, [&] { load(w.folder.path()); }).find("bundle.rd.out"), std::string::npos);
}

TEST(Importers, OpenMvgAndMeshroom) {
    Written w(1.0);
    write_text(w.folder / "sfm_data.json", openmvg_text(w.scene.views));
    const Views openmvg = load(w.folder.path());
    EXPECT_EQ(openmvg.format, "OpenMVG or Meshroom");
    expect_same_cameras(openmvg, w.scene.views, 1e-12);
    fs::remove(w.folder / "sfm_data.json");
    for (const bool millimetres : {false, true}) {
        write_text(w.folder / "cameras.sfm", meshroom_text(w.scene.views, millimetres));
        expect_same_cameras(load(w.folder.path()), w.scene.views, 1e-12);
    }
    // The lens by name; one whose formula is not known is refused.
    std::string text = meshroom_text(w.scene.views, false);
    const std::string none = R"("distortionParams":["0","0","0"])";
    text.replace(text.find(none), none.size(), R"("distortionParams":["0.1","-0.2","0.3"])");
    write_text(w.folder / "cameras.sfm", text);
    EXPECT_EQ(load(w.folder.path()).views[0].lens.coefficients, (std::vector<double>{0.1, -0.2, 0, 0, 0.3, 0, 0, 0}));
    text.replace(text.find("radial3"), 7, "3deanam");
    write_text(w.folder / "cameras.sfm", text);
    EXPECT_NE(error_of(ExitCode::Input, [&] { load(w.folder.path()); }).find("lens '3deanam' is not supported"), std::string::npos);
}

TEST(Importers, RealityCapture) {
    Written w(1.0);
    write_text(w.folder / "cameras.csv", realitycapture_text(w.scene.views));
    const Views read = load(w.folder.path());
    EXPECT_EQ(read.format, "RealityCapture");
    expect_same_cameras(read, w.scene.views, 1e-9);
    std::string text = realitycapture_text(w.scene.views);
    text.replace(text.rfind(",0,0,0,0,0,0"), 12, ",0.1,0,0,0,0,0");
    write_text(w.folder / "cameras.csv", text);
    EXPECT_NE(error_of(ExitCode::Input, [&] { load(w.folder.path()); }).find("export undistorted images"), std::string::npos);
}

TEST(Importers, Matlab) {
    Written w;
    write_text(w.folder / "P.mat", matlab_bytes(w.scene.views));
    const Views read = load(w.folder.path());
    EXPECT_EQ(read.format, "MATLAB");
    expect_same_cameras(read, w.scene.views, 1e-9);
}

TEST(Exporters, ColmapAndTransformsComeBackTheSame) {
    Written w;
    Views views = w.scene.views;
    views.views[1].lens = {Lens::Model::OpenCV, {0.1, -0.02, 0.001, 0.002}};
    views.views[2].lens = {Lens::Model::OpenCVFisheye, {0.01, 0.02, 0.03, 0.04}};
    views.views[3].lens = {Lens::Model::Radial, {0.05, 0.06}};
    for (View& v : views.views) v.image_path = w.folder / ("images/" + v.name);
    Progress quiet;
    export_cameras(views, w.folder / "colmap", {}, quiet);
    const auto from = [&](const char* file) { return load(w.folder.path(), [&](ViewsOptions& o) { o.cameras = w.folder / file; }); };
    const Views colmap = from("colmap/sparse/0");
    EXPECT_EQ(colmap.format, "COLMAP");
    expect_same_cameras(colmap, views, 1e-12);
    EXPECT_EQ(colmap.views[2].lens.model, Lens::Model::OpenCVFisheye);
    EXPECT_EQ(colmap.views[3].lens.coefficients, (std::vector<double>{0.05, 0.06, 0, 0}));
    // transforms.json has z up, and says how it was turned.
    for (const char* up : {"z", "y", "-x", ""}) {
        views.up = up;
        export_cameras(views, w.folder / "nerf/transforms.json", {}, quiet);
        const Views nerf = from("nerf/transforms.json");
        expect_same_cameras(nerf, views, 1e-12);
        EXPECT_EQ(nerf.views[1].lens.coefficients, views.views[1].lens.coefficients);
        auto j = nlohmann::json::parse(read_text(w.folder / "nerf/transforms.json"));
        EXPECT_EQ(j.contains("vdbcarve"), false);
        if (*up == '\0' || *up == 'z') continue;
        j.erase("applied_transform");
        write_text(w.folder / "nerf/turned.json", j.dump());
        // Upright images show the axis upwards; without the note, that is z.
        Vec3d axis = Vec3d::Zero();
        axis[up[std::strlen(up) - 1] - 'x'] = up[0] == '-' ? -1 : 1;
        const Views turned = from("nerf/turned.json");
        for (size_t i = 0; i < 4; ++i)
            EXPECT_LT((turned.views[i].camera.camera_from_world.rotation * Vec3d::UnitZ() - views.views[i].camera.camera_from_world.rotation * axis).norm(),
                      1e-9);
    }
    views.views[0].camera.intrinsics.skew = 1;
    EXPECT_NE(error_of(ExitCode::Input, [&] { export_cameras(views, w.folder / "skewed", {}, quiet); }).find("skewed"), std::string::npos);
}

TEST(Exporters, UndistortedSetsFitTheirCameras) {
    TemporaryFolder folder;
    SyntheticSpec spec = small_spec("ellipsoids", 4, 160, 120);
    spec.rig.lens = {Lens::Model::OpenCV, {-0.2, 0.05, 0.001, -0.002}};
    Progress quiet;
    SyntheticScene scene = synthesize(spec, quiet);
    write_scene(scene, folder / "scene");
    spec.rig.lens = {};
    const SyntheticScene straight = synthesize(spec, quiet);
    const Views views = load(folder / "scene");
    fs::create_directories(folder / "masks");
    const Masks masks = make_masks(views, folder / "scene", {}, std::vector<fs::path>(4), quiet);
    for (size_t i = 0; i < 4; ++i) {
        const auto png = io::encode_png(masks.masks[i].coverage);
        write_text(folder / ("masks/" + mask_names(views)[i]), {png.begin(), png.end()});
    }
    CameraExportOptions o;
    o.undistort = true;
    o.masks = folder / "masks";
    export_cameras(views, folder / "set", o, quiet);
    const Views set = load(folder / "set");
    EXPECT_EQ(set.format, "COLMAP");
    expect_same_cameras(set, straight.views, 1e-9);
    const Masks found = make_masks(set, folder / "set", {}, std::vector<fs::path>(4), quiet);
    for (size_t i = 0; i < 4; ++i) {
        EXPECT_FALSE(set.views[i].lens.distorts());
        EXPECT_EQ(found.masks[i].coverage.data, masks.masks[i].coverage.data);
        const Image8 photo = load_photo8(set.views[i]);
        double off = 0;
        size_t n = 0;
        for (int y = 20; y < 100; ++y)
            for (int x = 30; x < 130; ++x, ++n) off += std::abs(static_cast<double>(photo.at(x, y, 0)) - straight.photos[i].at(x, y, 0));
        EXPECT_LT(off / static_cast<double>(n), 3);
    }
}

TEST(Importers, AMirroredWorldIsReportedAndMirroredBack) {
    Written w;
    std::string all;
    for (const View& v : w.scene.views.views) {
        View mirrored = v;
        mirrored.camera.camera_from_world.rotation.col(2) *= -1;
        all += projection_text(mirrored, 1) + "\n";
    }
    write_text(w.folder / "matrices.txt", all);
    ViewsOptions o;
    o.scene = w.folder.path();
    o.cameras = "matrices.txt";
    Progress progress;
    expect_same_cameras(load_views(o, progress), w.scene.views, 1e-9);
    ASSERT_EQ(progress.warnings().size(), 1u);
    EXPECT_NE(progress.warnings()[0].find("left-handed"), std::string::npos);
}

TEST(Importers, AProjectiveWorldIsRefusedUntilAccepted) {
    Written w;
    std::string all;
    for (View v : w.scene.views.views) {
        v.camera.intrinsics.fy *= 2;
        all += projection_text(v, 1) + "\n";
    }
    write_text(w.folder / "matrices.txt", all);
    const auto choose = [](ViewsOptions& o) { o.cameras = "matrices.txt"; };
    EXPECT_NE(error_of(ExitCode::Input, [&] { load(w.folder.path(), choose); }).find("--accept-non-metric"), std::string::npos);
    EXPECT_FALSE(load(w.folder.path(), [](ViewsOptions& o) {
                     o.cameras = "matrices.txt";
                     o.accept_non_metric = true;
                 }).metric);
}

TEST(CamerasJson, RoundTripKeepsCamerasLensAndSittings) {
    Written w;
    Views views = w.scene.views;
    views.units = "mm";
    views.up = "-y";
    views.views[0].camera.intrinsics.skew = 0.25;
    views.views[1].lens = {Lens::Model::FullOpenCV, {0.1, 0.2, 0.001, -0.002, 0.3, 0.01, 0.02, 0.03}};
    views.views[2].lens = {Lens::Model::OpenCVFisheye, {0.1, 0.2, 0.3, 0.4}};
    views.views[3].lens = {Lens::Model::OpenCV, {0.1, 0.2, 0.001, -0.002}};
    Sitting turned;
    turned.id = "turned over";
    turned.scale = 1.25;
    turned.scene_from_sitting.rotation = rotation_from_quaternion(0.2, 0.7, -0.1, 0.4);
    turned.scene_from_sitting.translation = Vec3d(0.1, 0.2, -0.3);
    views.sittings.push_back(turned);
    views.views[2].sitting = turned.id;
    write_text(w.folder / "cameras.json", cameras_json(views));
    const Views read = load(w.folder.path());
    expect_same_cameras(read, views, 1e-12);
    EXPECT_EQ(read.units, "mm");
    EXPECT_EQ(read.up, "-y");
    EXPECT_NEAR(read.views[0].camera.intrinsics.skew, 0.25, 1e-12);
    for (size_t i = 1; i < 4; ++i) {
        EXPECT_EQ(read.views[i].lens.model, views.views[i].lens.model);
        EXPECT_EQ(read.views[i].lens.coefficients, views.views[i].lens.coefficients);
    }
    ASSERT_EQ(read.sittings.size(), 2u);
    EXPECT_EQ(read.views[2].sitting, turned.id);
    EXPECT_EQ(read.sittings[1].scale, 1.25);
    // Writing what was read gives the same file: nothing drifts.
    EXPECT_EQ(cameras_json(read).size(), cameras_json(views).size());
}

TEST(CamerasJson, CanBeReadBackWhenFoldersTellTheImagesApart) {
    Written w;
    for (const char* sub : {"images/cam0", "images/cam1"}) fs::create_directories(w.folder / sub);
    Views views = w.scene.views;
    views.views.resize(2);
    for (size_t i = 0; i < 2; ++i) {
        const std::string name = "cam" + std::to_string(i) + "/shot.png";
        fs::copy_file(w.folder / ("images/" + views.views[i].name), w.folder / ("images/" + name));
        views.views[i].name = name;
        views.views[i].image_path = w.folder / ("images/" + name);
    }
    write_text(w.folder / "cameras.json", cameras_json(views));
    const Views read = load(w.folder.path());
    expect_same_cameras(read, views, 1e-12);
    EXPECT_EQ(read.views[1].image_path, w.folder / "images/cam1/shot.png");
}

TEST(CamerasJson, RotationsOfFewDigitsComeBackTheSame) {
    Written w;
    std::ostringstream text;
    text << "1\n0000.png 50 0 20 0 50 15 0 0 1 0.707107 0 0.707107 0 1 0 -0.707107 0 0.707107 0.1 0.2 4\n";
    write_text(w.folder / "x_par.txt", text.str());
    const Views first = load(w.folder.path());
    write_text(w.folder / "cameras.json", cameras_json(first));
    expect_same_cameras(load(w.folder.path()), first, 1e-12);
}

TEST(CamerasJson, SittingsMoveTheCameraIntoTheScene) {
    const Shoot s = shoot(small_spec("torus", 1, 16, 12));
    Views views = s.scene.views;
    Sitting turned;
    turned.scale = 2;
    turned.scene_from_sitting.rotation = rotation_from_quaternion(0.2, 0.7, -0.1, 0.4);
    turned.scene_from_sitting.translation = Vec3d(0.1, 0.2, -0.3);
    views.sittings = {turned};
    const Vec3d in_sitting(0.1, -0.2, 0.15), in_scene = turned.scale * (turned.scene_from_sitting * in_sitting);
    EXPECT_LT((*views.cameras()[0].project(in_scene) - *s.scene.views.views[0].camera.project(in_sitting)).norm(), 1e-9);
}

TEST(CamerasJson, FollowsItsSchema) {
    Written w;
    nlohmann::json schema_text = nlohmann::json::parse(read_text(std::string(VDBCARVE_SOURCE_DIR) + "/data/cameras.schema.json"));
    valijson::Schema schema;
    valijson::SchemaParser parser;
    parser.populateSchema(valijson::adapters::NlohmannJsonAdapter(schema_text), schema);
    nlohmann::json good = nlohmann::json::parse(cameras_json(w.scene.views));
    std::string last_error;
    const auto valid = [&](const nlohmann::json& j) {
        valijson::Validator validator;
        valijson::ValidationResults results;
        const bool ok = validator.validate(schema, valijson::adapters::NlohmannJsonAdapter(j), &results);
        valijson::ValidationResults::Error error;
        while (!ok && results.popError(error)) last_error += error.description + "; ";
        return ok;
    };
    EXPECT_TRUE(valid(good)) << last_error;
    nlohmann::json bad = good;
    bad["frames"][0].erase("fl_x");
    EXPECT_FALSE(valid(bad));
    bad = good;
    bad["vdbcarve"]["schema"] = 2;
    EXPECT_FALSE(valid(bad));
    bad = good;
    bad["frames"][0]["transform_matrix"].erase(0);
    EXPECT_FALSE(valid(bad));
}

TEST(Views, NaturalOrder) {
    std::vector<std::string> names{"image_10.jpg", "image_2.jpg", "Image_1.jpg", "image_02.jpg", "a", "image_2b.jpg"};
    std::sort(names.begin(), names.end(), natural_less);
    EXPECT_EQ(names, (std::vector<std::string>{"Image_1.jpg", "a", "image_02.jpg", "image_2.jpg", "image_2b.jpg", "image_10.jpg"}));
    for (const auto& a : names) EXPECT_FALSE(natural_less(a, a));
}

TEST(Views, MistakesAreNamed) {
    Written w;
    const auto message_with = [&](const std::function<void(nlohmann::json&)>& spoil) {
        nlohmann::json j = nlohmann::json::parse(transforms_text(w.scene.views));
        spoil(j);
        write_text(w.folder / "transforms.json", j.dump());
        return error_of(ExitCode::Input, [&] { load(w.folder.path()); });
    };
    const auto has = [](const std::string& message, const std::string& part) { EXPECT_NE(message.find(part), std::string::npos) << message; };
    has(message_with([](auto& j) { j["frames"][1]["file_path"] = "gone.png"; }), "gone.png: image not found");
    has(message_with([](auto& j) { j["frames"][2]["transform_matrix"][0][1] = nullptr; }), "frame 2");
    has(message_with([](auto& j) {
            for (size_t i = 0; i < 3; ++i) j["frames"][1]["transform_matrix"][i][0] = -j["frames"][1]["transform_matrix"][i][0].template get<double>();
        }),
        "left-handed");
    has(message_with([](auto& j) { j["frames"][0]["fl_x"] = -5; }), "fx is -5");
    has(message_with([](auto& j) {
            for (auto& f : j["frames"]) f.erase("fl_x");
        }),
        "focal length");
    has(message_with([](auto& j) { j["frames"][3]["file_path"] = j["frames"][0]["file_path"]; }), "listed twice");
    write_text(w.folder / "transforms.json", "{ not json");
    has(error_of(ExitCode::Input, [&] { load(w.folder.path()); }), "transforms.json: is not JSON");
    has(error_of(ExitCode::Input, [&] { load(w.folder / "nowhere"); }), "no such folder");
    fs::remove(w.folder / "transforms.json");
    write_text(w.folder / "a_par.txt", "0\n");
    has(error_of(ExitCode::Input, [&] { load(w.folder.path()); }), "holds no views");
    std::string nan = middlebury_text(w.scene.views);
    const size_t at = nan.find(' ', nan.find(".png")) + 1;
    nan.replace(at, nan.find(' ', at) - at, "nan");
    write_text(w.folder / "a_par.txt", nan);
    has(error_of(ExitCode::Input, [&] { load(w.folder.path()); }), "0000.png: fx is nan");
}

TEST(Views, ImagesInTheOnlyFittingSubfolder) {
    Written w;
    write_text(w.folder / "transforms.json", transforms_text(w.scene.views));
    fs::rename(w.folder / "images", w.folder / "silhouettes");
    EXPECT_EQ(load(w.folder.path()).views[0].image_path, w.folder / "silhouettes/0000.png");
}

TEST(Sha256, FipsExamples) {
    EXPECT_EQ(Sha256().hex(), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    EXPECT_EQ(Sha256().add("abc", 3).hex(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    Sha256 pieces;
    const std::string a(1000, 'a');
    for (int i = 0; i < 1000; ++i) pieces.add(a.data(), a.size());
    EXPECT_EQ(pieces.hex(), "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

}  // namespace
}  // namespace vdbcarve::test
