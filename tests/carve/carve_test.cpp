// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/carve.h"

#include <openvdb/tools/Interpolation.h>
#include <tbb/global_control.h>

#include <cmath>
#include <numeric>
#include <random>

#include "support/carve_cases.h"
#include "support/dense_oracle.h"
#include "support/same_grid.h"
#include "support/scenes.h"
#include "base/vector_loops.h"

namespace vdbcarve::test {
namespace {

class Hierarchical : public testing::TestWithParam<CarveCase> {
  protected:
    static void SetUpTestSuite() { openvdb::initialize(); }
};

TEST_P(Hierarchical, HullEqualsDenseBitForBit) {
    const Shoot s = GetParam().make();
    CarveOptions o = options_for(s, GetParam().resolution);
    GetParam().change(o);
    Progress quiet;
    const CarveResult result = carve(s.inputs, o, quiet);
    EXPECT_EQ(result.backend_used, "cpu");
    const DenseVolume dense = dense_carve(s.inputs, o, o.half_width_vox + 9);
    const auto band = static_cast<float>(o.half_width_vox * o.lattice.voxel_size);
    const auto accessor = result.hull->getConstAccessor();
    size_t differing = 0, band_voxels = 0, inside = 0, all = 0;
    for (int i = dense.box.min[0]; i < dense.box.max[0]; ++i)
        for (int j = dense.box.min[1]; j < dense.box.max[1]; ++j)
            for (int k = dense.box.min[2]; k < dense.box.max[2]; ++k) {
                const openvdb::Coord c(i, j, k);
                const float expected = dense.at(i, j, k), found = accessor.getValue(c);
                const bool active = std::fabs(expected) < band;
                differing += found != expected || accessor.isValueOn(c) != active;
                band_voxels += active;
                inside += expected < 0;
                ++all;
            }
    EXPECT_EQ(differing, 0u) << "of " << all;
    EXPECT_GT(band_voxels, 500u);
    EXPECT_GT(inside, 100u);
    EXPECT_EQ(result.hull->activeVoxelCount(), band_voxels);
    EXPECT_EQ(result.hull->getGridClass(), openvdb::GRID_LEVEL_SET);
}

TEST_P(Hierarchical, OccupancyEqualsDense) {
    const Shoot s = GetParam().make();
    CarveOptions o = options_for(s, GetParam().resolution);
    GetParam().change(o);
    o.occupancy = true;
    Progress quiet;
    const CarveResult result = carve(s.inputs, o, quiet);
    const DenseVolume dense = dense_carve(s.inputs, o, 9);
    const auto accessor = result.occupancy->getConstAccessor();
    size_t differing = 0, inside = 0;
    for (int i = dense.box.min[0]; i < dense.box.max[0]; ++i)
        for (int j = dense.box.min[1]; j < dense.box.max[1]; ++j)
            for (int k = dense.box.min[2]; k < dense.box.max[2]; ++k) {
                differing += accessor.isValueOn(openvdb::Coord(i, j, k)) != (dense.at(i, j, k) != 0);
                inside += dense.at(i, j, k) != 0;
            }
    EXPECT_EQ(differing, 0u);
    EXPECT_GT(inside, 100u);
    EXPECT_EQ(result.occupancy->activeVoxelCount(), inside);
}

INSTANTIATE_TEST_SUITE_P(Scenes, Hierarchical, testing::ValuesIn(carve_cases()), [](const auto& instance) { return instance.param.name; });

TEST(Carve, BricksMergeIntoTheWhole) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec("ellipsoids", 8));
    CarveOptions o = options_for(s, 80);
    Progress quiet;
    const auto whole = carve(s.inputs, o, quiet).hull;
    // Cuts through the object, at multiples of 8 that are no multiples of any larger node.
    const int cuts[3][4] = {{-104, -8, 8, 104}, {-104, -24, 16, 104}, {-104, 0, 24, 104}};
    std::vector<openvdb::FloatGrid::Ptr> bricks;
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b)
            for (int c = 0; c < 3; ++c) {
                o.brick = IndexBox{{cuts[0][a], cuts[1][b], cuts[2][c]}, {cuts[0][a + 1], cuts[1][b + 1], cuts[2][c + 1]}};
                bricks.push_back(carve(s.inputs, o, quiet).hull);
            }
    expect_same(*whole, *merge_bricks(bricks));
}

// Views that come one by one, in any order: after each the hull is that of a carve of all so far. Fields of known views are there where they ignore pixels
// only.
TEST_P(Hierarchical, ViewsAddedOneByOneGiveTheSameBits) {
    const CarveCase& c = GetParam();
    const Shoot s = c.make();
    CarveOptions o = options_for(s, c.resolution);
    c.change(o);
    o.allow_empty = true;
    Progress quiet;
    std::mt19937 random(7);
    std::vector<size_t> order(s.inputs.size());
    std::iota(order.begin(), order.end(), size_t{0});
    size_t asked = 0, asked_anew = 0;
    for (int round = 0; round < 2; ++round) {
        std::shuffle(order.begin(), order.end(), random);
        const auto first_of = [&](size_t n) {
            std::vector<CarveInput> out;
            for (size_t i = 0; i < n; ++i) out.push_back(s.inputs[order[i]]);
            return out;
        };
        openvdb::FloatGrid::Ptr hull = carve(first_of(2), o, quiet).hull;
        // Mostly one at a time; the last round's second step brings three.
        for (size_t known = 2; known < order.size();) {
            const size_t next = std::min(order.size(), known + (round == 1 && known == 3 ? 3 : 1));
            std::vector<CarveInput> inputs = first_of(next);
            const CarveResult whole = carve(inputs, o, quiet);
            for (size_t i = 0; i < known; ++i)
                if (s.scene.masks[order[i]].ignore.empty()) inputs[i].field = nullptr;
            const FieldSource source = [&](size_t first, size_t last) {
                std::vector<MaskView> masks;
                for (size_t i = first; i < last; ++i) masks.push_back(view_of(s.scene.masks[order[i]]));
                return distance_fields(masks, {}, quiet);
            };
            const CarveResult extended = extend_hull(hull, known, inputs, source, o, quiet);
            hull = extended.hull;
            EXPECT_NO_FATAL_FAILURE(expect_same(*whole.hull, *hull)) << "with " << next << " views";
            EXPECT_EQ(extended.statistics.leaves, whole.statistics.leaves);
            EXPECT_EQ(extended.statistics.active_voxels, whole.statistics.active_voxels);
            EXPECT_EQ(extended.statistics.clipped_share, whole.statistics.clipped_share);
            asked += extended.statistics.voxel_lookups;
            asked_anew += whole.statistics.voxel_lookups;
            known = next;
        }
    }
    std::printf("%s: %.2f of the look-ups of carving anew\n", c.name.c_str(), static_cast<double>(asked) / static_cast<double>(asked_anew));
    if (c.name == "orthographic") {
        EXPECT_LT(2 * asked, asked_anew);
    }  // whose frames hold the bounds whole
}

TEST(Carve, AHullOfOtherVoxelsIsNotExtended) {
    const Shoot s = shoot(small_spec("ellipsoids", 4));
    CarveOptions o = options_for(s, 32);
    Progress quiet;
    const auto hull = carve({s.inputs.begin(), s.inputs.end() - 1}, o, quiet).hull;
    const FieldSource none = [](size_t, size_t) { return std::vector<DistanceField>(); };
    CarveOptions other = o;
    other.lattice.voxel_size *= 1.01;
    EXPECT_THROW(extend_hull(hull->deepCopy(), 3, s.inputs, none, other, quiet), UsageError);
    other = o;
    other.occupancy = true;
    EXPECT_THROW(extend_hull(hull->deepCopy(), 3, s.inputs, none, other, quiet), UsageError);
    EXPECT_THROW(extend_hull(hull->deepCopy(), 4, s.inputs, none, o, quiet), UsageError);
    std::vector<CarveInput> bare = s.inputs;
    bare.back().field = nullptr;
    EXPECT_THROW(extend_hull(hull->deepCopy(), 3, bare, none, o, quiet), UsageError);
}

// Fields made a few views at a time: the same hull, whatever the options.
TEST_P(Hierarchical, BatchesGiveTheSameBits) {
    const CarveCase& c = GetParam();
    const Shoot s = c.make();
    CarveOptions o = options_for(s, c.resolution);
    c.change(o);
    Progress quiet;
    const FieldSource source = [&](size_t first, size_t last) {
        std::vector<MaskView> masks;
        for (size_t i = first; i < last; ++i) masks.push_back(view_of(s.scene.masks[i]));
        return distance_fields(masks, {}, quiet);
    };
    for (const bool occupancy : {false, true}) {
        o.occupancy = occupancy;
        o.allow_empty = true;
        const CarveResult whole = carve(s.inputs, o, quiet);
        for (const size_t batch : {size_t{1}, size_t{4}, s.inputs.size()}) {
            const CarveResult parts = carve_in_batches(s.inputs, batch, source, o, quiet);
            if (occupancy) {
                EXPECT_TRUE(whole.occupancy->tree().hasSameTopology(parts.occupancy->tree()));
            } else {
                EXPECT_TRUE(whole.hull->tree().hasSameTopology(parts.hull->tree()));
                size_t differing = 0;
                for (auto it = whole.hull->cbeginValueAll(); it; ++it) differing += *it != parts.hull->tree().getValue(it.getCoord());
                EXPECT_EQ(differing, 0u) << "batches of " << batch;
            }
        }
    }
}

// Photographs finer or coarser than the voxels. A contour is known to about 0.05 of a sample, which turns normals (central
// differences over two voxels) by 2 degrees at one sample a voxel and by less as samples grow finer; the automatic scale
// keeps a ball of 35 voxels radius within a degree.
TEST(Carve, FieldScaleKeepsNormals) {
    openvdb::initialize();
    struct Shot {
        double px_per_voxel;
        int scale;
    };
    for (const Shot& shot : {Shot{0.5, 1}, Shot{1, 1}, Shot{2, 1}, Shot{4, 1}, Shot{4, 2}, Shot{8, 0}, Shot{16, 0}}) {
        SyntheticSpec spec;
        Solid solid;
        solid.size = Vec3d::Constant(0.5);
        spec.solids = {solid};
        spec.rig.kind = Rig::Kind::Dome;
        spec.rig.views = 6;
        spec.rig.distance = 6;
        spec.rig.fov_deg = 12;
        const double voxel = 0.5 / 35;
        // Pixels at the ball's middle: f / distance * voxel.
        const int side = static_cast<int>(std::lround(2 * std::tan(6 * 3.14159265358979 / 180) * shot.px_per_voxel * 6 / voxel));
        spec.rig.width_px = spec.rig.height_px = side;
        spec.photos = false;
        Progress quiet;
        const SyntheticScene scene = synthesize(spec, quiet);
        CarveOptions o;
        o.lattice.voxel_size = voxel;
        o.bounds_world = Box3d(Vec3d::Constant(-0.7), Vec3d::Constant(0.7));
        const FieldPlan plan = plan_fields(scene.views.cameras(), o, shot.scale);
        EXPECT_NEAR(plan.px_per_voxel, shot.px_per_voxel, 0.05 * shot.px_per_voxel);
        if (shot.scale == 0) {
            EXPECT_GT(plan.scale, 1);
        }
        DistanceOptions d;
        d.scale = plan.scale;
        d.reach_samples = plan.reach_samples;
        std::vector<MaskView> masks;
        for (const Mask& m : scene.masks) masks.push_back(view_of(m));
        const auto fields = distance_fields(masks, d, quiet);
        std::vector<CarveInput> inputs;
        for (size_t i = 0; i < fields.size(); ++i) inputs.push_back({std::to_string(i), scene.views.cameras()[i], &fields[i]});
        const auto hull = carve(inputs, o, quiet).hull;
        // The truth is the hull of these cameras: the cone that is farthest out decides.
        double sum2 = 0;
        size_t n = 0;
        auto value = hull->getConstAccessor();
        for (auto it = hull->cbeginValueOn(); it; ++it) {
            if (std::fabs(*it) > 0.5 * voxel) continue;
            const openvdb::Coord c = it.getCoord();
            const Vec3d x = o.lattice.world_from_index(Vec3d(c.x(), c.y(), c.z()));
            std::vector<std::pair<double, Vec3d>> cones;
            for (const CarveInput& in : inputs) {
                const Vec3d eye = in.camera.centre_world(), to_x = x - eye, axis = (-eye).normalized();
                const double half_angle = std::asin(0.5 / eye.norm()), angle = std::atan2(to_x.cross(axis).norm(), to_x.dot(axis));
                // Outward normal of the cone: across its generator, away from the axis.
                const Vec3d radial = (to_x - to_x.dot(axis) * axis).normalized();
                cones.emplace_back(to_x.norm() * std::sin(angle - half_angle), std::cos(half_angle) * radial - std::sin(half_angle) * axis);
            }
            std::partial_sort(cones.begin(), cones.begin() + 2, cones.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
            // At a ridge between two cones there are two normals; on the bounds' caps neither.
            if (cones[0].first - cones[1].first < 1.5 * voxel || std::fabs(cones[0].first - *it) > 0.25 * voxel) continue;
            Vec3d g;
            for (int a = 0; a < 3; ++a) {
                openvdb::Coord up = c, down = c;
                ++up[a];
                --down[a];
                g[a] = value.getValue(up) - value.getValue(down);
            }
            const double error = std::acos(std::clamp(g.normalized().dot(cones[0].second), -1.0, 1.0)) * 180 / 3.14159265358979;
            sum2 += error * error;
            ++n;
        }
        ASSERT_GT(n, 200u);
        const double rms_deg = std::sqrt(sum2 / static_cast<double>(n));
        std::printf("%g px a voxel, samples of %d px: normals off by %.3f degrees rms\n", shot.px_per_voxel, plan.scale, rms_deg);
        EXPECT_LT(rms_deg, shot.scale == 0 ? 1.0 : 2.3 * plan.scale / shot.px_per_voxel) << shot.px_per_voxel << " px a voxel, samples of " << plan.scale;
    }
}

// Every instruction set raises a leaf to the same bits as the plain kernel.
TEST(Carve, SameBitsOnEveryInstructionSet) {
    const Shoot s = shoot(small_spec("cup", 6));
    const CarveOptions o = options_for(s, 48);
    const auto band = static_cast<float>(3 * o.lattice.voxel_size), radius = static_cast<float>(std::sqrt(3.0) * 1.5 * o.lattice.voxel_size * 1.000001);
    size_t evaluated = 0;
    for (const CarveInput& input : s.inputs) {
        const kernel::CarveView view = make_carve_view(input, o);
        for (int leaf = 0; leaf < 216; ++leaf) {
            const int origin[3] = {leaf / 36 * 8 - 24, leaf / 6 % 6 * 8 - 24, leaf % 6 * 8 - 24};
            const auto to_camera = kernel::leaf_to_camera(view, origin[0], origin[1], origin[2]);
            for (const VectorLoops* loops : all_vector_loops()) {
                std::vector<float> values(kLeafVoxels, -band);
                const CellAnswers a = loops->raise_leaf(view, origin, 0xff, radius, band, values.data());
                for (int at = 0; at < kLeafVoxels; ++at) {
                    const int in_cell = cell_order(at);
                    const kernel::Vec3 p =
                        kernel::voxel_in_camera(to_camera, static_cast<float>(at >> 6), static_cast<float>(at >> 3 & 7), static_cast<float>(at & 7));
                    const float plain = kernel::silhouette_value(view, view.silhouette, kernel::project(view, p), p.z, band);
                    if (a.out >> (in_cell >> 6) & 1) {
                        ASSERT_EQ(plain, band);
                    } else {
                        ASSERT_EQ(values[static_cast<size_t>(in_cell)], plain) << loops->name;
                    }  // cells not evaluated keep -band
                }
                evaluated += static_cast<size_t>(__builtin_popcount(a.mixed));
            }
        }
    }
    EXPECT_GT(evaluated, 1000u);
}

TEST(Carve, OccupancyBricksShareTheWholeOut) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec("ellipsoids", 8));
    CarveOptions o = options_for(s, 80);
    o.occupancy = true;
    Progress quiet;
    const auto whole = carve(s.inputs, o, quiet).occupancy;
    size_t sum = 0;
    for (const int cut : {-104, 8}) {
        o.brick = IndexBox{{cut, -104, -104}, {cut < 0 ? 8 : 104, 104, 104}};
        const auto part = carve(s.inputs, o, quiet).occupancy;
        for (auto it = part->cbeginValueOn(); it; ++it) ASSERT_TRUE(whole->tree().isValueOn(it.getCoord()));
        const openvdb::CoordBBox box = part->evalActiveVoxelBoundingBox();
        EXPECT_GE(box.min().x(), o.brick->min[0]);
        EXPECT_LT(box.max().x(), o.brick->max[0]);
        sum += part->activeVoxelCount();
    }
    EXPECT_EQ(sum, whole->activeVoxelCount());
}

TEST(Carve, SameBitsForAnyNumberOfThreads) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec("cup", 8));
    const CarveOptions o = options_for(s, 64);
    Progress quiet;
    const auto many = carve(s.inputs, o, quiet).hull;
    const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    expect_same(*many, *carve(s.inputs, o, quiet).hull);
}

TEST(Carve, MoreThanAWordOfViews) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec("ellipsoids", 150, 64, 48));
    const CarveOptions o = options_for(s, 32);
    Progress quiet;
    const auto hull = carve(s.inputs, o, quiet).hull;
    const DenseVolume dense = dense_carve(s.inputs, o, 0);
    size_t differing = 0;
    for (int i = dense.box.min[0]; i < dense.box.max[0]; ++i)
        for (int j = dense.box.min[1]; j < dense.box.max[1]; ++j)
            for (int k = dense.box.min[2]; k < dense.box.max[2]; ++k) differing += hull->tree().getValue(openvdb::Coord(i, j, k)) != dense.at(i, j, k);
    EXPECT_EQ(differing, 0u);
}

// The hull of a ball is the intersection of the cones that touch it: distances have a closed form.
TEST(Carve, HullOfABallIsTheIntersectionOfItsCones) {
    openvdb::initialize();
    SyntheticSpec spec;
    Solid ball;
    ball.size = Vec3d::Constant(0.5);
    ball.world_from_solid.translation = Vec3d(0.2, -0.1, 0.3);
    spec.solids = {ball};
    spec.rig.views = 14;
    spec.rig.elevation_deg = 20;
    spec.rig.width_px = 400;
    spec.rig.height_px = 300;
    const Shoot s = shoot(spec);
    const CarveOptions o = options_for(s, 90, 0.2);
    Progress quiet;
    const auto hull = carve(s.inputs, o, quiet).hull;
    const Vec3d centre = ball.world_from_solid.translation;
    double sum2 = 0, worst = 0;
    size_t count = 0, wrong_sign = 0;
    for (auto it = hull->cbeginValueOn(); it; ++it) {
        const openvdb::Coord c = it.getCoord();
        const Vec3d x = o.lattice.world_from_index(Vec3d(c.x(), c.y(), c.z()));
        double exact = -1e9;
        for (const CarveInput& in : s.inputs) {
            const Vec3d eye = in.camera.centre_world(), to_x = x - eye, axis = centre - eye;
            const double half_angle = std::asin(0.5 / axis.norm());
            const double angle = std::atan2(to_x.cross(axis).norm(), to_x.dot(axis));
            exact = std::max(exact, to_x.norm() * std::sin(angle - half_angle));
        }
        if (std::fabs(exact) > 1.5 * o.lattice.voxel_size) continue;
        const double error = (*it - exact) / o.lattice.voxel_size;
        sum2 += error * error;
        worst = std::max(worst, std::fabs(error));
        wrong_sign += (*it < 0) != (exact < 0) && std::fabs(exact) > 0.05 * o.lattice.voxel_size;
        ++count;
    }
    ASSERT_GT(count, 20000u);
    // A voxel is about 1.8 px here; contours are known to 0.05 px.
    EXPECT_LT(std::sqrt(sum2 / static_cast<double>(count)), 0.03);
    EXPECT_LT(worst, 0.25);
    EXPECT_EQ(wrong_sign, 0u);
}

TEST(Carve, ObjectStaysInsideItsHull) {
    openvdb::initialize();
    for (const char* name : {"ellipsoids", "cup", "boxes", "torus"}) {
        const Shoot s = shoot(small_spec(name, 16, 320, 240));
        const CarveOptions o = options_for(s, 96);
        Progress quiet;
        const auto hull = carve(s.inputs, o, quiet).hull;
        openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> sample(*hull);
        size_t outside = 0;
        for (const auto& v : s.scene.truth.vertices) outside += sample.wsSample(openvdb::Vec3d(v[0], v[1], v[2])) > 0.35 * o.lattice.voxel_size;
        EXPECT_LT(static_cast<double>(outside), 0.002 * static_cast<double>(s.scene.truth.vertices.size())) << name;
    }
}

TEST(Carve, BehindTheCameraIsOutside) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec("ellipsoids", 6));
    CarveOptions o = options_for(s, 24);
    const Vec3d eye = s.inputs[0].camera.centre_world(), away = -s.inputs[0].camera.forward_world();
    o.bounds_world = Box3d(eye + 0.5 * away - Vec3d::Constant(0.2), eye + 0.5 * away + Vec3d::Constant(0.2));
    o.lattice.voxel_size = 0.4 / 24;
    o.min_seen = 0;
    Progress quiet;
    const std::string message = error_of(ExitCode::Contradiction, [&] { carve(s.inputs, o, quiet); });
    EXPECT_NE(message.find("hull is empty"), std::string::npos) << message;
}

TEST(Carve, BoundsWhereNoCameraLooksAreAUsageError) {
    const Shoot s = shoot(small_spec("ellipsoids", 6));
    CarveOptions o = options_for(s, 24);
    o.bounds_world.translate(Vec3d(0, 0, 50));
    Progress quiet;
    const std::string message = error_of(ExitCode::Usage, [&] { carve(s.inputs, o, quiet); });
    EXPECT_NE(message.find("--bounds"), std::string::npos) << message;
}

TEST(Carve, ADeadHullNamesTheViewThatKilledIt) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec("ellipsoids", 8), [](SyntheticScene& scene) {
        Image8& mask = scene.masks[3].coverage;  // the object at the wrong end of the picture
        mask = Image8(mask.width, mask.height);
        for (int y = 0; y < 6; ++y)
            for (int x = 0; x < 6; ++x) mask.at(x, y) = 255;
    });
    Progress quiet;
    const std::string message = error_of(ExitCode::Contradiction, [&] { carve(s.inputs, options_for(s, 32), quiet); });
    EXPECT_NE(message.find(s.inputs[3].name), std::string::npos) << message;
    EXPECT_EQ(message.find(s.inputs[4].name), std::string::npos) << message;
    EXPECT_NE(message.find("--max-misses 1"), std::string::npos) << message;
    CarveOptions forgiving = options_for(s, 32);
    forgiving.max_misses = 1;
    EXPECT_GT(carve(s.inputs, forgiving, quiet).hull->activeVoxelCount(), 1000u);
}

TEST(Carve, BadOptionsAreAllNamed) {
    const Shoot s = shoot(small_spec("torus", 3));
    CarveOptions o = options_for(s, 16);
    o.max_misses = -1;
    o.min_seen = 2;
    o.half_width_vox = 1;
    Progress quiet;
    const std::string message = error_of(ExitCode::Usage, [&] { carve(s.inputs, o, quiet); });
    for (const char* part : {"max-misses is -1", "min-seen is 2", "half-width is 1"}) EXPECT_NE(message.find(part), std::string::npos) << message;
}

TEST(Carve, CancellingStops) {
    const Shoot s = shoot(small_spec("torus", 3));
    Progress progress;
    progress.cancel();
    EXPECT_THROW(carve(s.inputs, options_for(s, 64), progress), Interrupted);
}

TEST(AutomaticBounds, HoldTheHullClosely) {
    openvdb::initialize();
    for (const char* name : {"ellipsoids", "cup", "torus"}) {
        const Shoot s = shoot(small_spec(name, 12));
        CarveOptions o;
        Progress quiet;
        const Box3d box = automatic_bounds(s.inputs, o, quiet);
        // Carve a far larger box: nothing of the hull lies outside the automatic one.
        const Vec3d pad = 0.6 * box.sizes();
        o.bounds_world = Box3d(box.min() - pad, box.max() + pad);
        o.lattice.voxel_size = box.sizes().maxCoeff() / 100;
        const CarveResult wide = carve(s.inputs, o, quiet);
        Box3d hull;
        for (auto it = wide.hull->cbeginValueOn(); it; ++it)
            if (*it <= 0) hull.extend(o.lattice.world_from_index(Vec3d(it.getCoord().x(), it.getCoord().y(), it.getCoord().z())));
        EXPECT_TRUE(box.contains(hull)) << name;
        EXPECT_LT((box.sizes() - hull.sizes()).maxCoeff(), 0.06 * hull.sizes().maxCoeff()) << name;
        EXPECT_EQ(wide.statistics.clipped_share, 0) << name;
    }
}

TEST(AutomaticBounds, ParallelViewsDoNotDetermineThem) {
    const Shoot s = shoot(small_spec("ellipsoids", 1));
    CarveOptions o;
    Progress quiet;
    error_of(ExitCode::Undetermined, [&] { automatic_bounds(s.inputs, o, quiet); });
}

}  // namespace
}  // namespace vdbcarve::test
