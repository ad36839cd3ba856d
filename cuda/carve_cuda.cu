// SPDX-License-Identifier: Apache-2.0
#include "carve_cuda.h"

#include <algorithm>

#include "carve_leaves.cuh"

namespace vdbcarve::cuda {
namespace {

template <bool kPerspective>
void evaluate(const Common& c, uint32_t slots, float* values, uint64_t* active, cudaStream_t s) {
    const auto blocks = static_cast<unsigned>(static_cast<size_t>(slots) * 256 / kLeafThreads);
    if (c.max_misses == 0) evaluate_leaves<1, kPerspective><<<blocks, kLeafThreads, 0, s>>>(c, values, active);
    else if (c.max_misses <= 3) evaluate_leaves<4, kPerspective><<<blocks, kLeafThreads, 0, s>>>(c, values, active);
    else evaluate_leaves<16, kPerspective><<<blocks, kLeafThreads, 0, s>>>(c, values, active);
    VDBCARVE_LAUNCHED();
}

}  // namespace

void CarveStage::run(const CarveJob& job, const Stream& stream, StageTimes& times) {
    const auto n = job.views.size();
    if (n > kMaxViews) throw BackendError("CUDA: " + std::to_string(n) + " views, at most " + std::to_string(kMaxViews) + ". Remedy: --backend cpu");
    Common c{};
    c.view_count = static_cast<int>(n);
    c.view_words = (c.view_count + 31) / 32;
    const auto words = static_cast<size_t>(c.view_words);
    for (size_t a = 0; a < 3; ++a) {
        c.origin_world[a] = job.origin_world[a];
        c.lo[a] = job.lo[a];
        c.hi[a] = job.hi[a];
        c.min[a] = job.min[a];
        c.max[a] = job.max[a];
    }
    c.voxel_size = job.voxel_size;
    c.band = job.band;
    c.near_depth = job.near_depth;
    c.cell_radius = job.cell_radius;
    c.max_misses = job.max_misses;
    c.need_seen = job.need_seen;
    c.occupancy = job.occupancy;

    topology_.cover(job.min, job.max, stream);
    c.topology = topology_.view();
    CarveView* host_views = host_views_.ensure(n);
    ViewConstants* host_constants = reinterpret_cast<ViewConstants*>(host_constants_.ensure(n * sizeof(ViewConstants)));
    bool perspective = true;
    for (size_t v = 0; v < n; ++v) {
        const CarveView& view = host_views[v] = job.views[v];
        const LeafToCamera steps = leaf_to_camera(view, 0, 0, 0);
        host_constants[v] = {
            steps.di, steps.dj, steps.dk, view, view.silhouette.x0, view.silhouette.y0, view.silhouette.width, view.silhouette.height, view.silhouette.samples};
        perspective = perspective && !view.orthographic;
    }
    c.views = views_.ensure(n);
    c.constants = reinterpret_cast<ViewConstants*>(constants_.ensure(n * sizeof(ViewConstants)));
    stream.to_device(views_.data(), host_views, n);
    stream.to_device(constants_.data(), host_constants_.data(), n * sizeof(ViewConstants));
    c.counters = counters_.ensure(kCounters + kTallies * kTallySize);
    c.tallies = c.counters + kCounters;
    host_counters_.ensure(kCounters + kTallies * kTallySize);

    // Leaves grow with the surface: a guess that is grown when a walk finds more.
    double area = 0;
    for (size_t a = 0; a < 3; ++a) area += static_cast<double>(job.max[(a + 1) % 3] - job.min[(a + 1) % 3]) * (job.max[(a + 2) % 3] - job.min[(a + 2) % 3]);
    const auto guess = static_cast<uint32_t>(std::min(area / 64 + 4096, 4e9));
    uint32_t want_nodes = std::max(guess, node_capacity_), want_slots = std::max(guess, slot_capacity_), want_entries = std::max(8 * guess, entry_capacity_);
    const auto shared = static_cast<int>(sizeof(uint32_t)) * kWarps * scratch_words(c.view_count, c.view_words);
    VDBCARVE_CUDA(cudaFuncSetAttribute(ask_nodes<1>, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    VDBCARVE_CUDA(cudaFuncSetAttribute(ask_nodes<8>, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    int device = 0, multiprocessors = 0;
    VDBCARVE_CUDA(cudaGetDevice(&device));
    VDBCARVE_CUDA(cudaDeviceGetAttribute(&multiprocessors, cudaDevAttrMultiProcessorCount, device));
    const unsigned grid = static_cast<unsigned>(multiprocessors) * 4;
    for (;;) {
        for (size_t side = 0; side < 2; ++side)
            c.nodes[side] = {node_key_[side].ensure(want_nodes), node_state_[side].ensure(want_nodes), node_views_[side].ensure(want_nodes * words)};
        c.slots = {slot_key_.ensure(want_slots), slot_state_.ensure(want_slots), slot_entry_.ensure(want_slots)};
        c.entries = reinterpret_cast<Entry*>(entries_.ensure(want_entries));
        c.entry_slot = entry_slot_.ensure(want_entries);
        c.node_capacity = node_capacity_ = want_nodes;
        c.slot_capacity = slot_capacity_ = want_slots;
        c.entry_capacity = entry_capacity_ = want_entries;
        times.measure("carve: nodes", stream, [&] {
            stream.zero(c.counters, kCounters + kTallies * kTallySize);
            if (c.topology.blocks) {
                ask_nodes<1><<<grid, 32 * kWarps, shared, stream.get()>>>(c, kBlockSide, 0);
                VDBCARVE_LAUNCHED();
                for (int level = 1, size = kBlockSide / 2; size >= 8; ++level, size /= 2) {
                    ask_nodes<8><<<grid, 32 * kWarps, shared, stream.get()>>>(c, size, level);
                    VDBCARVE_LAUNCHED();
                }
            }
            stream.to_host(host_counters_.data(), c.counters, kCounters);
        });
        stream.wait();
        unsigned long long nodes = 0;
        for (int level = 0; level < 4; ++level) nodes = std::max(nodes, host_counters_[kFirstLevel + level]);
        const unsigned long long slots = host_counters_[kFirstLevel + 4], entries = host_counters_[kEntries];
        if (nodes <= node_capacity_ && slots <= slot_capacity_ && entries <= entry_capacity_) break;
        constexpr unsigned long long kMost = 0xfffffff0u;
        if (nodes > kMost || slots > kMost / 4 || entries > kMost) throw BackendError("CUDA: more than 2^32 leaves or views of leaves. Remedy: --backend cpu");
        const auto roomy = [=](unsigned long long found, uint32_t had) {
            return static_cast<uint32_t>(std::max<unsigned long long>(had, std::min(found + found / 8, kMost)));
        };
        want_nodes = roomy(nodes, node_capacity_);
        want_slots = roomy(slots, slot_capacity_);
        want_entries = roomy(entries, entry_capacity_);
        topology_.cover(job.min, job.max, stream);  // without what the walk that ran out of room wrote
    }
    candidates_ = static_cast<uint32_t>(host_counters_[kFirstLevel + 4]);
    const auto entries = static_cast<uint32_t>(host_counters_[kEntries]);
    active_.ensure(static_cast<size_t>(candidates_) * 8);
    if (!job.occupancy) values_.ensure(static_cast<size_t>(candidates_) * kLeafVoxels);
    times.measure("carve: leaves", stream, [&] {
        if (candidates_ == 0) return;
        if (entries) {
            prepare_entries<<<blocks_for(entries, 128), 128, 0, stream.get()>>>(c, entries);
            VDBCARVE_LAUNCHED();
        }
        if (job.occupancy) {
            evaluate_binary<<<candidates_, kLeafVoxels, 0, stream.get()>>>(c, active_.data());
            VDBCARVE_LAUNCHED();
            return;
        }
        stream.zero(active_.data(), static_cast<size_t>(candidates_) * 8);
        if (perspective) {
            evaluate<true>(c, candidates_, values_.data(), active_.data(), stream.get());
        } else {
            evaluate<false>(c, candidates_, values_.data(), active_.data(), stream.get());
        }
        mark_inside_leaves<<<blocks_for(candidates_, 256), 256, 0, stream.get()>>>(c, candidates_);
        VDBCARVE_LAUNCHED();
    });
    times.measure("carve: topology", stream, [&] { topology_.number_leaves(stream); });
}

CarveCounts CarveStage::counts(const Stream& stream) {
    stream.to_host(host_counters_.data(), counters_.data(), kCounters + kTallies * kTallySize);
    stream.wait();
    CarveCounts out;
    for (int n = 0; n < kTallies; ++n) {
        const unsigned long long* sums = host_counters_.data() + kCounters + n * kTallySize;
        out.negative += sums[0];
        out.surface += sums[1];
        out.capped += sums[2];
        out.voxel_lookups += sums[3];
    }
    out.node_tests = host_counters_[kNodeTests];
    out.candidates = candidates_;
    return out;
}

size_t CarveStage::bytes() const {
    size_t nodes = 0;
    for (size_t side = 0; side < 2; ++side) nodes += node_key_[side].bytes() + node_state_[side].bytes() + node_views_[side].bytes();
    return topology_.bytes() + views_.bytes() + nodes + slot_key_.bytes() + slot_state_.bytes() + slot_entry_.bytes() + entries_.bytes() + entry_slot_.bytes() +
           values_.bytes() + active_.bytes();
}

}  // namespace vdbcarve::cuda
