// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include <tbb/parallel_for.h>

#include <functional>

#include "device/device_parts.h"
#include "fair/evidence.h"
#include "fair/fair_engine.h"
#include "fair/lone_lines.h"

namespace vdbcarve {

namespace {

using namespace fairing;
using openvdb::Coord;

class DeviceEngine final : public FairEngine {
  public:
    /// Masks' distances, on the device.
    using Fields = std::function<std::vector<kernel::FairMask>(const SightPlan&)>;

    DeviceEngine(cuda::FairStage& stage, cuda::FairSight& sight, cuda::FairDepthStage& depths, const openvdb::FloatGrid& hull, Fields fields, Fetcher& fetcher,
                 const cuda::Stream& stream, cuda::StageTimes& times)
        : stage_(stage), sight_(sight), depths_(depths), hull_(hull), fields_(std::move(fields)), fetcher_(fetcher), stream_(stream), times_(times) {}

    void take(const cuda::Grid& grid, const cuda::Topology& topology) {
        if (!stage_.take(grid, topology, static_cast<float>(hull_.voxelSize()[0]), stream_, times_)) throw InputError("fair: the hull has no surface");
        at_hand(stage_.coarsest_hull(), 0);
    }

    /// Of what depths carved.
    void take_depths(const cuda::Grid& carved, const cuda::Topology& topology, const openvdb::FloatGrid& confidence);

    const LeafLattice& lattice() const override { return lattice_; }
    double hull_volume_vox() override { return stage_.hull_volume_vox(stream_); }
    void coarsen(bool whole) override {
        stage_.coarsen(whole, stream_, times_);
        if (led_) depths_.coarsen(stream_, times_);
        at_hand(stage_.coarsest_hull(), lattice_.shift + 1);
    }
    void begin() override {
        stage_.begin(stream_, times_);
        if (led_) depths_.begin(static_cast<size_t>(lattice_.shift), stage_.level(), stream_, times_);
    }
    void refine() override {
        stage_.refine(stream_, times_);
        at_hand(stage_.level(), lattice_.shift - 1);
    }

    void aim(const SightPlan& plan, Progress&) override {
        const std::vector<kernel::FairMask> masks = fields_(plan);
        std::vector<cuda::FairView> views;
        for (size_t v = 0; v < masks.size(); ++v) views.push_back({masks[v], plan.eyes[v]});
        exact_ = plan.exact;
        sight_.aim(views, exact_, stage_, stream_, times_);
    }
    void find_near(float safe_vox, bool all) override { sight_.find_near(safe_vox, all, stage_, stream_, times_); }
    void repair(const Repair& how) override {
        cuda::FairSight::Repair r{how.rounds, how.along_vox, how.grows_from(), kPatience, {}, how.anywhere};
        for (size_t n = 0; n < kernel::kFairShares; ++n) r.takes[n] = how.takes(n, exact_);
        sight_.repair(
            r, [this](const std::vector<cuda::FairLoneLine>& lines) { return reach(lines); }, stage_, stream_, times_);
    }
    size_t open() const override { return sight_.open(); }
    size_t inside_samples() const override { return sight_.inside_samples(stream_); }

    void move(const kernel::FairBlur& blur, bool stiff) override { stage_.move(blur, stiff, stream_, times_); }
    void ease(float far_vox) override { stage_.ease(far_vox, stream_, times_); }
    bool led() const override { return led_; }
    void follow(float share) override { depths_.follow(static_cast<size_t>(lattice_.shift), stage_.level(), share, stream_, times_); }
    size_t drop_pieces(double share) override { return stage_.drop_pieces(share, stream_, times_); }
    void make_distances() override { stage_.make_distances(stream_, times_); }
    double volume_vox() override { return stage_.volume_vox(stream_); }
    openvdb::FloatGrid::Ptr surface() override;

  private:
    void at_hand(const cuda::FairLevel& level, int shift) {
        lattice_ = lattice_of(level, shift);
        leaf_at_.clear();
    }
    static LeafLattice lattice_of(const cuda::FairLevel& level, int shift) {
        LeafLattice out;
        out.shift = shift;
        out.lo = level.lo;
        out.size = level.size;
        return out;
    }
    /// The part of the level at hand that bridges from those lines can reach, and its leaves' numbers there.
    Level around(const std::vector<cuda::FairLoneLine>& lines, std::vector<uint32_t>& leaves);
    bool reach(const std::vector<cuda::FairLoneLine>& lines);
    static Coord origin_of(const LeafLattice& l, int32_t place) {
        const int z = place % l.size[2], row = place / l.size[2];
        return {8 * (row / l.size[1] + l.lo[0]), 8 * (row % l.size[1] + l.lo[1]), 8 * (z + l.lo[2])};
    }
    Coord origin_of(int32_t place) const { return origin_of(lattice_, place); }

    cuda::FairStage& stage_;
    cuda::FairSight& sight_;
    cuda::FairDepthStage& depths_;
    bool led_ = false;
    const openvdb::FloatGrid& hull_;
    Fields fields_;
    Fetcher& fetcher_;
    const cuda::Stream& stream_;
    cuda::StageTimes& times_;
    LeafLattice lattice_;
    bool exact_ = true;
    std::vector<int32_t> leaf_at_;  ///< of the level at hand, once it was asked for
};

void DeviceEngine::take_depths(const cuda::Grid& carved, const cuda::Topology& topology, const openvdb::FloatGrid& confidence) {
    if (!depths_.take(carved, topology, static_cast<float>(hull_.voxelSize()[0]), stream_, times_)) throw InputError("fair: depths leave no surface");
    const LeafLattice lattice = lattice_of(depths_.finest(), 0);
    std::vector<int32_t> places(depths_.finest().leaves);
    fetcher_.fetch_to(places.data(), depths_.finest().place_of.data(), places.size() * sizeof(int32_t), stream_);
    std::vector<Coord> origin;
    for (const int32_t place : places) origin.push_back(origin_of(lattice, place));
    depths_.set_weights(confidence_of(confidence, origin).data(), stream_);
    led_ = true;
}

Level DeviceEngine::around(const std::vector<cuda::FairLoneLine>& lines, std::vector<uint32_t>& leaves) {
    constexpr int kReach = kLongestBridge_vox + 2;
    Level out;
    static_cast<LeafLattice&>(out) = lattice_;
    if (leaf_at_.empty()) {
        leaf_at_.resize(lattice_.places());
        fetcher_.fetch_to(leaf_at_.data(), stage_.level().leaf_at.data(), leaf_at_.size() * sizeof(int32_t), stream_);
    }
    out.leaf_at.assign(leaf_at_.size(), kernel::kOutsideTile);
    const auto each_near = [&](const kernel::FairCell& c, const auto& visit) {
        const int at[3] = {c.i, c.j, c.k};
        int first[3], last[3];
        for (size_t a = 0; a < 3; ++a) {
            first[a] = std::max((at[a] - kReach) >> 3, lattice_.lo[a]);
            last[a] = std::min((at[a] + kReach) >> 3, lattice_.lo[a] + lattice_.size[a] - 1);
        }
        for (int x = first[0]; x <= last[0]; ++x)
            for (int y = first[1]; y <= last[1]; ++y)
                for (int z = first[2]; z <= last[2]; ++z) visit(lattice_.place(x, y, z), Coord(8 * x, 8 * y, 8 * z));
    };
    for (const cuda::FairLoneLine& lone : lines)
        each_near(kernel::sample_cell(lone.line.ray, lone.at.place.sample), [&](size_t place, const Coord& origin) {
            if (out.leaf_at[place] != kernel::kOutsideTile) return;
            out.leaf_at[place] = leaf_at_[place];
            if (leaf_at_[place] < 0) return;
            out.leaf_at[place] = static_cast<int32_t>(leaves.size());
            out.origin.push_back(origin);
            leaves.push_back(static_cast<uint32_t>(leaf_at_[place]));
        });
    out.hull.of.resize(leaves.size() * kLeafVoxels);
    out.field.of.resize(leaves.size() * kLeafVoxels);
    sight_.fetch_leaves(leaves, out.hull.of.data(), out.field.of.data(), stage_, stream_);
    return out;
}

bool DeviceEngine::reach(const std::vector<cuda::FairLoneLine>& lines) {
    std::vector<uint32_t> leaves, fell;
    Level level = around(lines, leaves);
    std::vector<LoneLine> lone;
    for (const cuda::FairLoneLine& l : lines) lone.push_back({l.line, l.at});
    std::vector<float> values;
    for (const size_t n : reach_alone(level, std::move(lone))) {
        fell.push_back(leaves[n]);
        const auto from = level.field.of.begin() + static_cast<long>(n * kLeafVoxels);
        values.insert(values.end(), from, from + kLeafVoxels);
    }
    sight_.replace_leaves(fell, values.data(), stage_, stream_);
    return !fell.empty();
}

openvdb::FloatGrid::Ptr DeviceEngine::surface() {
    const auto voxel = static_cast<float>(hull_.voxelSize()[0]);
    const cuda::FairStage::Surface made = stage_.surface(voxel, stream_, times_);
    std::vector<int32_t> places(made.leaves), inside(made.tiles);
    std::vector<uint64_t> active(size_t{8} * made.leaves);
    fetcher_.fetch_to(places.data(), made.places, places.size() * sizeof(int32_t), stream_);
    fetcher_.fetch_to(inside.data(), made.inside, inside.size() * sizeof(int32_t), stream_);
    fetcher_.fetch_to(active.data(), made.active, active.size() * sizeof(uint64_t), stream_);
    const openvdb::FloatGrid::Ptr out = empty_surface(hull_);
    const float band = out->background();
    std::vector<std::unique_ptr<openvdb::FloatTree::LeafNodeType>> leaves(made.leaves);
    constexpr size_t kBytes = kLeafVoxels * sizeof(float);
    fetcher_.fetch(made.values, leaves.size() * kBytes, kBytes, stream_, [&](const uint8_t* piece, size_t at, size_t size) {
        tbb::parallel_for(at / kBytes, (at + size) / kBytes, [&](size_t n) {
            leaves[n] = make_leaf(origin_of(places[n]), reinterpret_cast<const float*>(piece + (n * kBytes - at)), active.data() + 8 * n, band);
        });
    });
    for (auto& leaf : leaves) out->tree().addLeaf(leaf.release());
    for (const int32_t place : inside) out->tree().addTile(1, origin_of(place), -band, false);
    out->pruneGrid();
    return out;
}

}  // namespace

FairResult Device::fair(const openvdb::FloatGrid& hull, const std::vector<FairView>& views, const FairOptions& options, Progress& progress,
                        const FairEvidence* evidence) {
    Parts& p = *parts_;
    p.use();
    fairing::check_fair(options);
    bool uploaded = false;
    const auto fields = [&](const SightPlan& plan) {
        if (!uploaded) upload(plan.masks);
        uploaded = true;
        distance(plan.fields);
        std::vector<kernel::FairMask> out;
        for (size_t v = 0; v < p.headers.size(); ++v) out.push_back(mask_of(p.headers[v], p.silhouettes[v].samples, p.ignored[v].samples));
        return out;
    };
    DeviceEngine engine(p.fair, p.fair_sight, p.fair_depths, hull, fields, p.fetcher, p.stream, p.times);
    const Parts::Volume& volume = p.need(p.surface, "level set");
    engine.take(volume.grid, *volume.topology);
    if (evidence) {
        Parts::Volume& carved = p.fused;  // what depths carved on the device lay there
        p.upload(carved, evidence->carved);
        engine.take_depths(carved.grid, *carved.topology, evidence->confidence);
    }
    return fair_by(engine, hull, views, options, progress);
}

}  // namespace vdbcarve
