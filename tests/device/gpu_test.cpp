// SPDX-License-Identifier: Apache-2.0
// The device's results against the CPU's, bit for bit, stage by stage. Without a device these tests are skipped and say why, or
// fail where VDBCARVE_REQUIRE_GPU=1.
#include <openvdb/tools/LevelSetSphere.h>

#include <cstdlib>
#include <random>

#include "device/device_session.h"
#include "mesh/marching_cubes.h"
#include "volume/nanovdb_bytes.h"
#include "volume/same_transform.h"
#include "device/gpu_fixture.h"
#include "support/carve_cases.h"
#include "support/color_cases.h"
#include "support/dented_ball.h"
#include "support/noise_grid.h"
#include "support/packed_scene.h"
#include "support/same_grid.h"
#include "vdbcarve/device.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/render.h"

namespace vdbcarve::test {
namespace {

class GpuScenes : public Gpu, public testing::WithParamInterface<CarveCase> {};

void expect_same_field(const SampledField& a, const SampledField& b) {
    EXPECT_EQ(a.x0, b.x0);
    EXPECT_EQ(a.y0, b.y0);
    ASSERT_EQ(a.width, b.width);
    ASSERT_EQ(a.height, b.height);
    EXPECT_EQ(a.reach, b.reach);
    EXPECT_TRUE(std::equal(a.cut, a.cut + 4, b.cut));
    EXPECT_EQ(a.blocks_per_row, b.blocks_per_row);
    EXPECT_EQ(a.samples, b.samples);
    EXPECT_EQ(a.blocks, b.blocks);
}

void expect_same_mesh(const Mesh& a, const Mesh& b) {
    EXPECT_GT(a.vertices.size(), 0u);
    EXPECT_EQ(a.vertices, b.vertices);
    EXPECT_EQ(a.triangles, b.triangles);
    EXPECT_EQ(a.normals, b.normals);
}

/// The device's grid is what NanoVDB makes of the CPU's, to the byte, and valid.
void expect_nanovdb_of(const openvdb::FloatGrid& grid, const NanoBuffer& found) {
    EXPECT_EQ(invalid_nanovdb(found), "");
    const NanoBuffer expected = to_nanovdb(grid);
    ASSERT_EQ(found.size, expected.size);
    std::string differing;
    size_t count = 0;
    for (size_t n = 0; n < found.size; ++n)
        if (found.data[n] != expected.data[n] && count++ < 20) differing += " " + std::to_string(n);
    EXPECT_EQ(count, 0u) << "bytes" << differing << " of " << found.size;
}

openvdb::FloatGrid::Ptr copy_of(const openvdb::FloatGrid& grid) {
    openvdb::FloatGrid::Ptr out = grid.deepCopy();
    out->setTransform(same_transform(grid.transform()));
    return out;
}

Mask random_mask(int width, int height, uint32_t seed, bool soft, bool ignores) {
    std::mt19937 random(seed);
    Mask out;
    out.coverage = Image8(width, height);
    for (int blob = 0; blob < 4; ++blob) {
        const double cx = static_cast<double>(random() % static_cast<unsigned>(width)), cy = static_cast<double>(random() % static_cast<unsigned>(height)),
                     r = 3 + random() % 20;
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                const double c = std::clamp(r - std::hypot(x - cx, y - cy) + 0.5, 0.0, 1.0);
                out.coverage.at(x, y) = std::max(out.coverage.at(x, y), static_cast<uint8_t>(soft ? 255 * c : (c >= 0.5 ? 255 : 0)));
            }
    }
    for (int n = 0; n < 60; ++n) out.coverage.data[random() % out.coverage.data.size()] = static_cast<uint8_t>(random() % 256);
    if (ignores) {
        out.ignore = Image8(width, height);
        for (int y = height / 3; y < height / 2; ++y)
            for (int x = 0; x < width / 2; ++x) out.ignore.at(x, y) = 1;
    }
    return out;
}

TEST_F(Gpu, DistanceFieldsEqualTheCpus) {
    std::vector<Mask> masks;
    for (uint32_t seed = 0; seed < 12; ++seed)
        masks.push_back(random_mask(33 + 29 * static_cast<int>(seed), 140 - 9 * static_cast<int>(seed), seed, seed % 2, seed % 3 == 2));
    masks.push_back({Image8(40, 30), {}});
    masks.push_back({Image8(40, 30, 1, 255), {}});
    masks.push_back(random_mask(1024, 768, 99, true, false));
    masks.push_back({});
    std::vector<MaskView> views;
    for (const Mask& m : masks) views.push_back(view_of(m));
    Device device;
    for (const double reach : {4.0, 9.0, 31.5, 190.0, 500.0})
        for (const int scale : {1, 2, 3})
            for (const double offset : {0.0, 2.25, -1.5})
                for (const bool conservative : {false, true}) {
                    SCOPED_TRACE("reach " + std::to_string(reach) + ", scale " + std::to_string(scale) + ", offset " + std::to_string(offset));
                    DistanceOptions o;
                    o.reach_samples = reach;
                    o.scale = scale;
                    o.silhouette_offset_px = offset;
                    o.conservative = conservative;
                    const std::vector<DistanceField> cpu = distance_fields(views, o, quiet_);
                    const std::vector<DistanceField> gpu = distance_fields(device, views, o, quiet_);
                    ASSERT_EQ(cpu.size(), gpu.size());
                    for (size_t v = 0; v < cpu.size(); ++v) {
                        SCOPED_TRACE("mask " + std::to_string(v));
                        EXPECT_TRUE(std::equal(cpu[v].object_box, cpu[v].object_box + 4, gpu[v].object_box));
                        EXPECT_EQ(cpu[v].scale, gpu[v].scale);
                        EXPECT_EQ(cpu[v].mask_width, gpu[v].mask_width);
                        expect_same_field(cpu[v].silhouette, gpu[v].silhouette);
                        expect_same_field(cpu[v].ignored, gpu[v].ignored);
                        if (HasFailure()) return;
                    }
                }
}

TEST_P(GpuScenes, HullLevelSetAndMeshEqualTheCpus) {
    const Shoot s = GetParam().make();
    CarveOptions o = options_for(s, GetParam().resolution);
    GetParam().change(o);
    const CarveResult cpu = carve(s.inputs, o, quiet_);
    ASSERT_EQ(cpu.backend_used, "cpu");
    Device one_by_one;
    const CarveResult gpu = carve(one_by_one, s.inputs, o, quiet_);
    ASSERT_EQ(gpu.backend_used, "cuda");
    expect_same(*cpu.hull, *gpu.hull);
    EXPECT_EQ(cpu.statistics.leaves, gpu.statistics.leaves);
    EXPECT_EQ(cpu.statistics.inside_voxels, gpu.statistics.inside_voxels);
    EXPECT_EQ(cpu.statistics.clipped_share, gpu.statistics.clipped_share);
    EXPECT_EQ(cpu.statistics.active_voxels, gpu.statistics.active_voxels);
    EXPECT_GT(gpu.statistics.voxel_lookups, 0u);

    // The same without coming home between stages, from the masks.
    Device device;
    std::vector<MaskView> masks;
    for (const Mask& m : s.scene.masks) masks.push_back(view_of(m));
    device.upload(masks);
    device.distance({});
    device.carve(s.inputs, o, quiet_);
    expect_same(*cpu.hull, *device.hull());
    expect_nanovdb_of(*cpu.hull, device.hull_nanovdb());
    LevelSetOptions l;
    l.half_width_vox = o.half_width_vox;
    const auto surface = level_set(copy_of(*cpu.hull), l, quiet_);
    device.level_set(l);
    expect_same(*surface, *device.surface());
    expect_nanovdb_of(*surface, device.surface_nanovdb());
    expect_same(*surface, *level_set(one_by_one, *cpu.hull, l, quiet_));
    for (const bool normals : {false, true}) {
        const Mesh mesh = marching_cubes(*surface, normals);
        ASSERT_TRUE(device.extract_mesh(normals));
        expect_same_mesh(mesh, device.fetch_mesh(normals));
        MeshOptions m;
        m.mesher = Mesher::MarchingCubes;
        m.normals = normals;
        expect_same_mesh(mesh, extract_mesh(one_by_one, *surface, m, quiet_));
        EXPECT_TRUE(measure(mesh).manifold);
    }
    // Again on the same buffers.
    device.carve(s.inputs, o, quiet_);
    expect_same(*cpu.hull, *device.hull());
}

TEST_P(GpuScenes, OccupancyEqualsTheCpus) {
    const Shoot s = GetParam().make();
    CarveOptions o = options_for(s, GetParam().resolution);
    GetParam().change(o);
    o.occupancy = true;
    const CarveResult cpu = carve(s.inputs, o, quiet_);
    Device device;
    const CarveResult gpu = carve(device, s.inputs, o, quiet_);
    EXPECT_EQ(gpu.backend_used, "cuda");
    EXPECT_TRUE(cpu.occupancy->tree().hasSameTopology(gpu.occupancy->tree()));
    EXPECT_EQ(cpu.occupancy->activeVoxelCount(), gpu.occupancy->activeVoxelCount());
    EXPECT_EQ(cpu.occupancy->tree().nodeCount(), gpu.occupancy->tree().nodeCount());
    LevelSetOptions l;
    const auto surface = level_set_of_occupancy(*cpu.occupancy, l, quiet_);
    expect_same(*surface, *level_set_of_occupancy(device, *gpu.occupancy, l, quiet_));
}

INSTANTIATE_TEST_SUITE_P(Scenes, GpuScenes, testing::ValuesIn(carve_cases()), [](const auto& instance) { return instance.param.name; });

TEST_F(Gpu, BricksManyViewsAndManyMissesEqualTheCpus) {
    Shoot s = shoot(small_spec("ellipsoids", 8));
    CarveOptions o = options_for(s, 80);
    o.brick = IndexBox{{-104, -24, 0}, {-8, 16, 104}};
    const auto both = [&] {
        Device device;
        expect_same(*carve(s.inputs, o, quiet_).hull, *carve(device, s.inputs, o, quiet_).hull);
        o.occupancy = true;
        const auto bits = carve(s.inputs, o, quiet_).occupancy;
        EXPECT_TRUE(bits->tree().hasSameTopology(carve(device, s.inputs, o, quiet_).occupancy->tree()));
        o.occupancy = false;
    };
    both();
    s = shoot(small_spec("ellipsoids", 150, 64, 48));
    o = options_for(s, 32);
    both();
    o.max_misses = 15;
    both();
    // Blocks of 128^3 in several upper nodes, at negative indices.
    s = shoot(small_spec("torus", 10));
    o = options_for(s, 300);
    both();
    o.lattice.origin_world = Vec3d(-4096.5, 4090, 8200) * o.lattice.voxel_size;
    both();
}

TEST_F(Gpu, NoiseMeshesAndLevelSetsEqualTheCpus) {
    for (const bool smooth : {false, true})
        for (const bool tiny : {false, true}) {
            const auto grid = noise_grid(44, smooth, tiny, 7);
            Device device;
            device.set_surface(*grid);
            expect_nanovdb_of(*grid, device.surface_nanovdb());
            ASSERT_TRUE(device.extract_mesh(true));
            expect_same_mesh(marching_cubes(*grid, true), device.fetch_mesh(true));
            device.set_hull(*grid);
            device.level_set({});
            // Compared as it lies on the device: noise has no inside and outside for tiles to follow.
            expect_nanovdb_of(*level_set(copy_of(*grid), {}, quiet_), device.surface_nanovdb());
        }
}

// Every filter on a hull with thin parts, on one that lies across blocks and upper nodes, and on noise; with protection, repair and neither.
TEST_F(Gpu, FiltersEqualTheCpus) {
    std::vector<openvdb::FloatGrid::Ptr> surfaces;
    const Shoot cup = shoot(small_spec("cup", 9)), torus = shoot(small_spec("torus", 10));
    surfaces.push_back(level_set(carve(cup.inputs, options_for(cup, 90), quiet_).hull, {}, quiet_));
    CarveOptions far = options_for(torus, 260);
    far.lattice.origin_world = Vec3d(-4096.5, 4090, 8200) * far.lattice.voxel_size;
    LevelSetOptions wide;
    wide.half_width_vox = 5;
    surfaces.push_back(level_set(carve(torus.inputs, far, quiet_).hull, wide, quiet_));
    for (const bool smooth : {false, true}) {
        // Noise has no inside and outside for tiles to follow: a shell of leaves that are all outside gives it one.
        auto noise = noise_grid(44, smooth, false, 9);
        surfaces.push_back(level_set(noise, {}, quiet_));
        surfaces.back()->setName("surface");
    }
    Device device;
    for (size_t n = 0; n < surfaces.size(); ++n)
        for (const char* chain : {"median:1", "median:2", "laplacian:1x3", "mean-curvature:1x2", "gaussian:1", "gaussian:4", "edge-preserving:1",
                                  "edge-preserving:2x2", "median:1,laplacian:1x2,edge-preserving:2"})
            for (const double keep_thin : {0.0, 2.5, 4.0})
                for (const bool repair : {true, false}) {
                    SCOPED_TRACE("surface " + std::to_string(n) + ", " + chain + ", keep-thin " + std::to_string(keep_thin) + (repair ? ", repaired" : ""));
                    FilterOptions o;
                    o.steps = parse_filters(chain);
                    o.keep_thin_vox = keep_thin;
                    o.repair_volume = repair;
                    const FilterResult cpu = filter(copy_of(*surfaces[n]), o, quiet_);
                    device.set_surface(*surfaces[n]);
                    const FilterResult gpu = device.filter(o, quiet_);
                    EXPECT_EQ(cpu.volume_before, gpu.volume_before);
                    EXPECT_EQ(cpu.volume_filtered, gpu.volume_filtered);
                    EXPECT_EQ(cpu.volume, gpu.volume);
                    EXPECT_EQ(cpu.offset_vox, gpu.offset_vox);
                    EXPECT_EQ(cpu.repair_steps, gpu.repair_steps);
                    expect_nanovdb_of(*cpu.surface, device.surface_nanovdb());
                    if (n < 2) expect_same(*cpu.surface, *device.surface());
                    if (HasFailure()) return;
                }
    // What is filtered away, and what follows a filter.
    FilterOptions o;
    o.steps = parse_filters("gaussian:4x8");
    o.keep_thin_vox = 0;
    const auto speck = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(2.3f, openvdb::Vec3f(0.2f), 1.f, 3.f);
    device.set_surface(*speck);
    EXPECT_THROW(device.filter(o, quiet_), ContradictionError);
    device.set_surface(*surfaces[0]);
    o.steps = parse_filters("median:1");
    device.filter(o, quiet_);
    const FilterResult cpu = filter(copy_of(*surfaces[0]), o, quiet_);
    ASSERT_TRUE(device.extract_mesh(true));
    expect_same_mesh(marching_cubes(*cpu.surface, true), device.fetch_mesh(true));
    const FilterResult alone = filter(device, *surfaces[0], o, quiet_);
    expect_same(*cpu.surface, *alone.surface);
    EXPECT_EQ(alone.components, cpu.components);
    EXPECT_EQ(alone.backend_used, "cuda");
}

// One device session for jobs of other sizes and kinds, and for what is not a level set.
TEST_F(Gpu, OneSessionServesOneJobAfterAnother) {
    Device device;
    const auto job = [&](const Shoot& s, CarveOptions o) {
        std::vector<MaskView> masks;
        for (const Mask& m : s.scene.masks) masks.push_back(view_of(m));
        device.upload(masks);
        device.distance({});
        device.carve(s.inputs, o, quiet_);
        const CarveResult cpu = carve(s.inputs, o, quiet_);
        if (o.occupancy) {
            EXPECT_TRUE(cpu.occupancy->tree().hasSameTopology(device.occupancy()->tree()));
            EXPECT_THROW(device.hull(), UsageError);
        } else {
            expect_same(*cpu.hull, *device.hull());
            EXPECT_THROW(device.occupancy(), UsageError);
            device.level_set({});
            expect_same(*level_set(cpu.hull, {}, quiet_), *device.surface());
        }
    };
    const Shoot small = shoot(small_spec("cup", 7)), large = shoot(small_spec("torus", 14, 320, 240));
    CarveOptions a = options_for(small, 40), b = options_for(large, 150);
    job(small, a);
    job(large, b);
    a.occupancy = true;
    job(small, a);
    a.occupancy = false;
    a.max_misses = 2;
    job(small, a);
    device.upload({});
    EXPECT_THROW(device.carve(small.inputs, a, quiet_), UsageError);

    // Grids without leaves, and with leaves that end where another side begins.
    openvdb::FloatGrid::Ptr empty = openvdb::FloatGrid::create(1.f);
    empty->setGridClass(openvdb::GRID_LEVEL_SET);
    device.set_hull(*empty);
    EXPECT_THROW(device.level_set({}), InputError);
    device.set_surface(*empty);
    EXPECT_TRUE(device.extract_mesh(false));
    EXPECT_TRUE(device.fetch_mesh(false).vertices.empty());
    empty->tree().touchLeaf(openvdb::Coord(8, 16, -8))->fill(-0.5f, true);
    device.set_surface(*empty);
    EXPECT_FALSE(device.extract_mesh(false));
    EXPECT_THROW(device.fetch_mesh(false), UsageError);
    MeshOptions m;
    m.mesher = Mesher::MarchingCubes;
    expect_same_mesh(marching_cubes(*empty, false), extract_mesh(device, *empty, m, quiet_));
}

class GpuColor : public Gpu, public testing::WithParamInterface<ColorCase> {};

TEST_P(GpuColor, EqualsTheCpus) {
    const ColorScene s = GetParam().make();
    ColorOptions o;
    GetParam().change(o);
    const PhotoSource source = [&](size_t first, size_t last) {
        return std::vector<Photo>(s.photos.begin() + static_cast<long>(first), s.photos.begin() + static_cast<long>(last));
    };
    const ColorResult cpu = o.batch ? color_in_batches(*s.surface, s.inputs, source, o, quiet_) : color(*s.surface, s.inputs, o, quiet_);
    const auto expect_equal = [&](const ColorResult& gpu) {
        EXPECT_EQ(gpu.backend_used, "cuda");
        expect_same_colors(cpu, gpu);
    };
    Device device;
    expect_equal(color_in_batches(device, *s.surface, s.inputs, o.batch ? source : PhotoSource(), o, quiet_));
    // Twice on the same buffers.
    for (int again = 0; again < 2; ++again) expect_equal(device.color(*s.surface, s.inputs, source, o, quiet_));
    EXPECT_GT(cpu.statistics.colored, 0u);
    EXPECT_GT(cpu.statistics.synthesised, 0u);
}

INSTANTIATE_TEST_SUITE_P(Colors, GpuColor, testing::ValuesIn(color_cases()), [](const auto& instance) { return instance.param.name; });

TEST_F(Gpu, DepthsEqualTheCpus) {
    Device device;
    for (const bool orthographic : {false, true}) {
        const DentedScene scene(0.9, 16, 160, 48, orthographic);
        for (const int scale : {1, 2}) {
            StereoOptions o;
            o.scale = scale;
            const StereoResult cpu = stereo(*scene.hull, scene.inputs, {}, o, quiet_);
            const StereoResult gpu = stereo(device, *scene.hull, scene.inputs, {}, o, quiet_);
            EXPECT_EQ(gpu.backend_used, "cuda");
            expect_same(*cpu.surface, *gpu.surface);
            expect_same(*cpu.confidence, *gpu.confidence);
            ASSERT_EQ(cpu.maps.size(), gpu.maps.size());
            for (size_t v = 0; v < cpu.maps.size(); ++v) {
                EXPECT_EQ(cpu.maps[v].depth.data, gpu.maps[v].depth.data) << "view " << v;
                EXPECT_EQ(cpu.maps[v].confidence.data, gpu.maps[v].confidence.data) << "view " << v;
                EXPECT_EQ(cpu.views[v].pairs, gpu.views[v].pairs);
                EXPECT_EQ(cpu.views[v].object_pixels, gpu.views[v].object_pixels);
                EXPECT_EQ(cpu.views[v].matched_pixels, gpu.views[v].matched_pixels);
            }
            EXPECT_LT(cpu.volume, 0.96 * cpu.volume_before);
        }
    }
}

TEST_F(Gpu, AnUnseenSurfaceIsExplainedAlike) {
    ColorScene s = colored("ellipsoids", 5, 32);
    const Image8 nothing(200, 150);
    for (ColorInput& i : s.inputs) i.mask = {nothing.view(), {}};
    ColorOptions o;
    const std::string cpu = error_of(ExitCode::Contradiction, [&] { color(*s.surface, s.inputs, o, quiet_); });
    Device device;
    EXPECT_EQ(cpu, error_of(ExitCode::Contradiction, [&] { color_in_batches(device, *s.surface, s.inputs, {}, o, quiet_); }));
}

TEST_F(Gpu, AnEmptyHullIsExplainedAlike) {
    Shoot s = shoot(small_spec("ellipsoids", 8),
                    [](SyntheticScene& scene) { std::fill(scene.masks[3].coverage.data.begin(), scene.masks[3].coverage.data.end(), uint8_t{0}); });
    CarveOptions o = options_for(s, 48);
    const std::string cpu = error_of(ExitCode::Contradiction, [&] { carve(s.inputs, o, quiet_); });
    Device device;
    EXPECT_EQ(cpu, error_of(ExitCode::Contradiction, [&] { carve(device, s.inputs, o, quiet_); }));
    o.occupancy = true;
    EXPECT_EQ(cpu, error_of(ExitCode::Contradiction, [&] { carve(device, s.inputs, o, quiet_); }));
}

/// Pictures in all styles, from outside in several directions and from amid the voxels.
void expect_same_pictures(const openvdb::FloatGrid& surface, const openvdb::Vec3SGrid* colors, int side) {
    RenderVolume cpu(surface, colors);
    Device gpu;
    gpu.set_surface(surface);
    if (colors) gpu.set_colors(*colors);
    const Box3d box = cpu.bounds_world();
    std::vector<Camera> cameras;
    for (const double azimuth : {0.0, 90.0, 217.0})
        for (const double fov : {0.0, 35.0}) {
            OrbitView v;
            v.azimuth_deg = azimuth;
            v.elevation_deg = azimuth / 5 - 10;
            v.fov_deg = fov;
            v.width_px = side;
            v.height_px = side - 11;
            cameras.push_back(orbit_camera(box, Vec3d::UnitZ(), v));
        }
    cameras.push_back(cameras.back());
    cameras.back().camera_from_world.translation = -(cameras.back().camera_from_world.rotation * (box.center() + 0.31 * box.sizes()));
    for (const RenderStyle style : {RenderStyle::Surface, RenderStyle::Voxels, RenderStyle::XRay, RenderStyle::Slice})
        for (size_t c = 0; c < cameras.size(); ++c) {
            RenderOptions o;
            o.style = style;
            o.samples = c % 2 ? 1 : 2;
            o.slice = {Vec3d(0.3, -1, 0.2), Vec3d(0.3, -1, 0.2).dot(box.center())};
            if (c % 3 == 0) o.background.reset();
            o.color = c != 4;
            const Image8 expected = render(cpu, cameras[c], o), found = gpu.render(cameras[c], o);
            size_t differing = 0;
            for (size_t n = 0; n < expected.data.size(); ++n) differing += expected.data[n] != found.data[n];
            EXPECT_EQ(differing, 0u) << "style " << static_cast<int>(style) << ", camera " << c;
            EXPECT_GT(std::count(expected.data.begin(), expected.data.end(), expected.data.front()), 0);
        }
    EXPECT_GT(gpu.milliseconds("render"), 0);
}

TEST_F(Gpu, PicturesEqualTheCpus) {
    const ColorScene s = colored("ellipsoids", 9, 90);
    const ColorResult c = color(*s.surface, s.inputs, {}, quiet_);
    expect_same_pictures(*s.surface, c.color.get(), 160);
    expect_same_pictures(*noise_grid(44, true, false, 3), nullptr, 96);
    expect_same_pictures(*noise_grid(40, false, false, 4), nullptr, 96);
    // Tiles of every size inside, across upper nodes.
    const auto large = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(300.f, openvdb::Vec3f(-40.f, 4090.f, 60.f), 1.f, 3.f);
    expect_same_pictures(*large, nullptr, 120);
}

// Scenes that were packed for this machine (tests/device/pack_scene.cpp): real photographs' masks, at a resolution people use.
TEST_F(Gpu, PackedScenesEqualTheCpus) {
    const char* folder = std::getenv("VDBCARVE_PACKED_SCENES");
    if (!folder) GTEST_SKIP() << "VDBCARVE_PACKED_SCENES names no folder";
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
        SCOPED_TRACE(entry.path().filename().string());
        const PackedScene scene = read_packed_scene(entry.path());
        const std::vector<MaskView> masks = scene.mask_views();
        std::vector<CarveInput> inputs = scene.inputs();
        CarveOptions o;
        o.bounds_world = scene.bounds;
        o.lattice.voxel_size = scene.bounds.sizes().maxCoeff() / 512;
        const FieldPlan plan = plan_fields(scene.cameras, o);
        DistanceOptions d;
        d.scale = plan.scale;
        d.reach_samples = plan.reach_samples;
        const std::vector<DistanceField> fields = distance_fields(masks, d, quiet_);
        for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &fields[i];
        const auto hull = carve(inputs, o, quiet_).hull;
        Device device;
        device.upload(masks);
        device.distance(d);
        device.carve(inputs, o, quiet_);
        expect_same(*hull, *device.hull());
        const auto surface = level_set(hull, {}, quiet_);
        device.level_set({});
        expect_same(*surface, *device.surface());
        expect_nanovdb_of(*surface, device.surface_nanovdb());
        const Mesh mesh = marching_cubes(*surface, false);
        ASSERT_TRUE(device.extract_mesh(false));
        expect_same_mesh(mesh, device.fetch_mesh(false));
        if (!scene.photos.empty())
            for (const ColorMode mode : {ColorMode::Best, ColorMode::Blend}) {
                ColorOptions c;
                c.mode = mode;
                const ColorResult cpu = color(*surface, scene.color_inputs(), c, quiet_);
                const ColorResult gpu = device.color(*surface, scene.color_inputs(), {}, c, quiet_);
                expect_same_colors(cpu, gpu);
                std::printf("%s: %zu of %zu voxels of the contour seen\n", entry.path().filename().c_str(), cpu.statistics.colored,
                            cpu.statistics.surface_voxels);
            }
        expect_same_pictures(*surface, nullptr, 512);
        const MeshMeasures m = measure(mesh);
        std::printf("%s: %u leaves, %zu vertices, manifold %d, volume %.9g\n", entry.path().filename().c_str(), surface->tree().leafCount(), m.vertices,
                    m.manifold, m.volume);
    }
}

// On any machine.
TEST(Backend, SaysWhatIsMissing) {
    if (!why_no_cuda().empty()) {
        EXPECT_EQ(choose_backend(Backend::Auto, 0), Backend::Cpu);
        EXPECT_NE(error_of(ExitCode::Backend, [] { choose_backend(Backend::Cuda, 0); }).find("Remedy: --backend cpu"), std::string::npos);
        EXPECT_THROW(Device(0), BackendError);
    } else {
        EXPECT_EQ(choose_backend(Backend::Auto, 0), Backend::Cuda);
        EXPECT_NE(error_of(ExitCode::Backend, [] { choose_backend(Backend::Cuda, 99); }).find("--device 99"), std::string::npos);
    }
    EXPECT_EQ(choose_backend(Backend::Cpu, 7), Backend::Cpu);
}

TEST(Backend, ASessionGoesOnOnTheCpuUnlessTheDeviceWasDemanded) {
    Progress progress;
    std::string note;
    progress.on_note = [&](const std::string& text) { note = text; };
    const auto work = [](Device&) {};
    if (!why_no_cuda().empty()) {
        DeviceSession session(Backend::Auto, 3, progress);
        ASSERT_EQ(progress.warnings().size(), 1u);
        EXPECT_NE(progress.warnings()[0].find("--device 3"), std::string::npos);
        EXPECT_EQ(session.backend(), Backend::Cpu);
        EXPECT_FALSE(session.run("carve", [](Device&) { FAIL() << "there is no device"; }));
        EXPECT_EQ(session.used_last(), Backend::Cpu);
        EXPECT_THROW(DeviceSession(Backend::Cuda, 0, progress), BackendError);
        return;
    }
    const auto fail = [](Device&) { throw BackendError("out of memory"); };
    DeviceSession session(Backend::Auto, 0, progress);
    EXPECT_EQ(session.device(), nullptr);
    EXPECT_TRUE(session.run("carve", work));
    EXPECT_NE(session.device(), nullptr);
    EXPECT_EQ(session.used_last(), Backend::Cuda);
    session.begin_stage();
    EXPECT_EQ(session.used_last(), Backend::Cpu);
    EXPECT_FALSE(session.run("level_set", fail));
    EXPECT_EQ(note, "level_set: out of memory; going on on the CPU, with the same result");
    EXPECT_EQ(session.backend(), Backend::Cpu);
    EXPECT_EQ(session.device(), nullptr);
    EXPECT_FALSE(session.run("mesh", work));
    DeviceSession demanded(Backend::Cuda, 0, progress);
    EXPECT_THROW(demanded.run("carve", fail), BackendError);
    EXPECT_EQ(demanded.backend(), Backend::Cuda);
    EXPECT_TRUE(demanded.run("carve", work));
}

}  // namespace
}  // namespace vdbcarve::test
