// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include <openvdb/tools/Prune.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <openvdb/tree/LeafManager.h>
#include <tbb/parallel_for.h>

#include <chrono>
#include <cmath>
#include <cstring>
#include <optional>

#include "carve_plan.h"
#include "dense_device.h"
#include "field_plan.h"
#include "filter_plan.h"
#include "marching_cubes.h"
#include "nanovdb_bytes.h"
#include "render_plan.h"
#include "same_transform.h"
#include "statistics.h"
#include "vdbcarve/error.h"
#if defined(VDBCARVE_WITH_CUDA)
#include "../cuda/dense_cuda.h"
#include "device_parts.h"
#endif

namespace vdbcarve {

const char* name_of(Backend backend) { return backend == Backend::Cuda ? "cuda" : "cpu"; }

Backend choose_backend(Backend wanted, int device) {
    if (wanted == Backend::Cpu) return wanted;
    const auto count = static_cast<int>(cuda_devices().size());
    if (device >= 0 && device < count) return Backend::Cuda;
    if (wanted == Backend::Auto && count == 0) return Backend::Cpu;
    if (count == 0) throw BackendError("--backend cuda: " + why_no_cuda() + ". Remedy: --backend cpu gives the same result");
    throw BackendError("--device " + std::to_string(device) + ": this machine has " + std::to_string(count) + " CUDA device" + (count == 1 ? "" : "s") +
                       ", numbered from 0");
}

#if !defined(VDBCARVE_WITH_CUDA)

std::vector<DeviceInfo> cuda_devices() { return {}; }
std::string why_no_cuda() { return "this vdbcarve was built without CUDA"; }

struct DevicePipeline::Parts {};
namespace {
[[noreturn]] void absent() { throw BackendError(why_no_cuda()); }
}  // namespace
DevicePipeline::DevicePipeline(int) { absent(); }
DevicePipeline::~DevicePipeline() = default;
DevicePipeline::DevicePipeline(DevicePipeline&&) noexcept = default;
DevicePipeline& DevicePipeline::operator=(DevicePipeline&&) noexcept = default;
void DevicePipeline::upload(const std::vector<MaskView>&) { absent(); }
void DevicePipeline::distance(const DistanceOptions&) { absent(); }
std::vector<DistanceField> DevicePipeline::fields() const { absent(); }
void DevicePipeline::set_fields(const std::vector<CarveInput>&) { absent(); }
CarveStatistics DevicePipeline::carve(const std::vector<CarveInput>&, const CarveOptions&, Progress&) { absent(); }
openvdb::FloatGrid::Ptr DevicePipeline::hull() const { absent(); }
openvdb::MaskGrid::Ptr DevicePipeline::occupancy() const { absent(); }
void DevicePipeline::set_hull(const openvdb::FloatGrid&) { absent(); }
void DevicePipeline::level_set(const LevelSetOptions&) { absent(); }
openvdb::FloatGrid::Ptr DevicePipeline::surface() const { absent(); }
void DevicePipeline::set_surface(const openvdb::FloatGrid&) { absent(); }
ColorResult DevicePipeline::color(const openvdb::FloatGrid&, const std::vector<ColorInput>&, const PhotoSource&, const ColorOptions&, Progress&) { absent(); }
StereoResult DevicePipeline::stereo(const openvdb::FloatGrid&, const std::vector<ColorInput>&, const PhotoSource&, const StereoOptions&, Progress&) {
    absent();
}
FilterResult DevicePipeline::filter(const FilterOptions&, Progress&) { absent(); }
void DevicePipeline::set_colors(const NanoBuffer&) { absent(); }
Image8 DevicePipeline::render(const Camera&, const RenderOptions&) { absent(); }
bool DevicePipeline::extract_mesh(bool) { absent(); }
NanoBuffer DevicePipeline::hull_nanovdb() const { absent(); }
NanoBuffer DevicePipeline::surface_nanovdb() const { absent(); }
std::vector<std::pair<std::string, double>> DevicePipeline::milliseconds() const { absent(); }
void DevicePipeline::clear_times() { absent(); }
size_t DevicePipeline::bytes() const { absent(); }
size_t DevicePipeline::free_bytes() const { absent(); }
void DevicePipeline::wait() const { absent(); }
NanoBuffer DevicePipeline::hull_bytes() const { absent(); }
Mesh DevicePipeline::fetch_mesh(bool) { absent(); }
DenseTimes dense_on_device(const std::vector<const uint8_t*>&, int, int, const std::vector<std::array<float, 12>>&, const std::array<int, 3>&, int, int) {
    absent();
}

#else

namespace {

using cuda::kBlockLeaves;
using cuda::kBlockSide;
using cuda::kBlockWords;
using openvdb::Coord;
using Leaf = openvdb::FloatTree::LeafNodeType;

/// What a level set's leaves look like on the host; tiles follow from the leaves' signs.
openvdb::FloatGrid::Ptr to_openvdb(const cuda::Grid& grid, const cuda::Stream& stream, const openvdb::math::Transform& transform, Fetcher& fetcher) {
    const cuda::GridSpec& spec = grid.spec();
    openvdb::FloatGrid::Ptr out = openvdb::FloatGrid::create(spec.background);
    out->setTransform(same_transform(transform));
    out->setName(spec.name);
    out->setGridClass(openvdb::GRID_LEVEL_SET);
    using NanoLeaf = cuda::Grid::Leaf;
    std::vector<std::unique_ptr<Leaf>> leaves(grid.leaf_count());
    fetcher.fetch(grid.leaves(), leaves.size() * sizeof(NanoLeaf), sizeof(NanoLeaf), stream, [&](const uint8_t* piece, size_t at, size_t size) {
        const auto* from = reinterpret_cast<const NanoLeaf*>(piece);
        tbb::parallel_for(size_t{0}, size / sizeof(NanoLeaf), [&](size_t n) {
            const nanovdb::Coord o = from[n].origin();
            auto leaf = std::make_unique<Leaf>(openvdb::PartialCreate(), Coord(o[0], o[1], o[2]), spec.background, false);
            leaf->allocate();
            std::memcpy(leaf->buffer().data(), from[n].data()->mValues, sizeof(float) * Leaf::SIZE);
            openvdb::util::NodeMask<3> active;
            for (openvdb::Index w = 0; w < 8; ++w) active.getWord<openvdb::Index64>(w) = from[n].valueMask().getWord<uint64_t>(static_cast<int>(w));
            leaf->setValueMask(active);
            leaves[at / sizeof(NanoLeaf) + n] = std::move(leaf);
        });
    });
    for (auto& leaf : leaves) out->tree().addLeaf(leaf.release());
    openvdb::tools::signedFloodFill(out->tree());
    return out;
}

}  // namespace

std::vector<DeviceInfo> cuda_devices() {
    int count = 0;
    if (cudaGetDeviceCount(&count) != cudaSuccess) {
        (void)cudaGetLastError();
        return {};
    }
    std::vector<DeviceInfo> out;
    for (int d = 0; d < count; ++d) {
        cudaDeviceProp p{};
        if (cudaGetDeviceProperties(&p, d) != cudaSuccess) return {};
        out.push_back({p.name, p.totalGlobalMem, p.multiProcessorCount});
    }
    return out;
}

std::string why_no_cuda() {
    int count = 0;
    const cudaError_t error = cudaGetDeviceCount(&count);
    (void)cudaGetLastError();
    if (error == cudaSuccess && count > 0) return {};
    int driver = 0;
    if (cudaDriverGetVersion(&driver) == cudaSuccess && driver == 0) return "this machine has no CUDA device that can be used (no NVIDIA driver)";
    return std::string("this machine has no CUDA device that can be used (") + (error == cudaSuccess ? "none found" : cudaGetErrorString(error)) + ")";
}

void DevicePipeline::Parts::upload(Volume& volume, const openvdb::FloatGrid& grid) {
    if (grid.getGridClass() != openvdb::GRID_LEVEL_SET) throw InputError("grid '" + grid.getName() + "' is no level set");
    volume.topology = nullptr;
    volume.transform = same_transform(grid.transform());
    std::vector<const Leaf*> leaves;
    grid.tree().getNodes(leaves);
    // Blocks with leaves, and whole ones inside.
    std::vector<std::array<int, 3>> origins;
    using Lower = openvdb::FloatTree::RootNodeType::ChildNodeType::ChildNodeType;
    using Upper = openvdb::FloatTree::RootNodeType::ChildNodeType;
    std::vector<const Lower*> lowers;
    grid.tree().getNodes(lowers);
    for (const Lower* l : lowers) origins.push_back({l->origin()[0], l->origin()[1], l->origin()[2]});
    std::vector<const Upper*> uppers;
    grid.tree().getNodes(uppers);
    for (const Upper* u : uppers)
        for (auto tile = u->cbeginValueAll(); tile; ++tile)
            if (*tile < 0.f) origins.push_back({tile.getCoord()[0], tile.getCoord()[1], tile.getCoord()[2]});
    volume.own.cover(std::move(origins), stream);
    volume.topology = &volume.own;
    const auto& blocks = volume.own.origins();
    std::vector<uint64_t> exist(blocks.size() * kBlockWords, 0), inside(exist);
    std::vector<uint32_t> keys;
    std::vector<float> values(leaves.size() * Leaf::SIZE);
    std::vector<uint64_t> active(leaves.size() * 8);
    keys.reserve(leaves.size());
    for (size_t b = 0; b < blocks.size(); ++b) {
        const Coord o(blocks[b][0], blocks[b][1], blocks[b][2]);
        const auto* lower = grid.tree().probeConstNode<Lower>(o);
        if (!lower) {
            std::fill_n(inside.begin() + static_cast<long>(b * kBlockWords), kBlockWords, ~uint64_t{0});
            continue;
        }
        for (auto tile = lower->cbeginValueAll(); tile; ++tile)
            if (*tile < 0.f) inside[b * kBlockWords + tile.pos() / 64] |= uint64_t{1} << (tile.pos() & 63);
        for (auto child = lower->cbeginChildOn(); child; ++child) {
            const size_t slot = keys.size();
            exist[b * kBlockWords + child.pos() / 64] |= uint64_t{1} << (child.pos() & 63);
            keys.push_back(static_cast<uint32_t>(b * kBlockLeaves + child.pos()));
            std::memcpy(values.data() + slot * Leaf::SIZE, child->buffer().data(), sizeof(float) * Leaf::SIZE);
            for (openvdb::Index w = 0; w < 8; ++w) active[slot * 8 + w] = child->valueMask().getWord<openvdb::Index64>(w);
        }
    }
    const cuda::TopologyView view = volume.own.view();
    stream.to_device(view.leaves, exist.data(), exist.size());
    stream.to_device(view.inside, inside.data(), inside.size());
    stream.to_device(uploaded_values.ensure(values.size()), values.data(), values.size());
    stream.to_device(uploaded_active.ensure(active.size()), active.data(), active.size());
    stream.to_device(uploaded_keys.ensure(keys.size()), keys.data(), keys.size());
    volume.own.number_leaves(stream);
    volume.grid.build(volume.own, spec_of(grid.getName(), *volume.transform, grid.background()),
                      {uploaded_values.data(), uploaded_active.data(), uploaded_keys.data(), static_cast<uint32_t>(keys.size())}, stream);
    stream.wait();
}

DevicePipeline::DevicePipeline(int device) : parts_(std::make_unique<Parts>(device)) {}
DevicePipeline::~DevicePipeline() = default;
DevicePipeline::DevicePipeline(DevicePipeline&&) noexcept = default;
DevicePipeline& DevicePipeline::operator=(DevicePipeline&&) noexcept = default;

void DevicePipeline::upload(const std::vector<MaskView>& masks) {
    Parts& p = *parts_;
    p.use();
    p.mask_of.assign(masks.size(), SIZE_MAX);
    p.mask_sizes.clear();
    p.headers.clear();  // fields of other masks
    std::vector<cuda::HostMask> host;
    for (size_t i = 0; i < masks.size(); ++i) {
        const MaskView& m = masks[i];
        if (m.coverage.empty()) continue;
        p.mask_of[i] = host.size();
        host.push_back({m.coverage.data, m.ignore.empty() ? nullptr : m.ignore.data, m.coverage.width, m.coverage.height});
        p.mask_sizes.push_back({m.coverage.width, m.coverage.height, !m.ignore.empty()});
    }
    p.times.measure("upload", p.stream, [&] {
        p.distance.upload(
            host,
            [](const std::vector<cuda::HostMask>& all, const auto& place) {
                tbb::parallel_for(size_t{0}, all.size(), [&](size_t v) {
                    const size_t bytes = static_cast<size_t>(all[v].width) * static_cast<size_t>(all[v].height);
                    copy_parallel(place(v, false), all[v].coverage, bytes);
                    if (all[v].ignore) copy_parallel(place(v, true), all[v].ignore, bytes);
                });
            },
            p.stream);
    });
}

void DevicePipeline::distance(const DistanceOptions& options) {
    Parts& p = *parts_;
    p.use();
    check_distance(options);
    for (const auto& m : p.mask_sizes) check_mask_size(m.width, m.height, options.scale);
    const double offset = field_offset(options), reach = field_reach(options);
    p.headers.assign(p.mask_of.size(), {});
    p.silhouettes.assign(p.mask_of.size(), {});
    p.ignored.assign(p.mask_of.size(), {});
    p.times.measure("distance", p.stream, [&] {
        const std::vector<cuda::ObjectBox> boxes = p.distance.prepare(options.scale, options.conservative, p.stream);
        std::vector<cuda::FieldJob> jobs;
        std::vector<cuda::DeviceField*> results;
        const auto order = [&](size_t view, size_t mask, bool of_ignored, const SampledField& header, double field_offset_samples) {
            const FieldLengths l = field_lengths(reach, field_offset_samples);
            jobs.push_back(
                {static_cast<int>(mask), of_ignored, header.x0, header.y0, header.width, header.height, l.reach, l.offset, l.clamp, field_offset_samples});
            results.push_back(of_ignored ? &p.ignored[view] : &p.silhouettes[view]);
        };
        for (size_t v = 0; v < p.mask_of.size(); ++v) {
            const size_t m = p.mask_of[v];
            if (m == SIZE_MAX) continue;
            DistanceField& h = p.headers[v];
            h.scale = options.scale;
            h.mask_width = p.mask_sizes[m].width;
            h.mask_height = p.mask_sizes[m].height;
            const int width = (h.mask_width + options.scale - 1) / options.scale, height = (h.mask_height + options.scale - 1) / options.scale;
            const cuda::ObjectBox& box = boxes[m];
            if (box.x1 < box.x0) {
                h.silhouette = field_header(width, height, {0, 0, 2, 2}, reach);
                order(v, m, false, h.silhouette, 0);
            } else {
                const int around[4] = {box.x0, box.y0, box.x1, box.y1};
                std::copy_n(around, 4, h.object_box);
                h.silhouette = field_header(width, height, window_around(around, width, height, reach, offset), reach);
                order(v, m, false, h.silhouette, offset);
            }
            if (p.mask_sizes[m].ignores) {
                h.ignored = field_header(width, height, {0, 0, width, height}, reach);
                order(v, m, true, h.ignored, 0);
            }
        }
        const std::vector<cuda::DeviceField> made = p.distance.make(jobs, p.stream);
        for (size_t j = 0; j < made.size(); ++j) *results[j] = made[j];
    });
}

std::vector<DistanceField> DevicePipeline::fields() const {
    const Parts& p = *parts_;
    p.use();
    std::vector<DistanceField> out = p.headers;
    const auto fetch = [&](SampledField& to, const cuda::DeviceField& from) {
        if (!from.samples) return;
        to.samples.resize(from.sample_count);
        to.blocks.resize(from.block_count);
        to.blocks_per_row = from.blocks_per_row;
        p.stream.to_host(to.samples.data(), from.samples, from.sample_count);
        p.stream.to_host(to.blocks.data(), from.blocks, from.block_count);
    };
    for (size_t v = 0; v < out.size(); ++v) {
        fetch(out[v].silhouette, p.silhouettes[v]);
        fetch(out[v].ignored, p.ignored[v]);
    }
    p.stream.wait();
    return out;
}

void DevicePipeline::set_fields(const std::vector<CarveInput>& inputs) {
    Parts& p = *parts_;
    p.use();
    size_t count = 0;
    const auto each = [&](const auto& visit) {
        for (size_t v = 0; v < inputs.size(); ++v) {
            if (!inputs[v].field) continue;
            visit(v, false, inputs[v].field->silhouette);
            if (!inputs[v].field->ignored.empty()) visit(v, true, inputs[v].field->ignored);
        }
    };
    const auto even = [](size_t n) { return (n + 7) / 8 * 8; };
    each([&](size_t, bool, const SampledField& f) { count += even(f.samples.size()) + even(f.blocks.size()); });
    int16_t* to = p.uploaded_fields.ensure(count);
    p.headers.assign(inputs.size(), {});
    p.silhouettes.assign(inputs.size(), {});
    p.ignored.assign(inputs.size(), {});
    each([&](size_t v, bool of_ignored, const SampledField& f) {
        p.stream.to_device(to, f.samples.data(), f.samples.size());
        cuda::DeviceField& d = (of_ignored ? p.ignored : p.silhouettes)[v];
        d = {to, to + even(f.samples.size()), f.blocks_per_row, f.samples.size(), f.blocks.size()};
        p.stream.to_device(to + even(f.samples.size()), f.blocks.data(), f.blocks.size());
        to += even(f.samples.size()) + even(f.blocks.size());
        const DistanceField& from = *inputs[v].field;
        DistanceField& h = p.headers[v];
        h.scale = from.scale;
        h.mask_width = from.mask_width;
        h.mask_height = from.mask_height;
        std::copy_n(from.object_box, 4, h.object_box);
        SampledField& s = of_ignored ? h.ignored : h.silhouette;
        s.x0 = f.x0;
        s.y0 = f.y0;
        s.width = f.width;
        s.height = f.height;
        s.reach = f.reach;
        std::copy_n(f.cut, 4, s.cut);
    });
    p.stream.wait();
}

CarveStatistics DevicePipeline::carve(const std::vector<CarveInput>& inputs, const CarveOptions& options, Progress& progress) {
    Parts& p = *parts_;
    p.use();
    progress.begin("carve", 2);
    if (p.headers.size() != inputs.size())
        throw UsageError("carve: the device holds fields of " + std::to_string(p.headers.size()) + " views, " + std::to_string(inputs.size()) + " are carved");
    std::vector<CarveInput> bare = inputs;
    for (CarveInput& input : bare) input.field = nullptr;
    check_carve(bare, options);
    cuda::CarveJob job;
    for (size_t i = 0; i < inputs.size(); ++i) {
        const DistanceField& h = p.headers[i];
        const Intrinsics& k = inputs[i].camera.intrinsics;
        if (!p.silhouettes[i].samples || h.mask_width != k.width_px || h.mask_height != k.height_px)
            throw UsageError("carve: view " + inputs[i].name + ": the distance field has not the camera's size");
        if (options.occupancy && h.scale != 1)
            throw UsageError("carve: the binary model wants a sample a pixel, view " + inputs[i].name + " has a field-scale of " + std::to_string(h.scale));
        bare[i].field = &h;
        kernel::CarveView view = make_carve_view(bare[i], options);
        view.silhouette = p.view_of(h.silhouette, p.silhouettes[i]);
        view.ignored = p.ignored[i].samples ? p.view_of(h.ignored, p.ignored[i]) : kernel::FieldView{};
        job.views.push_back(view);
    }
    const CarvePlan plan = plan_carve(inputs.size(), options);
    for (int a = 0; a < 3; ++a) {
        job.origin_world[a] = options.lattice.origin_world[a];
        job.lo[a] = options.bounds_world.min()[a];
        job.hi[a] = options.bounds_world.max()[a];
    }
    job.voxel_size = options.lattice.voxel_size;
    job.band = plan.band;
    job.near_depth = plan.near_depth;
    job.cell_radius = plan.cell_radius;
    job.max_misses = options.max_misses;
    job.need_seen = plan.need_seen;
    job.min = plan.range.min;
    job.max = plan.range.max;
    job.occupancy = options.occupancy;
    p.hull.topology = nullptr;
    p.carve_options.reset();
    p.carve.run(job, p.stream, p.times);
    p.carve_options = options;
    p.carve_inputs = inputs;
    for (CarveInput& input : p.carve_inputs) input.field = nullptr;
    progress.step();
    CarveStatistics s;
    if (!options.occupancy) {
        p.hull.transform = options.lattice.transform();
        p.times.measure("carve: topology", p.stream, [&] {
            p.hull.grid.build(p.carve.topology(), Parts::spec_of("hull", *p.hull.transform, static_cast<float>(plan.band)), p.carve.leaves(), p.stream);
        });
        p.hull.topology = &p.carve.topology();
        s.leaves = p.hull.grid.leaf_count();
    }
    const cuda::CarveCounts counts = p.carve.counts(p.stream);
    s.node_tests = counts.node_tests;
    s.voxel_lookups = counts.voxel_lookups;
    s.inside_voxels = counts.negative;
    s.clipped_share = counts.surface ? static_cast<double>(counts.capped) / static_cast<double>(counts.surface) : 0;
    if (!options.occupancy && counts.negative == 0 && !options.brick && !options.allow_empty) {
        const std::vector<DistanceField> held = fields();
        for (size_t i = 0; i < bare.size(); ++i) bare[i].field = &held[i];
        explain_empty(bare, options);
    }
    progress.step();
    return s;
}

openvdb::FloatGrid::Ptr DevicePipeline::hull() const {
    parts_->use();
    const auto& volume = parts_->need(parts_->hull, "hull");
    return to_openvdb(volume.grid, parts_->stream, *volume.transform, parts_->fetcher);
}

openvdb::MaskGrid::Ptr DevicePipeline::occupancy() const {
    Parts& p = *parts_;
    p.use();
    if (!p.carve_options || !p.carve_options->occupancy) throw UsageError("the device holds no occupancy");
    const CarveOptions& options = *p.carve_options;
    const auto& blocks = p.carve.topology().origins();
    const cuda::LeafSource leaves = p.carve.leaves();
    std::vector<uint64_t> exist(blocks.size() * kBlockWords), inside(exist.size()), active(static_cast<size_t>(leaves.slots) * 8);
    std::vector<uint32_t> keys(leaves.slots);
    const cuda::TopologyView view = p.carve.topology().view();
    p.stream.to_host(exist.data(), view.leaves, exist.size());
    p.stream.to_host(inside.data(), view.inside, inside.size());
    p.stream.to_host(active.data(), leaves.active, active.size());
    p.stream.to_host(keys.data(), leaves.keys, keys.size());
    p.stream.wait();
    openvdb::MaskGrid::Ptr out = empty_occupancy(options);
    openvdb::MaskTree& tree = out->tree();
    const auto place = [&](size_t block, size_t at) {
        return Coord(blocks[block][0] + static_cast<int>(at >> 8) * 8, blocks[block][1] + static_cast<int>(at >> 4 & 15) * 8,
                     blocks[block][2] + static_cast<int>(at & 15) * 8);
    };
    bool any = false;
    for (size_t slot = 0; slot < keys.size(); ++slot) {
        const size_t block = keys[slot] / kBlockLeaves, at = keys[slot] % kBlockLeaves;
        if (!(exist[block * kBlockWords + at / 64] >> (at & 63) & 1)) continue;
        auto leaf = std::make_unique<openvdb::MaskTree::LeafNodeType>(place(block, at), false, false);
        openvdb::util::NodeMask<3> mask;
        for (openvdb::Index w = 0; w < 8; ++w) mask.getWord<openvdb::Index64>(w) = active[slot * 8 + w];
        leaf->setValueMask(mask);
        tree.addLeaf(leaf.release());
        any = true;
    }
    for (size_t block = 0; block < blocks.size(); ++block) {
        const uint64_t* words = inside.data() + block * kBlockWords;
        if (std::all_of(words, words + kBlockWords, [](uint64_t w) { return w == ~uint64_t{0}; })) {
            tree.addTile(2, place(block, 0), true, true);
            any = true;
            continue;
        }
        for (size_t at = 0; at < kBlockLeaves; ++at)
            if (words[at / 64] >> (at & 63) & 1) {
                tree.addTile(1, place(block, at), true, true);
                any = true;
            }
    }
    if (!any && !options.brick && !options.allow_empty) {
        const std::vector<DistanceField> held = fields();
        std::vector<CarveInput> inputs = p.carve_inputs;
        for (size_t i = 0; i < inputs.size(); ++i) inputs[i].field = &held[i];
        explain_empty(inputs, options);
    }
    openvdb::tools::prune(tree);
    return out;
}

void DevicePipeline::set_hull(const openvdb::FloatGrid& hull) {
    parts_->use();
    parts_->upload(parts_->hull, hull);
}

void DevicePipeline::level_set(const LevelSetOptions& options) {
    Parts& p = *parts_;
    p.use();
    if (options.half_width_vox < 2 || options.half_width_vox > 100)
        throw UsageError("level_set: half-width is " + std::to_string(options.half_width_vox) + " voxels, must be 2..100");
    p.need(p.hull, "hull");
    p.surface.topology = nullptr;
    p.surface.transform = p.hull.transform;
    if (!p.redistance(p.hull.grid, *p.hull.topology, options.half_width_vox, nullptr)) throw InputError("level_set: the hull has no zero crossing");
}

bool DevicePipeline::Parts::redistance(const cuda::Grid& field, const cuda::Topology& field_topology, int half_width_vox, VolumeRepair* repair) {
    if (!level_set.solve(field, field_topology, half_width_vox + (repair && repair->move ? 1 : 0), stream, times)) return false;
    if (repair)
        repair_volume(*repair, [&](float offset) {
            const auto v = level_set.volume(field, field_topology, offset, stream, times);
            return std::pair<int64_t, int64_t>(v.units, v.crossed);
        });
    level_set.finish(field, field_topology, half_width_vox, repair ? static_cast<float>(repair->offset_vox) : 0.f, stream, times);
    const float band = static_cast<float>(half_width_vox) * static_cast<float>(surface.transform->voxelSize()[0]);
    times.measure("level_set", stream,
                  [&] { surface.grid.build(level_set.topology(), spec_of("surface", *surface.transform, band), level_set.leaves(field), stream); });
    surface.topology = &level_set.topology();
    return true;
}

FilterResult DevicePipeline::filter(const FilterOptions& options, Progress& progress) {
    Parts& p = *parts_;
    p.use();
    const Parts::Volume& volume = p.need(p.surface, "level set");
    const double voxel = volume.transform->voxelSize()[0];
    const int half_width = static_cast<int>(std::lround(volume.grid.spec().background / voxel));
    check_filter(options, half_width);
    FilterResult out;
    out.backend_used = "cuda";
    VolumeRepair repair;
    repair.move = options.repair_volume;
    if (options.steps.empty()) {
        repair.target = repair.before_move = repair.volume = p.level_set.volume_of(volume.grid, *volume.topology, p.stream, p.times);
        describe_volumes(out, repair, voxel);
        return out;
    }
    repair.target = p.level_set.volume_of(volume.grid, *volume.topology, p.stream, p.times);
    progress.begin("filter", 2);
    const auto thin = options.keep_thin_vox > 0 ? thin_passes(options.keep_thin_vox) : std::vector<kernel::FilterPass>();
    p.filter.run(volume.grid, *volume.topology, passes_of(options.steps), static_cast<float>(options.keep_thin_vox), thin, static_cast<float>(half_width),
                 p.stream, p.times);
    progress.step();
    p.surface.topology = nullptr;
    if (!p.redistance(p.filter.grid(), p.filter.topology(), half_width, &repair)) explain_filtered_away(options);
    progress.step();
    describe_volumes(out, repair, voxel);
    for (const auto& [name, ms] : p.times.milliseconds())
        if (name.rfind("filter: ", 0) == 0) out.milliseconds.emplace_back(name.substr(8), ms);
    return out;
}

openvdb::FloatGrid::Ptr DevicePipeline::surface() const {
    parts_->use();
    const auto& volume = parts_->need(parts_->surface, "level set");
    return to_openvdb(volume.grid, parts_->stream, *volume.transform, parts_->fetcher);
}

void DevicePipeline::set_surface(const openvdb::FloatGrid& surface) {
    parts_->use();
    parts_->upload(parts_->surface, surface);
    parts_->render.clear_colors();
}

void DevicePipeline::set_colors(const NanoBuffer& colors) {
    Parts& p = *parts_;
    p.use();
    p.render.set_colors(colors.data.get(), colors.size, p.stream);
    p.stream.wait();
}

Image8 DevicePipeline::render(const Camera& camera, const RenderOptions& options) {
    Parts& p = *parts_;
    p.use();
    const auto& volume = p.surface.topology ? p.surface : p.need(p.hull, "volume");
    const cuda::GridSpec& spec = volume.grid.spec();
    const std::array<int, 6> box = p.render.leaf_box(volume.grid, p.stream, p.times);
    const RenderFrame frame({{box[0], box[1], box[2]}, {box[3], box[4], box[5]}},
                            Vec3d(spec.first_voxel_world[0], spec.first_voxel_world[1], spec.first_voxel_world[2]), spec.voxel_size);
    const kernel::RenderRule rule = render_rule(frame, camera, options);
    const uint8_t* pixels = p.render.render(volume.grid, frame.base, frame.box, rule, ambient_directions(rule.ambient_rays), srgb_table(), p.stream, p.times);
    Image8 out(rule.width, rule.height, 4);
    p.fetcher.fetch_to(out.data.data(), pixels, out.data.size(), p.stream);
    p.stream.wait();
    return out;
}

bool DevicePipeline::extract_mesh(bool normals) {
    Parts& p = *parts_;
    p.use();
    const auto& volume = p.need(p.surface, "level set");
    return p.mesh.run(volume.grid, *volume.topology, marching_cases(), normals, p.stream, p.times);
}

Mesh DevicePipeline::fetch_mesh(bool normals) {
    Parts& p = *parts_;
    p.use();
    if (!p.mesh.made() || (normals && !p.mesh.has_normals())) throw UsageError(std::string("the device holds no mesh") + (normals ? " with normals" : ""));
    Mesh out;
    out.vertices.resize(p.mesh.vertex_count());
    out.triangles.resize(p.mesh.triangle_count());
    p.fetcher.fetch_to(out.vertices.data(), p.mesh.vertices(), out.vertices.size() * sizeof(out.vertices[0]), p.stream);
    p.fetcher.fetch_to(out.triangles.data(), p.mesh.triangles(), out.triangles.size() * sizeof(out.triangles[0]), p.stream);
    if (normals) {
        out.normals.resize(out.vertices.size());
        p.fetcher.fetch_to(out.normals.data(), p.mesh.normals(), out.normals.size() * sizeof(out.normals[0]), p.stream);
    }
    return out;
}

NanoBuffer DevicePipeline::hull_bytes() const {
    parts_->use();
    return parts_->bytes_of(parts_->need(parts_->hull, "hull"));
}
NanoBuffer DevicePipeline::hull_nanovdb() const {
    parts_->use();
    return parts_->nanovdb_of(parts_->need(parts_->hull, "hull"));
}
NanoBuffer DevicePipeline::surface_nanovdb() const {
    parts_->use();
    return parts_->nanovdb_of(parts_->need(parts_->surface, "level set"));
}

std::vector<std::pair<std::string, double>> DevicePipeline::milliseconds() const {
    parts_->use();
    return parts_->times.milliseconds();
}
void DevicePipeline::clear_times() { parts_->times.clear(); }
size_t DevicePipeline::bytes() const {
    const Parts& p = *parts_;
    return p.distance.bytes() + p.uploaded_fields.bytes() + p.carve.bytes() + p.hull.grid.bytes() + p.surface.grid.bytes() + p.fused.grid.bytes() +
           p.level_set.bytes() + p.filter.bytes() + p.mesh.bytes() + p.color.bytes() + p.render.bytes() + p.stereo.bytes() + p.uploaded_values.bytes() +
           p.photos.bytes();
}
size_t DevicePipeline::free_bytes() const {
    parts_->use();
    size_t free = 0, total = 0;
    VDBCARVE_CUDA(cudaMemGetInfo(&free, &total));
    return free;
}
void DevicePipeline::wait() const {
    parts_->use();
    parts_->stream.wait();
}

DenseTimes dense_on_device(const std::vector<const uint8_t*>& masks, int width, int height, const std::vector<std::array<float, 12>>& pixel_from_index,
                           const std::array<int, 3>& dims, int device, int runs) {
    VDBCARVE_CUDA(cudaSetDevice(device));
    cuda::Stream stream;
    cuda::DenseStage dense;
    std::vector<double> uploads, carves;
    for (int run = -1; run < runs; ++run) {
        const auto start = std::chrono::steady_clock::now();
        dense.upload(masks, width, height, pixel_from_index, stream);
        const double upload = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
        cuda::Event begin, end;
        begin.record(stream);
        dense.run(dims, stream);
        end.record(stream);
        const double ms = end.milliseconds_since(begin);
        if (run < 0) continue;  // warming up
        uploads.push_back(upload);
        carves.push_back(ms);
    }
    return {median(uploads), median(carves), dense.count(stream)};
}

#endif

}  // namespace vdbcarve
