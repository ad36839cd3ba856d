// SPDX-License-Identifier: Apache-2.0
#include "surface/filter_plan.h"

#include <charconv>
#include <cmath>

#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

struct Named {
    FilterKind kind;
    const char* name;
    int width, widest;  ///< by default, at most
};
constexpr Named kFilters[] = {{FilterKind::Median, "median", 1, 2},
                              {FilterKind::MeanCurvature, "mean-curvature", 1, 1},
                              {FilterKind::Laplacian, "laplacian", 1, 1},
                              {FilterKind::Gaussian, "gaussian", 1, kernel::kMostFilterWidth},
                              {FilterKind::EdgePreserving, "edge-preserving", 2, 2}};
constexpr int kMostIterations = 1000;

const Named& named(FilterKind kind) {
    for (const Named& n : kFilters)
        if (n.kind == kind) return n;
    throw UsageError("filter: unknown kind");
}

void check_step(const FilterStep& step, const std::string& text) {
    const Named& filter = named(step.kind);
    if (step.width_vox < 1 || step.width_vox > filter.widest)
        throw UsageError("--filter " + text + ": " + filter.name + " has a width of " +
                         (filter.widest == 1 ? "1 voxel" : "1.." + std::to_string(filter.widest) + " voxels") + ", not " + std::to_string(step.width_vox));
    if (step.iterations < 1 || step.iterations > kMostIterations)
        throw UsageError("--filter " + text + ": " + std::to_string(step.iterations) + " iterations, must be 1.." + std::to_string(kMostIterations));
}

}  // namespace

std::vector<FilterStep> parse_filters(const std::string& text) {
    std::vector<FilterStep> out;
    if (text == "none") return out;
    size_t at = 0;
    while (at <= text.size()) {
        const size_t comma = std::min(text.find(',', at), text.size());
        const std::string part = text.substr(at, comma - at);
        at = comma + 1;
        // NAME [: WIDTH] [x ITERATIONS]; of the names none ends in x and digits.
        std::string name = part;
        FilterStep step;
        int width = 0;
        const auto take_number = [&](char mark, int& value) {
            const size_t found = name.rfind(mark);
            if (found == std::string::npos) return;
            const char* end = name.data() + name.size();
            const auto read = std::from_chars(name.data() + found + 1, end, value);
            if (read.ec != std::errc() || read.ptr != end) {
                if (mark == 'x') return;  // a letter of the name
                throw UsageError("--filter " + text + ": '" + part + "' has no whole number behind ':'");
            }
            name.resize(found);
        };
        take_number('x', step.iterations);
        take_number(':', width);
        const Named* found = nullptr;
        std::string names;
        for (const Named& n : kFilters) {
            if (name == n.name) found = &n;
            names += std::string(names.empty() ? "" : ", ") + n.name;
        }
        if (!found) throw UsageError("--filter " + text + ": '" + part + "' is no filter; write NAME[:WIDTH][xITERATIONS] with " + names + ", or none alone");
        step.kind = found->kind;
        step.width_vox = part.find(':') == std::string::npos ? found->width : width;
        check_step(step, text);
        out.push_back(step);
    }
    return out;
}

std::string filters_text(const std::vector<FilterStep>& steps) {
    std::string out;
    for (const FilterStep& s : steps)
        out += (out.empty() ? "" : ",") + std::string(named(s.kind).name) + ":" + std::to_string(s.width_vox) + "x" + std::to_string(s.iterations);
    return out.empty() ? "none" : out;
}

std::vector<FilterStep> default_filters(double mask_softness) {
    // Soft masks leave nothing to smooth that is worth the edges. docs/stages/filter.md has the numbers.
    if (mask_softness >= 0.5) return {};
    if (mask_softness >= 0) return {{FilterKind::EdgePreserving, 2, 1}};
    return {{FilterKind::EdgePreserving, 2, 4}};
}

int half_width_of(const openvdb::FloatGrid& surface) {
    if (surface.getGridClass() != openvdb::GRID_LEVEL_SET) throw InputError("filter: grid '" + surface.getName() + "' is no level set");
    const double ratio = surface.background() / surface.voxelSize()[0];
    const long width = std::lround(ratio);
    if (width < 2 || width > 100 || std::fabs(ratio - static_cast<double>(width)) > 0.01)
        throw InputError("filter: the band of grid '" + surface.getName() + "' is " + std::to_string(ratio) +
                         " voxels wide on each side; 2 to 100 whole ones are needed");
    return static_cast<int>(width);
}

double most_keep_thin_vox(int half_width_vox) { return 2 * (std::min(half_width_vox, kernel::kMostFilterWidth) - 0.75); }

void check_filter(const FilterOptions& options, int half_width_vox) {
    for (const FilterStep& s : options.steps) check_step(s, filters_text({s}));
    const double most = most_keep_thin_vox(half_width_vox);
    if (!(options.keep_thin_vox >= 0 && options.keep_thin_vox <= most))
        throw UsageError("--keep-thin is " + std::to_string(options.keep_thin_vox) + " voxels, must be 0.." + std::to_string(most).substr(0, 3) +
                         " with a half-width of " + std::to_string(half_width_vox));
}

std::vector<kernel::FilterPass> passes_of(const std::vector<FilterStep>& steps) {
    using kernel::FilterPass;
    std::vector<FilterPass> out;
    for (const FilterStep& s : steps)
        for (int n = 0; n < s.iterations; ++n) switch (s.kind) {
                case FilterKind::Median:
                    out.push_back({FilterPass::Median, s.width_vox, 0});
                    break;
                case FilterKind::MeanCurvature:
                    out.push_back({FilterPass::MeanCurvature, 1, 0});
                    break;
                case FilterKind::Laplacian:
                    out.push_back({FilterPass::MeanOfSix, 1, 0});
                    break;
                case FilterKind::Gaussian:
                    for (int pass = 0; pass < 12; ++pass) out.push_back({FilterPass::Box, s.width_vox, pass % 3});
                    break;
                case FilterKind::EdgePreserving:
                    out.push_back({FilterPass::EdgePreserving, s.width_vox, 0});
                    break;
            }
    return out;
}

std::vector<kernel::FilterPass> thin_passes(double keep_thin_vox) {
    std::vector<kernel::FilterPass> out;
    for (int axis = 0; axis < 3; ++axis) out.push_back({kernel::FilterPass::Least, kernel::thin_reach(static_cast<float>(keep_thin_vox)), axis});
    return out;
}

void describe_volumes(FilterResult& result, const VolumeRepair& repair, double voxel) {
    const double unit = voxel * voxel * voxel / static_cast<double>(kernel::kVolumeUnits);
    result.volume_before = static_cast<double>(repair.target) * unit;
    result.volume_filtered = static_cast<double>(repair.before_move) * unit;
    result.volume = static_cast<double>(repair.volume) * unit;
    result.offset_vox = repair.offset_vox;
    result.repair_steps = repair.steps;
}

void explain_filtered_away(const FilterOptions& options) {
    throw ContradictionError(
        "filter: " + filters_text(options.steps) +
        " leaves nothing of the object: all of it is thinner than the filter is wide. Remedy: a higher --resolution, --keep-thin, or --filter none");
}

}  // namespace vdbcarve
