// SPDX-License-Identifier: Apache-2.0
// Cameras from a marker mat, from texture, and as the seed paper found them.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>

#include "align/mat/align_mat.h"
#include "align/paper/align_paper.h"
#include "align/mat/aruco.h"
#include "align/coherence_fit.h"
#include "align/feature_tracks.h"
#include "views/formats/camera_formats.h"
#include "support/align_scene.h"
#include "support/mat_scene.h"
#include "support/scenes.h"
#include "vdbcarve/align.h"
#include "vdbcarve/error.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/pipeline.h"

namespace vdbcarve::test {
namespace {

Progress quiet;

AlignOptions by_mat(const MatLayout& mat) {
    AlignOptions o;
    o.method = AlignMethod::Mat;
    o.mat = mat;
    return o;
}

/// Largest differences to the true cameras, in the mat's own world: degrees, and share of the distance.
std::pair<double, double> errors_of(const Views& found, const Views& truth) {
    double rotation = 0, centre = 0;
    for (const View& v : found.views) {
        const auto t = std::find_if(truth.views.begin(), truth.views.end(), [&](const View& x) { return x.name == v.name; });
        const Camera &a = v.camera, &b = t->camera;
        rotation =
            std::max(rotation, Eigen::AngleAxisd(a.camera_from_world.rotation * b.camera_from_world.rotation.transpose()).angle() * 180 / std::numbers::pi);
        centre = std::max(centre, (a.centre_world() - b.centre_world()).norm() / b.centre_world().norm());
    }
    return {rotation, centre};
}

// What a detector means by a pixel differs from method to method by half a pixel, silently; here it is measured.
TEST(Board, CornersAreFoundWhereTheyAre) {
    for (const char* text : {"grid:5x7:0.03:0.008:6X6_250", "charuco:7x9:0.025:0.018:6X6_250"}) {
        MatShoot shoot;
        shoot.mat = read_mat(text);
        shoot.views = 4;
        shoot.samples = 5;
        const MatPhotos p = photograph(shoot);
        Vec2d sum = Vec2d::Zero();
        double squares = 0;
        size_t count = 0;
        for (size_t i = 0; i < p.photos.size(); ++i) {
            const std::vector<MatCorner> corners = find_mat(shoot.mat, p.photos[i].view());
            EXPECT_GT(corners.size(), 40u) << text << " view " << i;
            for (const MatCorner& c : corners) {
                const auto at = p.views.views[i].camera.project({c.mat_m.x() - 0.5 * shoot.mat.width_m(), 0.5 * shoot.mat.height_m() - c.mat_m.y(), 0});
                sum += c.image_px - *at;
                squares += (c.image_px - *at).squaredNorm();
                ++count;
            }
        }
        EXPECT_LT((sum / static_cast<double>(count)).cwiseAbs().maxCoeff(), 0.03) << text;
        EXPECT_LT(std::sqrt(squares / static_cast<double>(count)), 0.12) << text;
    }
}

TEST(AlignMat, FindsCamerasLensAndScale) {
    for (const double k1 : {0.0, 0.09}) {
        TemporaryFolder folder;
        MatShoot shoot;
        shoot.k1 = k1;
        const MatPhotos p = photograph(shoot);
        const Views views = write_photos(p, folder.path());
        const AlignResult r = align(views, {}, by_mat(shoot.mat), quiet);
        EXPECT_TRUE(r.failures.empty());
        EXPECT_TRUE(r.left_out.empty());
        const auto [rotation, centre] = errors_of(r.views, p.views);
        EXPECT_LT(rotation, 0.1) << k1;
        EXPECT_LT(centre, 0.002) << k1;
        EXPECT_NEAR(r.focal_px / shoot.focal_px, 1, 0.003) << k1;
        EXPECT_NEAR(r.principal_x_px, 0.5 * shoot.width_px + 4.2, 1.5);
        EXPECT_LT(r.rms_px, 0.1);
        EXPECT_EQ(r.views.units, "m");
        EXPECT_EQ(r.views.up, "z");
        EXPECT_EQ(r.views.floor, 0.0);
        if (k1 != 0) {
            ASSERT_FALSE(r.views.views[0].lens.coefficients.empty());
            EXPECT_NEAR(r.views.views[0].lens.coefficients[0], k1, 0.01);
        }
        EXPECT_GT(r.focal_sd_px, 0);
        EXPECT_FALSE(r.picture.empty());
        // The same world in another unit.
        AlignOptions mm = by_mat(shoot.mat);
        mm.units = "mm";
        EXPECT_NEAR(align(views, {}, mm, quiet).views.views[0].camera.centre_world().norm() / r.views.views[0].camera.centre_world().norm(), 1000, 1e-6);
    }
}

TEST(AlignMat, AChessboardDoesAsWell) {
    TemporaryFolder folder;
    MatShoot shoot;
    shoot.mat = read_mat("charuco:7x9:0.025:0.018:5X5_100");
    const MatPhotos p = photograph(shoot);
    const AlignResult r = align(write_photos(p, folder.path()), {}, by_mat(shoot.mat), quiet);
    const auto [rotation, centre] = errors_of(r.views, p.views);
    EXPECT_LT(rotation, 0.1);
    EXPECT_LT(centre, 0.002);
}

TEST(AlignMat, PaperThatIsNotFlatIsSeenAndAllowedFor) {
    TemporaryFolder folder;
    MatShoot shoot;
    shoot.views = 16;
    shoot.curl = [](double x, double y) { return 0.12 * x * x + 0.05 * y * std::fabs(y); };  // corners up and down by some millimetres
    const MatPhotos p = photograph(shoot);
    const AlignResult r = align(write_photos(p, folder.path()), {}, by_mat(shoot.mat), quiet);
    EXPECT_LT(r.rms_px, 0.15);
    ASSERT_EQ(r.warnings.size(), 1u);
    EXPECT_NE(r.warnings[0].find("not quite the mat"), std::string::npos);
    EXPECT_NEAR(r.focal_px / shoot.focal_px, 1, 0.01);
    const auto [rotation, centre] = errors_of(r.views, p.views);
    EXPECT_LT(centre, 0.02);
    EXPECT_LT(rotation, 1);
    // Markers of another size are no curled paper.
    for (const double factor : {0.6, 1.15}) {
        MatLayout other = shoot.mat;
        other.marker_m *= factor;
        const AlignResult wrong = align(write_photos(p, folder.path()), {}, by_mat(other), quiet);
        ASSERT_FALSE(wrong.failures.empty()) << factor;
        EXPECT_NE(wrong.failures[0].find("give --mat what you measured"), std::string::npos) << wrong.failures[0];
    }
}

TEST(AlignMat, ViewsWithoutTheMatAreLeftOutByName) {
    TemporaryFolder folder;
    MatShoot shoot;
    shoot.views = 7;
    MatPhotos p = photograph(shoot);
    std::fill(p.photos[3].data.begin(), p.photos[3].data.end(), uint8_t{128});
    const Views views = write_photos(p, folder.path());
    const AlignResult r = align(views, {}, by_mat(shoot.mat), quiet);
    ASSERT_EQ(r.left_out.size(), 1u);
    EXPECT_EQ(r.left_out[0], "03.png");
    EXPECT_EQ(r.views.views.size(), 6u);
    EXPECT_EQ(r.aligned.size(), 6u);
    const std::string said = error_of(ExitCode::Input, [&] { align(views, {}, by_mat(read_mat("grid:5x7:0.03:0.008:4X4_50")), quiet); });
    EXPECT_NE(said.find("seen in 0 of 7 views"), std::string::npos) << said;
    AlignOptions none = by_mat(shoot.mat);
    none.mat.reset();
    EXPECT_NE(error_of(ExitCode::Usage, [&] { align(views, {}, none, quiet); }).find("which mat?"), std::string::npos);
    // A camera file whose lenses differ is no one camera.
    Views zoomed = p.views;
    for (size_t i = 0; i < zoomed.views.size(); ++i) zoomed.views[i].image_path = views.views[i].image_path;
    zoomed.views[4].camera.intrinsics.fx *= 1.1;
    EXPECT_NE(error_of(ExitCode::Input, [&] { align(zoomed, {}, by_mat(shoot.mat), quiet); }).find("04.png"), std::string::npos);
    zoomed.views[4].camera.intrinsics.fx /= 1.1;
    const AlignResult placed = align(zoomed, {}, by_mat(shoot.mat), quiet);
    const auto [rotation, centre] = errors_of(placed.views, p.views);
    EXPECT_LT(rotation, 0.05) << "with the lens known";
    EXPECT_LT(centre, 0.001);
    AlignOptions furlongs = by_mat(shoot.mat);
    furlongs.units = "furlong";
    EXPECT_NE(error_of(ExitCode::Usage, [&] { align(views, {}, furlongs, quiet); }).find("furlong"), std::string::npos);
}

// Photographs in, a metric mesh that stands on the mat out: a ball that is cut by the floor.
TEST(AlignPipeline, AMatGivesAMeshInMetresThatStandsOnTheFloor) {
    TemporaryFolder folder;
    MatShoot shoot;
    shoot.k1 = 0.05;
    shoot.views = 14;
    shoot.mat = read_mat("grid:5x7:0.03:0.008:6X6_250");
    shoot.ball_radius_m = 0.04;
    shoot.ball_height_m = 0.025;
    write_photos(photograph(shoot), folder / "scene");
    ReconstructOptions o;
    o.views.scene = folder / "scene";
    o.run.output = folder / "out";
    o.grid.resolution = 96;
    o.align = by_mat(shoot.mat);
    o.cameras.find_again = true;
    const auto report = nlohmann::json::parse(reconstruct(o, quiet).report_json);
    EXPECT_EQ(report["cameras"]["units"], "m");
    const Mesh mesh = read_mesh(folder / "out/mesh.ply");
    Box3d box;
    for (const auto& v : mesh.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    const double voxel = report["grid"]["voxel_size"];
    EXPECT_NEAR(box.min().z(), 0, 0.6 * voxel);
    EXPECT_NEAR(box.sizes().x(), 0.08, 0.0015);
    EXPECT_NEAR(box.sizes().y(), 0.08, 0.0015);
    EXPECT_GT(report["silhouette_iou"]["minimum"], 0.97);
    // The camera file carries the floor, so that the next run cuts there too.
    const io::Imported again = io::read_transforms(folder / "out/cameras.json");
    EXPECT_EQ(again.floor, 0.0);
    const std::string before = read_text(folder / "out/mesh.ply");
    const auto second = nlohmann::json::parse(reconstruct(o, quiet).report_json);
    for (const auto& stage : second["stages"])
        if (stage["name"] == "align" || stage["name"] == "carve") {
            EXPECT_TRUE(stage["reused"]) << stage["name"];
        }
    EXPECT_EQ(read_text(folder / "out/mesh.ply"), before);
}

// ------------------------------------------------------------------------------------- texture

/// A shoot written to a folder, with photographs, and its views.
struct Photographed {
    explicit Photographed(const SyntheticSpec& spec) : scene(synthesize(spec, quiet)) { write(); }
    void write() {
        write_scene(scene, folder.path());
        for (const Mask& m : scene.masks) masks.push_back(view_of(m));
        for (size_t i = 0; i < scene.views.views.size(); ++i) {
            scene.views.views[i].image_path = scene.nominal.views[i].image_path = folder / scene.views.views[i].name;
            ASSERT_TRUE(std::filesystem::exists(scene.views.views[i].image_path)) << scene.views.views[i].name;
        }
    }
    TemporaryFolder folder;
    SyntheticScene scene;
    std::vector<MaskView> masks;
};

/// A ball with a pattern: silhouettes say nothing about its angles.
SyntheticSpec patterned_ball() {
    SyntheticSpec spec = hand_held_orbit(3);
    spec.solids = {Solid()};
    spec.photos = true;
    spec.look.flat = true;
    spec.rig.views = 24;
    spec.rig.elevation_deg = 15;
    spec.rig.shake_angle_deg = 2;
    return spec;
}

TEST(Features, TracksLieOnTheObject) {
    const Photographed p(patterned_ball());
    std::vector<std::pair<size_t, size_t>> pairs;
    for (size_t i = 0; i + 1 < p.masks.size(); ++i) pairs.emplace_back(i, i + 1);
    const std::vector<FeatureTrack> tracks = find_tracks(p.scene.views, p.masks, pairs, quiet);
    ASSERT_GT(tracks.size(), 50u);
    std::vector<OrbitCamera> cameras;
    for (const Camera& c : p.scene.views.cameras())
        cameras.push_back(
            {c.camera_from_world.rotation, c.centre_world(), c.intrinsics.fx, c.intrinsics.fy / c.intrinsics.fx, c.intrinsics.cx, c.intrinsics.cy});
    size_t good = 0;
    for (const FeatureTrack& t : tracks) {
        const TrackedPlace at = place_of(cameras, t);
        good += at.in_front && at.rms_px() < 1.5 && std::fabs(at.place.norm() - 1) < 0.1;
        for (size_t k = 1; k < t.sightings.size(); ++k) EXPECT_LT(t.sightings[k - 1].view, t.sightings[k].view);
    }
    EXPECT_GT(static_cast<double>(good), 0.9 * static_cast<double>(tracks.size()));
}

// What a step does to the tracks' cost, all places moved along, is predicted from the step alone.
TEST(Features, ReducedRowsEqualTheBestPlaces) {
    std::mt19937 random(5);
    std::normal_distribution<double> normal;
    std::vector<OrbitView> views(6);
    for (size_t i = 0; i < views.size(); ++i) {
        views[i].width_px = 640, views[i].height_px = 480, views[i].focal_px = 900, views[i].cx = 320, views[i].cy = 240;
        views[i].azimuth_rad = 0.25 * static_cast<double>(i);
    }
    CoherenceFit f;
    f.model = OrbitModel(views, 1);
    f.model.global(OrbitModel::LnFocal).release(0, 1);
    f.model.global(OrbitModel::CentreY).release(0, 10);
    f.model.ring(0, OrbitModel::Elevation).release(0, 1);
    for (size_t i = 0; i < views.size(); ++i)
        for (int part = 0; part <= OrbitModel::Height; ++part) f.model.of(i, static_cast<OrbitModel::ViewPart>(part)).release(0, 1);
    std::vector<FeatureTrack> tracks(40);
    for (FeatureTrack& t : tracks) {
        const Vec3d place(0.1 * normal(random), 0.1 * normal(random), 0.1 * normal(random));
        const size_t first = random() % 4;
        for (size_t i = first; i < std::min<size_t>(first + 2 + random() % 3, views.size()); ++i) {
            const auto at = f.model.camera(i).camera(640, 480).project(place);
            t.sightings.push_back({static_cast<int>(i), static_cast<float>(at->x() + normal(random)), static_cast<float>(at->y() + normal(random))});
        }
    }
    f.tracks = std::make_shared<const std::vector<FeatureTrack>>(tracks);
    CoherencePass pass;
    pass.track_huber_px = 1e3;  // squares only: what the quadratic says exactly
    const std::vector<size_t> free = f.model.free();
    const TrackNormal tracked = normal_of_tracks(f, pass, free.size());
    EXPECT_NEAR(tracked.cost, track_cost(f, pass), 1e-6 * tracked.cost);
    for (const double size : {1e-4, 4e-4}) {
        Eigen::VectorXd step(static_cast<Eigen::Index>(free.size()));
        CoherenceFit moved = f;
        for (size_t k = 0; k < free.size(); ++k) {
            step[static_cast<Eigen::Index>(k)] = size * normal(random);
            moved.model.at(free[k]).value += step[static_cast<Eigen::Index>(k)];
        }
        const double change = track_cost(moved, pass) - tracked.cost;
        EXPECT_NEAR(tracked.after(step) - tracked.cost, change, 0.02 * std::fabs(change) + 1e-3 * tracked.cost) << size;
    }
}

TEST(Align, TextureFixesTheAnglesOfARoundObject) {
    const Photographed p(patterned_ball());
    AlignOptions options;
    options.method = AlignMethod::Refine;
    options.features = false;
    const AlignResult without = align(p.scene.nominal, p.masks, options, quiet);
    options.features = true;
    const AlignResult with = align(p.scene.nominal, p.masks, options, quiet);
    EXPECT_GT(with.features, 50u);
    EXPECT_LT(with.features_rms_px, 1);
    const CameraErrors a = compare_cameras(without.views.cameras(), p.scene.views.cameras(), {}),
                       b = compare_cameras(with.views.cameras(), p.scene.views.cameras(), {});
    EXPECT_GT(a.rotation_rms_deg, 0.5) << "or there would be nothing to fix";
    EXPECT_LT(b.rotation_rms_deg, 0.15);
    EXPECT_LT(b.rotation_rms_deg, 0.3 * a.rotation_rms_deg);
}

// From far away both directions explain the silhouettes; texture moves with the near side.
TEST(Align, TextureSaysWhichWayTheObjectTurned) {
    SyntheticSpec spec = hand_held_orbit(2);
    spec.rig.fov_deg = 1.5;
    spec.rig.shake_look_at = 0.001;
    spec.damage.noise_px = 0.7;
    spec.damage.correlation_px = 4;
    spec.rig.views = 24;
    spec.photos = true;
    spec.look.flat = true;
    const Photographed p(spec);
    Views given = without_cameras(p.scene.views, 1);
    AlignOptions options;
    options.features = false;
    const AlignResult blind = align(given, p.masks, options, quiet);
    EXPECT_FALSE(blind.failures.empty()) << "or there would be nothing to decide";
    options.features = true;
    const AlignResult r = align(given, p.masks, options, quiet);
    EXPECT_TRUE(r.failures.empty()) << r.failures.front();
    EXPECT_EQ(r.direction, Turn::Clockwise);  // the rig walks counterclockwise
    EXPECT_GT(r.features_near, 0.85);
}

// ------------------------------------------------------------------------------------- scale, degenerate cameras, the paper

TEST(Align, AKnownLengthGivesTheScale) {
    SyntheticSpec spec = hand_held_orbit(1);
    const SyntheticScene scene = synthesize(spec, quiet);
    std::vector<MaskView> masks;
    for (const Mask& m : scene.masks) masks.push_back(view_of(m));
    // The object's upper and lower end as a view shows them: there the hull is where the object is.
    const Camera& camera = scene.views.views[4].camera;
    std::array<Vec2d, 2> pixels{Vec2d(0, 1e9), Vec2d(0, -1e9)};
    const Image8& mask = scene.masks[4].coverage;
    for (int y = 0; y < mask.height; ++y)
        for (int x = 0; x < mask.width; ++x)
            if (mask.at(x, y) == 255) {
                if (y + 3.5 < pixels[0].y()) pixels[0] = Vec2d(x + 0.5, y + 3.5);
                if (y - 2.5 > pixels[1].y()) pixels[1] = Vec2d(x + 0.5, y - 2.5);
            }
    std::array<Vec3d, 2> places;
    for (size_t k = 0; k < 2; ++k) {
        double nearest = 1e9;
        const Camera::Ray ray = camera.ray(pixels[k]);
        for (const Solid& s : spec.solids)
            if (const auto t = s.hit(ray); t && *t < nearest) nearest = *t, places[k] = ray.origin + *t * ray.direction;
        ASSERT_LT(nearest, 1e9);
    }
    AlignOptions options;
    options.known_length = KnownLength{scene.views.views[4].name, pixels[0], pixels[1], 10 * (places[1] - places[0]).norm()};
    options.units = "mm";
    const AlignResult r = align(without_cameras(scene.views, 0), masks, options, quiet);
    EXPECT_EQ(r.views.units, "mm");
    const CameraErrors e = compare_cameras(r.views.cameras(), scene.views.cameras(), {});
    EXPECT_NEAR(e.truth_from_estimate.scale, 0.1, 0.001);
    options.known_length->from_px = Vec2d(-2, 2);
    EXPECT_NE(error_of(ExitCode::Usage, [&] { align(without_cameras(scene.views, 0), masks, options, quiet); }).find("outside of"), std::string::npos);
    options.known_length->from_px = Vec2d(2, 2);
    EXPECT_NE(error_of(ExitCode::Input, [&] { align(without_cameras(scene.views, 0), masks, options, quiet); }).find("is background in its mask"),
              std::string::npos);
}

// A floor is a height in the world that the cameras were in; only what stays in that world keeps it.
TEST(Align, AFloorStaysWithItsWorld) {
    SyntheticSpec spec = hand_held_orbit(4);
    spec.rig.views = 14;
    spec.rig.width_px = 480, spec.rig.height_px = 360;
    const SyntheticScene scene = synthesize(spec, quiet);
    std::vector<MaskView> masks;
    for (const Mask& m : scene.masks) masks.push_back(view_of(m));
    Views given = scene.nominal;
    given.floor = -1.5;
    AlignOptions options;
    options.restarts = 0;
    EXPECT_FALSE(align(given, masks, options, quiet).views.floor);
    options.method = AlignMethod::Refine;
    options.features = false;
    const AlignResult refined = align(given, masks, options, quiet);
    EXPECT_EQ(refined.views.floor, -1.5);
    options.known_distance = 100;
    const AlignResult scaled = align(given, masks, options, quiet);
    const double factor = scaled.views.views[0].camera.centre_world().norm() / refined.views.views[0].camera.centre_world().norm();
    EXPECT_NEAR(*scaled.views.floor, -1.5 * factor, 1e-9);
    EXPECT_GT(factor, 2);
}

TEST(Coherence, CamerasThatSeeNothingExplainNothing) {
    CoherenceFit f;
    f.touches = {{NAN, 0}, {NAN, 0}, {0.1, 1}};
    EXPECT_TRUE(std::isinf(f.rms_px()));
    EXPECT_TRUE(std::isinf(f.typical_px()));
    f.touches = {{NAN, 0}, {0.3, 1}, {-0.4, 1}};
    EXPECT_NEAR(f.rms_px(), std::sqrt(0.045), 1e-12);
}

TEST(Paper, EnergyMapAndPathAsInThePaper) {
    SyntheticSpec spec = hand_held_orbit(1);
    spec.rig.views = 18;
    const SyntheticScene scene = synthesize(spec, quiet);
    std::vector<MaskView> masks;
    for (const Mask& m : scene.masks) masks.push_back(view_of(m));
    AlignOptions options;
    options.method = AlignMethod::Paper;
    options.direction = Turn::Clockwise;
    const AlignResult r = align(without_cameras(scene.views, 0), masks, options, quiet);
    EXPECT_EQ(r.picture_name, "energy_map");
    EXPECT_EQ(r.picture.width, 720);
    // What the method is good for (ICCS 2013 says no numbers): angles to within a step or so.
    const CameraErrors e = compare_cameras(r.views.cameras(), scene.views.cameras(), {});
    EXPECT_LT(e.rotation_rms_deg, 25);
    std::vector<double> azimuths;
    for (const AlignedView& v : r.aligned) azimuths.push_back(v.azimuth_deg);
    double turned = 0;
    for (size_t i = 1; i < azimuths.size(); ++i) {
        const double step = std::remainder(azimuths[i] - azimuths[i - 1], 360);
        EXPECT_GT(step, 0) << "the path only goes forward";
        EXPECT_LT(step, 2 * 20 + 2);
        turned += step;
    }
    EXPECT_NEAR(turned, 340, 25);
    options.paper_views = {"0003", "0003"};
    EXPECT_NE(error_of(ExitCode::Usage, [&] { align(without_cameras(scene.views, 0), masks, options, quiet); }).find("both front and side"), std::string::npos);
    options.paper_views = {"nothing", ""};
    EXPECT_NE(error_of(ExitCode::Usage, [&] { align(without_cameras(scene.views, 0), masks, options, quiet); }).find("nothing"), std::string::npos);
}

}  // namespace
}  // namespace vdbcarve::test
