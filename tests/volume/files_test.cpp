// SPDX-License-Identifier: Apache-2.0
// Level set, mesh and files.
#include <openvdb/tools/GridOperators.h>
#include <openvdb/tools/Interpolation.h>
#include <openvdb/tools/FastSweeping.h>
#include <openvdb/tools/LevelSetMeasure.h>
#include <openvdb/tools/LevelSetSphere.h>

#include <tbb/global_control.h>

#include <random>

#include "base/atomic_file.h"
#include "volume/nanovdb_bytes.h"
#include "support/scenes.h"
#include "base/vector_loops.h"
#include "vdbcarve/export.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/raster.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

openvdb::FloatGrid::Ptr hull_of(const char* name, int resolution, bool occupancy = false, openvdb::MaskGrid::Ptr* mask = nullptr) {
    openvdb::initialize();
    const Shoot s = shoot(small_spec(name, 14, 320, 240));
    CarveOptions o = options_for(s, resolution);
    o.occupancy = occupancy;
    Progress quiet;
    CarveResult r = carve(s.inputs, o, quiet);
    if (mask) *mask = r.occupancy;
    return r.hull;
}

struct FieldQuality {
    double gradient_p5, gradient_median, gradient_p95, moved_median, moved_p95;
    size_t flipped;
};

/// |gradient| by central differences within 1.5 voxels of the surface, and how far, in voxels, the crossings of lattice edges moved.
FieldQuality quality_of(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface) {
    const double h = surface.voxelSize()[0];
    std::vector<double> gradient, moved;
    FieldQuality out{};
    auto raw = hull.getConstAccessor();
    auto phi = surface.getConstAccessor();
    for (auto it = surface.cbeginValueOn(); it; ++it) {
        const openvdb::Coord c = it.getCoord();
        out.flipped += (*it < 0) != (raw.getValue(c) < 0);
        if (std::fabs(*it) < 1.5 * h) {
            openvdb::Vec3d g;
            for (int a = 0; a < 3; ++a) {
                openvdb::Coord up = c, down = c;
                ++up[a];
                --down[a];
                g[a] = (phi.getValue(up) - phi.getValue(down)) / (2 * h);
            }
            gradient.push_back(g.length());
        }
        for (int a = 0; a < 3; ++a) {
            openvdb::Coord up = c;
            ++up[a];
            const double p0 = *it, p1 = phi.getValue(up), r0 = raw.getValue(c), r1 = raw.getValue(up);
            if ((p0 < 0) != (p1 < 0)) moved.push_back(std::fabs(p0 / (p0 - p1) - r0 / (r0 - r1)));
        }
    }
    std::sort(gradient.begin(), gradient.end());
    std::sort(moved.begin(), moved.end());
    const auto share = [](const std::vector<double>& v, double s) { return v[static_cast<size_t>(s * static_cast<double>(v.size() - 1))]; };
    out.gradient_p5 = share(gradient, 0.05);
    out.gradient_median = share(gradient, 0.5);
    out.gradient_p95 = share(gradient, 0.95);
    out.moved_median = share(moved, 0.5);
    out.moved_p95 = share(moved, 0.95);
    return out;
}

TEST(LevelSet, GradientIsOneSignsStayZeroStays) {
    for (const char* name : {"ellipsoids", "torus", "cup"}) {
        const auto hull = hull_of(name, 128);
        Progress quiet;
        const auto surface = level_set(hull->deepCopy(), {}, quiet);
        const double h = surface->voxelSize()[0];
        EXPECT_EQ(surface->getName(), "surface");
        EXPECT_EQ(surface->getGridClass(), openvdb::GRID_LEVEL_SET);
        EXPECT_FLOAT_EQ(surface->background(), static_cast<float>(3 * h));
        for (auto it = surface->cbeginValueOn(); it; ++it) ASSERT_GE(std::fabs(*it), 0.9e-6 * h);
        const FieldQuality q = quality_of(*hull, *surface);
        EXPECT_EQ(q.flipped, 0u);
        EXPECT_NEAR(q.gradient_median, 1, 0.02) << name;
        EXPECT_GE(q.gradient_p5, 0.85) << name;
        EXPECT_LE(q.gradient_p95, 1.12) << name;
        EXPECT_LE(q.moved_median, 0.02) << name;
        EXPECT_LE(q.moved_p95, 0.1) << name;
    }
    Progress quiet;
    EXPECT_THROW(level_set(openvdb::FloatGrid::create(1.f), {}, quiet), InputError);
}

// OpenVDB's fast sweeping solves the same equation to convergence from the same voxels, but takes a voxel whose
// surface crosses one axis only for farther than it is; so the fields differ by a tenth of a voxel, not by more.
TEST(LevelSet, AgreesWithFastSweeping) {
    const auto hull = hull_of("ellipsoids", 128);
    Progress quiet;
    const auto ours = level_set(hull->deepCopy(), {}, quiet);
    const auto theirs = openvdb::tools::sdfToSdf(*hull, 0.f, 2);
    const double h = hull->voxelSize()[0];
    auto other = theirs->getConstAccessor();
    double sum2 = 0;
    size_t n = 0, far = 0;
    for (auto it = ours->cbeginValueOn(); it; ++it) {
        const double d = (std::fabs(*it) - std::fabs(other.getValue(it.getCoord()))) / h;
        sum2 += d * d;
        far += std::fabs(d) > 0.5;
        ++n;
    }
    EXPECT_LT(std::sqrt(sum2 / static_cast<double>(n)), 0.15);
    EXPECT_LT(static_cast<double>(far) / static_cast<double>(n), 0.01);
}

// A plane and a ball, whose distances are known.
TEST(LevelSet, IsTheDistanceToAPlaneAndABall) {
    openvdb::initialize();
    Progress quiet;
    const openvdb::Vec3d normal = openvdb::Vec3d(1, 2, -2) / 3;
    const auto exact_at = [&](bool ball, const openvdb::Coord& c) {
        return ball ? (c.asVec3d() - openvdb::Vec3d(0.3, -0.2, 0.1)).length() - 20.4 : normal.dot(c.asVec3d()) - 0.37;
    };
    for (const bool ball : {false, true}) {
        const auto grid = openvdb::FloatGrid::create(3.f);
        grid->setGridClass(openvdb::GRID_LEVEL_SET);
        auto accessor = grid->getAccessor();
        for (const openvdb::Coord& c : openvdb::CoordBBox(openvdb::Coord(-32), openvdb::Coord(31))) {
            const double d = exact_at(ball, c);
            if (std::fabs(d) < 3.9) accessor.setValue(c, static_cast<float>(0.7 * d));  // the right zero, the wrong slope
        }
        openvdb::tools::signedFloodFill(grid->tree());
        const auto surface = level_set(grid, {}, quiet);
        double sum2 = 0;
        size_t n = 0;
        for (auto it = surface->cbeginValueOn(); it; ++it) {
            const openvdb::Coord c = it.getCoord();
            if (std::max({std::abs(c.x()), std::abs(c.y()), std::abs(c.z())}) > 26) continue;  // the plane's cut ends
            sum2 += std::pow(*it - exact_at(ball, c), 2);
            ++n;
        }
        EXPECT_LT(std::sqrt(sum2 / static_cast<double>(n)), ball ? 0.12 : 0.1);
    }
}

TEST(LevelSet, SameBitsForThreadsAndInstructionSets) {
    const auto hull = hull_of("cup", 96);
    Progress quiet;
    const auto parallel = level_set(hull->deepCopy(), {}, quiet);
    tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    const auto serial = level_set(hull->deepCopy(), {}, quiet);
    EXPECT_TRUE(parallel->tree().hasSameTopology(serial->tree()));
    for (auto it = parallel->cbeginValueAll(); it; ++it) ASSERT_EQ(*it, serial->tree().getValue(it.getCoord()));
    // A halo of random values through every set's loops.
    std::mt19937 engine(3);
    std::vector<float> halo(1000);
    for (float& v : halo) v = static_cast<float>(engine()) * 0x1p-31f - 1.f;
    std::vector<std::vector<float>> results;
    for (const VectorLoops* loops : all_vector_loops()) {
        std::vector<float> out(1024);
        loops->measure_leaf(halo.data(), 3.f, out.data());
        std::vector<float> distances(halo);
        for (float& v : distances) v = std::fabs(v) < 0.2f ? -std::fabs(v) : 3 * std::fabs(v);
        loops->redistance_leaf(distances.data(), 3.f, out.data() + 512);
        results.push_back(out);
    }
    for (const auto& r : results) EXPECT_EQ(r, results.front());
}

TEST(Density, IsOneHalfOnTheSurfaceAndOneInside) {
    openvdb::initialize();
    const auto sphere = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(20.f, openvdb::Vec3f(3, 4, 5), 0.5f, 3.f);
    const auto density = density_of(*sphere);
    EXPECT_EQ(density->getGridClass(), openvdb::GRID_FOG_VOLUME);
    EXPECT_EQ(density->getName(), "density");
    EXPECT_EQ(density->background(), 0.f);
    openvdb::tools::GridSampler<openvdb::FloatGrid, openvdb::tools::BoxSampler> sample(*density);
    std::mt19937 engine(1);
    std::normal_distribution<double> gauss;
    for (int n = 0; n < 1000; ++n) {
        const Vec3d d = Vec3d(gauss(engine), gauss(engine), gauss(engine)).normalized();
        const auto at = [&](double r) { return sample.wsSample(openvdb::Vec3d(3 + r * d.x(), 4 + r * d.y(), 5 + r * d.z())); };
        ASSERT_NEAR(at(20), 0.5, 0.02);
        ASSERT_EQ(at(15), 1);
        ASSERT_EQ(at(23), 0);
    }
    EXPECT_TRUE(density->tree().isValueOn(openvdb::Coord(6, 8, 10)));  // the middle: an active tile
}

void expect_sound(const MeshMeasures& m, const std::string& what) {
    EXPECT_TRUE(m.closed) << what;
    EXPECT_TRUE(m.manifold) << what << ": " << m.non_manifold_edges << " edges, " << m.non_manifold_vertices << " vertices";
    EXPECT_GT(m.volume, 0) << what;
    EXPECT_EQ(m.zero_area_faces, 0u) << what;
}

TEST(Mesh, ClosedManifoldOutwardAtEverySetting) {
    Progress quiet;
    for (const char* name : {"ellipsoids", "cup", "boxes"}) {
        const auto surface = level_set(hull_of(name, 112), {}, quiet);
        // Volume of the field itself: voxels inside, those at the surface in part (a linear Heaviside step one voxel wide).
        // OpenVDB's levelSetVolume is no yardstick at creases: its smeared delta is 0.5 to 1 % off there at any resolution.
        const double h = surface->voxelSize()[0];
        double volume = 0;
        const openvdb::CoordBBox box = surface->evalActiveVoxelBoundingBox();
        auto phi = surface->getConstAccessor();
        for (auto it = box.begin(); it; ++it) volume += h * h * h * std::clamp(0.5 - phi.getValue(*it) / h, 0.0, 1.0);
        for (const double adaptivity : {0.0, 0.1, 0.6}) {
            const MeshMeasures m = measure(extract_mesh(*surface, {adaptivity}, quiet));
            EXPECT_TRUE(m.manifold) << name << " " << adaptivity;
            if (adaptivity == 0) {
                expect_sound(m, name);
                EXPECT_NEAR(m.volume, volume, 0.005 * volume) << name;
            }
        }
    }
}

TEST(Mesh, TorusHasGenusOneSphereNone) {
    Progress quiet;
    const MeshMeasures torus = measure(extract_mesh(*level_set(hull_of("torus", 80), {}, quiet), {}, quiet));
    EXPECT_EQ(torus.genus, 1);
    EXPECT_EQ(torus.components, 1u);
    openvdb::initialize();
    const MeshMeasures ball = measure(extract_mesh(*openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(35.f, {}, 1.f), {}, quiet));
    EXPECT_EQ(ball.genus, 0);
    EXPECT_NEAR(ball.volume, 4.0 / 3 * 3.14159265 * 35 * 35 * 35, 0.002 * ball.volume);
}

TEST(Mesh, RandomFieldsGiveManifolds) {
    openvdb::initialize();
    std::mt19937 engine(3);
    Progress quiet;
    for (int round = 0; round < 3; ++round) {
        auto grid = openvdb::FloatGrid::create(3.f);
        grid->setGridClass(openvdb::GRID_LEVEL_SET);
        for (int i = 0; i < 24; ++i)
            for (int j = 0; j < 24; ++j)
                for (int k = 0; k < 24; ++k) grid->tree().setValue(openvdb::Coord(i, j, k), static_cast<float>(engine() % 2001) / 1000.f - 1.0001f);
        const MeshMeasures m = measure(extract_mesh(*grid, {}, quiet));
        EXPECT_TRUE(m.manifold) << m.boundary_edges << " " << m.non_manifold_edges << " " << m.non_manifold_vertices;
    }
}

TEST(Occupancy, BecomesAClosedMeshOfItsVolume) {
    openvdb::MaskGrid::Ptr mask;
    hull_of("ellipsoids", 80, true, &mask);
    Progress quiet;
    const auto surface = level_set_of_occupancy(*mask, {}, quiet);
    const MeshMeasures m = measure(extract_mesh(*surface, {}, quiet));
    expect_sound(m, "occupancy");
    const double voxels = static_cast<double>(mask->activeVoxelCount()) * std::pow(mask->voxelSize()[0], 3);
    EXPECT_NEAR(m.volume, voxels, 0.03 * voxels);
}

TEST(Measure, CountsWhatIsWrong) {
    // A tetrahedron, closed; then with a face missing, doubled, flipped; then two that share a vertex.
    Mesh t{{{{0, 0, 0}}, {{1, 0, 0}}, {{0, 1, 0}}, {{0, 0, 1}}}, {{{0, 2, 1}}, {{0, 1, 3}}, {{1, 2, 3}}, {{0, 3, 2}}}};
    MeshMeasures m = measure(t);
    EXPECT_TRUE(m.manifold);
    EXPECT_NEAR(m.volume, 1.0 / 6, 1e-7);
    EXPECT_EQ(m.genus, 0);
    Mesh open = t;
    open.triangles.pop_back();
    EXPECT_EQ(measure(open).boundary_edges, 3u);
    Mesh flipped = t;
    std::swap(flipped.triangles[0][0], flipped.triangles[0][1]);
    EXPECT_EQ(measure(flipped).non_manifold_edges, 3u);
    Mesh doubled = t;
    doubled.triangles.push_back(t.triangles[0]);
    EXPECT_EQ(measure(doubled).non_manifold_edges, 3u);
    Mesh two = t;
    for (auto& v : std::vector(t.vertices.begin() + 1, t.vertices.end())) two.vertices.push_back({-v[0], -v[1], -v[2]});
    for (auto f : t.triangles) two.triangles.push_back({f[0] ? f[0] + 3 : 0, f[2] ? f[2] + 3 : 0, f[1] ? f[1] + 3 : 0});
    m = measure(two);
    EXPECT_TRUE(m.closed);
    EXPECT_FALSE(m.manifold);
    EXPECT_EQ(m.non_manifold_vertices, 1u);
}

TEST(MeshFiles, RoundTripThroughAnotherReader) {
    openvdb::initialize();
    Progress quiet;
    const Mesh mesh = extract_mesh(*openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(8.f, {}, 1.f), {}, quiet);
    TemporaryFolder folder;
    const MeshMeasures expected = measure(mesh);
    for (const char* name : {"m.ply", "m.obj", "m.stl"}) {
        write_mesh(folder / name, mesh);
        const Mesh back = read_mesh(folder / name);  // OpenMesh's parsers
        const MeshMeasures m = measure(back);
        EXPECT_EQ(m.vertices, expected.vertices) << name;
        EXPECT_EQ(m.faces, expected.faces) << name;
        EXPECT_TRUE(m.manifold) << name;
        EXPECT_NEAR(m.volume, expected.volume, 1e-6 * expected.volume) << name;
    }
    const Mesh ply = read_mesh(folder / "m.ply");
    EXPECT_EQ(ply.vertices, mesh.vertices);
    EXPECT_EQ(ply.triangles, mesh.triangles);
    EXPECT_EQ(fs::file_size(folder / "m.stl"), 84 + 50 * mesh.triangles.size());
    EXPECT_THROW(write_mesh(folder / "m.xyz", mesh), UsageError);
    EXPECT_THROW(write_mesh(folder / "nowhere/m.ply", mesh), OutputError);
    EXPECT_THROW(read_mesh(folder / "gone.ply"), InputError);
    write_text(folder / "bad.ply", "not a ply");
    EXPECT_THROW(read_mesh(folder / "bad.ply"), InputError);
}

TEST(MeshFiles, ObjIsTurnedToYUp) {
    Mesh t{{{{1, 2, 3}}, {{4, 5, 6}}, {{7, 8, 10}}}, {{{0, 1, 2}}}};
    TemporaryFolder folder;
    const struct {
        const char* up;
        std::array<float, 3> axis;
    } cases[] = {{"x", {1, 0, 0}}, {"y", {0, 1, 0}}, {"z", {0, 0, 1}}, {"-x", {-1, 0, 0}}, {"-y", {0, -1, 0}}, {"-z", {0, 0, -1}}};
    for (const auto& c : cases) {
        t.vertices[0] = c.axis;
        write_mesh(folder / "t.obj", in_frame(t, file_frame(".obj", {c.up, "", Dcc::None, false})));
        const Mesh back = read_mesh(folder / "t.obj");
        EXPECT_EQ(back.vertices[0], (std::array<float, 3>{0, 1, 0})) << c.up;
        // A rotation, not a mirror: the triple product of the other edges stays.
        const auto det = [](const Mesh& m) {
            Mat3d d;
            for (int i = 0; i < 3; ++i)
                for (int a = 0; a < 3; ++a) d(i, a) = m.vertices[static_cast<size_t>(i)][static_cast<size_t>(a)];
            return d.determinant();
        };
        EXPECT_NEAR(det(back), det(t), 1e-4) << c.up;
    }
}

TEST(VdbFiles, RoundTripAndSameBytes) {
    const auto hull = hull_of("torus", 48);
    Progress quiet;
    const auto surface = level_set(hull, {}, quiet);
    TemporaryFolder folder;
    VdbMetadata meta{"mm", "z", 14, surface->voxelSize()[0], "abc"};
    write_vdb(folder / "a.vdb", {surface, density_of(*surface)}, meta);
    write_vdb(folder / "b.vdb", {surface, density_of(*surface)}, meta);
    EXPECT_EQ(read_text(folder / "a.vdb"), read_text(folder / "b.vdb"));
    const auto back = read_float_grid(folder / "a.vdb", "surface");
    EXPECT_EQ(back->getGridClass(), openvdb::GRID_LEVEL_SET);
    EXPECT_EQ(back->transform(), surface->transform());
    EXPECT_TRUE(back->tree().hasSameTopology(surface->tree()));
    for (auto it = surface->cbeginValueOn(); it; ++it) ASSERT_EQ(*it, back->tree().getValue(it.getCoord()));
    EXPECT_NE(error_of(ExitCode::Input, [&] { read_float_grid(folder / "a.vdb", "heat"); }).find("density"), std::string::npos);
    EXPECT_THROW(write_vdb(folder / "no/a.vdb", {surface}, meta), OutputError);
    write_text(folder / "bad.vdb", "not a vdb");
    EXPECT_THROW(read_vdb(folder / "bad.vdb"), InputError);
    // What was read from a file and written again is the same file.
    write_vdb(folder / "c.vdb", {back, density_of(*back)}, meta);
    EXPECT_EQ(read_text(folder / "a.vdb"), read_text(folder / "c.vdb"));
}

TEST(AtomicFile, NothingIsLeftOfAFileThatWasNotCommitted) {
    TemporaryFolder folder;
    write_text(folder / "kept.txt", "old");
    {
        AtomicFile file(folder / "kept.txt");
        file.stream() << "half";
    }
    EXPECT_EQ(read_text(folder / "kept.txt"), "old");
    EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), {}), 1);
}

TEST(Raster, SilhouetteOfABallIsAnEllipseAtPixelCentres) {
    openvdb::initialize();
    Progress quiet;
    const Mesh ball = extract_mesh(*openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(1.f, openvdb::Vec3f(0.3f, -0.2f, 6.f), 0.01f), {}, quiet);
    Camera c;
    c.intrinsics = {300, 280, 0, 80, 61, 160, 120, false};
    const Image8 hit = silhouette_of(ball, c);
    const Vec3d axis = Vec3d(0.3, -0.2, 6).normalized();
    const double cosine = std::cos(std::asin(1 / Vec3d(0.3, -0.2, 6).norm()));
    size_t wrong = 0;
    for (int y = 0; y < 120; ++y)
        for (int x = 0; x < 160; ++x) {
            const double margin = c.ray({x + 0.5, y + 0.5}).direction.dot(axis) - cosine;
            if (std::fabs(margin) > 2e-5) wrong += (hit.at(x, y) != 0) != (margin > 0);
        }
    EXPECT_EQ(wrong, 0u);
    const SilhouetteAgreement same = compare_silhouettes(hit, {hit.view(), {}});
    EXPECT_EQ(same.iou, 1);
    EXPECT_EQ(same.contour_p99_px, 0);
}

TEST(Raster, ContoursAreComparedWithinPixels) {
    Progress quiet;
    openvdb::initialize();
    const Mesh ball = extract_mesh(*openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(1.f, openvdb::Vec3f(0.3f, -0.2f, 6.f), 0.01f), {}, quiet);
    Camera c;
    c.intrinsics = {300, 280, 0, 80, 61, 157, 90, false};  // the picture cuts the ball
    // The ball's outline is a cone: the share of each pixel within it is exact to 1/1024.
    const Vec3d centre(0.3, -0.2, 6), axis = centre.normalized();
    const auto outline = [&](double radius) {
        Image8 out(157, 90);
        const double cosine = std::cos(std::asin(radius / centre.norm()));
        for (int y = 0; y < out.height; ++y)
            for (int x = 0; x < out.width; ++x) {
                int inside = 0;
                for (int n = 0; n < 1024; ++n) inside += c.ray({x + (n % 32 + 0.5) / 32, y + (n / 32 + 0.5) / 32}).direction.dot(axis) > cosine;
                out.at(x, y) = static_cast<uint8_t>(std::lround(inside * 255 / 1024.0));
            }
        return out;
    };
    const SoftSilhouette seen = soft_silhouette_of(ball, c);
    EXPECT_EQ(seen.hit.data, silhouette_of(ball, c).data);
    const Image8 exact = coverage_of(ball, c, 8), mask = outline(1);
    int most = 0;
    size_t other_side = 0;
    for (int y = 0; y < exact.height; ++y)
        for (int x = 0; x < exact.width; ++x) {
            const int share = seen.soft.at(x, y);
            EXPECT_EQ(share >= 128, seen.hit.at(x, y) != 0);
            if ((exact.at(x, y) >= 128) == (share >= 128)) most = std::max(most, std::abs(exact.at(x, y) - share));
            else ++other_side;
        }
    EXPECT_LE(most, 4);         // a ray, by rounding
    EXPECT_LE(other_side, 6u);  // halves are close there
    EXPECT_LE(compare_silhouettes(ball, c, {mask, {}}, true).contour_p99_px, 0.13);
    // Of a mask without grey the contour is known to pixels, and compared there.
    Image8 hard = mask;
    for (uint8_t& v : hard.data) v = v >= 128 ? 255 : 0;
    EXPECT_LE(compare_silhouettes(ball, c, {hard, {}}, false).contour_p95_px, 0.01);
    EXPECT_GT(compare_silhouettes(ball, c, {hard, {}}, true).contour_p95_px, 0.3);
    // The outline of a ball that is larger by half a pixel on the axis: 0.0103 * 300 * d^2 / (d^2 - 1)^1.5 = 0.54 px along x, less along y; distances of
    // grey contours are good to a sixteenth each, and p95 takes the larger ones.
    EXPECT_NEAR(compare_silhouettes(ball, c, {outline(1 + 0.5 * 6 / 290), {}}, true).contour_p95_px, 0.54, 0.2);
}

TEST(Nvdb, RoundTripKeepsEveryValue) {
    openvdb::initialize();
    TemporaryFolder folder;
    const Shoot shot = shoot(small_spec("cup", 8));
    Progress quiet;
    const CarveOptions o = options_for(shot, 48);
    const openvdb::FloatGrid::Ptr surface = level_set(carve(shot.inputs, o, quiet).hull, {}, quiet);
    const openvdb::FloatGrid::Ptr density = density_of(*surface);
    write_nvdb(folder / "a.nvdb", {surface, density});
    write_nvdb(folder / "b.nvdb", {surface, density});
    EXPECT_EQ(read_text(folder / "a.nvdb"), read_text(folder / "b.nvdb"));
    const auto back = read_nvdb(folder / "a.nvdb");
    ASSERT_EQ(back.size(), 2u);
    for (size_t n = 0; n < 2; ++n) {
        const openvdb::FloatGrid& was = n ? *density : *surface;
        ASSERT_TRUE(back[n]->isType<openvdb::FloatGrid>());
        const auto found = openvdb::gridPtrCast<openvdb::FloatGrid>(back[n]);
        EXPECT_EQ(back[n]->getName(), was.getName());
        EXPECT_EQ(back[n]->getGridClass(), was.getGridClass());
        EXPECT_TRUE(back[n]->transform() == was.transform());
        EXPECT_EQ(back[n]->activeVoxelCount(), was.activeVoxelCount());
        size_t differing = 0;
        for (auto it = was.cbeginValueAll(); it; ++it) differing += found->tree().getValue(it.getCoord()) != *it;
        EXPECT_EQ(differing, 0u);
    }
    EXPECT_EQ(invalid_nanovdb(to_nanovdb(*surface)), "");
    write_text(folder / "bad.nvdb", "this is no volume");
    error_of(ExitCode::Input, [&] { read_nvdb(folder / "bad.nvdb"); });
    error_of(ExitCode::Input, [&] { read_nvdb(folder / "none.nvdb"); });
}

TEST(Ply, NormalsComeBack) {
    TemporaryFolder folder;
    Mesh mesh;
    mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};
    mesh.normals = {{-0.6f, -0.6f, -0.5f}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    write_mesh(folder / "m.ply", mesh);
    const Mesh back = read_mesh(folder / "m.ply");
    EXPECT_EQ(back.vertices, mesh.vertices);
    EXPECT_EQ(back.triangles, mesh.triangles);
    EXPECT_EQ(back.normals, mesh.normals);
    mesh.normals.clear();
    write_mesh(folder / "m.ply", mesh);
    EXPECT_TRUE(read_mesh(folder / "m.ply").normals.empty());
}

}  // namespace
}  // namespace vdbcarve::test
