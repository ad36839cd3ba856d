// SPDX-License-Identifier: Apache-2.0
// Which stages an option makes anew: the whole table, and nothing else. A stage's key with its inputs held still says what it depends on itself; what is made
// from it follows.
#include <gtest/gtest.h>

#include <map>

#include "pipeline/stages/align.h"
#include "pipeline/stages/carve.h"
#include "pipeline/stages/color.h"
#include "pipeline/stages/fair.h"
#include "pipeline/stages/filter.h"
#include "pipeline/stages/floor.h"
#include "pipeline/stages/level_set.h"
#include "pipeline/stages/mask.h"
#include "pipeline/stages/mesh.h"
#include "pipeline/stages/repair.h"
#include "pipeline/stages/smooth.h"
#include "pipeline/stages/stereo.h"
#include "support/each_option.h"
#include "support/scenes.h"

namespace vdbcarve::test {
namespace {

using namespace pipeline;

/// Keys of all stages for some options, their inputs held still.
std::map<std::string, std::string> keys_of(const ReconstructOptions& o) {
    Progress progress;
    Run run(o, progress);
    pipeline::Shoot shoot;
    shoot.up_given = o.views.up;
    View view;
    view.name = "a.png";
    view.camera.intrinsics.width_px = view.camera.intrinsics.height_px = 2;
    view.camera.intrinsics.fx = view.camera.intrinsics.fy = 8;  // pixels a voxel, nearly: stereo takes every second one by default
    view.camera.camera_from_world.translation = Vec3d(0, 0, 1);
    shoot.views.views = {view};
    if (!o.views.up.empty()) shoot.views.up = o.views.up;
    if (!o.views.units.empty()) shoot.views.units = o.views.units;
    if (o.floor.from == FloorOptions::From::Given) shoot.stand_on({o.floor.height, "given", {}, {}});
    Silhouettes masks;
    masks.key = "masks";
    masks.masks.masks.resize(1);
    masks.masks.masks[0].coverage = Image8(2, 2, 1);
    masks.masks.origins = {"somewhere"};
    masks.names = {"a.png"};
    masks.edited = {{}};
    masks.file_hashes = {"hash"};
    masks.used = {0};
    std::map<std::string, std::string> keys;
    MakeMasks mask{shoot, o.mask};
    mask.known_ = masks;
    keys["mask"] = mask.key().hex();
    Align align{o, shoot, masks};
    align.prepare(run);
    keys["align"] = align.key().hex();
    keys["floor"] = FindFloor{shoot, masks, o.floor, o.carve.min_seen}.key().hex();
    keys["repair"] = RepairMasks{shoot, masks}.key().hex();
    const std::optional<KeptGrid> kept;
    keys["carve"] = Carve{o, shoot, masks, kept}.key().hex();
    Hull hull;
    hull.key = "hull";
    keys["level_set"] = LevelSet{o, shoot, masks, hull}.key().hex();
    Surface surface;
    surface.key = "surface";
    surface.grid = openvdb::FloatGrid::create(1.0f);
    keys["fair"] = Fair{o, shoot, masks, hull.grid, surface.grid, surface}.key().hex();
    Stereo stereo{o, shoot, masks, hull.grid, surface};
    stereo.prepare(run);
    keys["stereo"] = stereo.key().hex();
    Color color{o, shoot, masks, hull.grid, surface};
    color.prepare(run);
    keys["color"] = color.key().hex();
    Filter filter{o, shoot, masks, hull.grid, surface.grid, surface};
    filter.prepare(run);
    keys["filter"] = filter.key().hex();
    Colors colors;
    colors.key = "colors";
    colors.grid = openvdb::Vec3SGrid::create();
    ExtractMesh mesh{o, shoot, masks, surface, colors};
    mesh.prepare(run);
    keys["mesh"] = mesh.key().hex();
    Smooth smooth{o, surface, {}};
    smooth.prepare(run);
    keys["smooth"] = smooth.key().hex();
    return keys;
}

struct Row {
    const char* stages;
    std::vector<const char*> options;
};

/// Which stages an option makes again by itself. What is made from those follows.
const std::vector<Row> kTable = {
    {"mask",
     {"masks",
      "mask",
      "mask-pattern",
      "ignore-masks",
      "mask-invert",
      "allow-missing",
      "threshold",
      "threshold-channel",
      "threshold-invert",
      "chroma-key",
      "chroma-level",
      "clean-plate",
      "plate-level",
      "plate-keep-shadows",
      "grabcut-box",
      "grabcut-from-threshold",
      "grabcut-iterations",
      "mask-command",
      "mask-open",
      "mask-close",
      "mask-all-components",
      "mask-fill-holes"}},
    {"align",
     {"align-method", "mat",      "no-features", "paper-views",           "orbit",        "angles",        "arc[0]",       "arc[1]",         "direction",
      "rings",        "sittings", "fov",         "principal-point",       "focal-varies", "centre-varies", "known-height", "known-distance", "known-length",
      "align-points", "restarts", "align-seed",  "units (set by the job)"}},
    {"align", {"stereo"}},
    {"carve", {"resolution", "voxel-size", "grid", "bounds", "origin", "max-misses", "outside", "silhouette-offset", "field-scale", "half-width"}},
    {"carve floor", {"min-seen"}},
    {"carve color filter smooth stereo", {"occupancy"}},
    {"align carve", {"units"}},
    {"align carve color floor", {"up"}},
    {"align carve level_set", {"floor[0]"}},
    {"level_set", {"floor-clear", "base"}},
    {"fair", {"fairness"}},
    {"fair stereo", {"surface"}},  // how much depths have to say near the hull
    {"stereo",
     {"stereo-most-cost", "stereo-least-contrast", "stereo-least-margin", "stereo-agreeing", "stereo-agreement", "stereo-normal", "stereo-rim", "stereo-pairs",
      "stereo-least-angle", "stereo-most-angle", "stereo-scale", "stereo-levels", "stereo-passes", "stereo-depth", "stereo-truncation", "stereo-reach",
      "stereo-coarser-weight", "stereo-least-weight", "stereo-least-piece"}},
    {"color stereo", {"color-leave-out"}},
    {"color",
     {"color", "color-occlusion", "paper", "up (set by the job)", "exposure (set by the job)", "per channel (set by the job)", "exposure-noise",
      "exposure-spread", "exposure-iterations", "color-depth", "color-normal-radius"}},
    {"filter", {"filter", "no-volume-repair", "keep-thin"}},
    // A limit cuts the mesher's grid into slabs, and vertices come in another order.
    {"mesh", {"memory-limit", "mesher", "normals", "adaptivity", "min-piece", "color-source"}},
    {"smooth", {"quads", "smooth", "iterations (set by the job)", "smooth-lambda", "smooth-mu", "faces", "max-error"}},
    // What they change is among a stage's inputs (views, a video's frames), runs a stage or leaves it out, or is looked at after the last stage.
    {"",
     {"scene",
      "images",
      "cameras",
      "allow unposed (set by the job)",
      "pixel-centre",
      "accept-non-metric",
      "allow missing (set by the job)",
      "cameras only (set by the job)",
      "add",
      "video-frames",
      "video-range[0]",
      "video-range[1]",
      "repair-masks",
      "find-again",
      "accept-unobservable",
      "floor[1]",
      "cap-tolerance",
      "gains (set by the job)",
      "hull margin (set by the job)",
      "stereo-maps",
      "keep-hull",
      "mesh-formats",
      "dcc",
      "vdb-half",
      "stl-mm",
      "color-grids[0]",
      "color-grids[1]",
      "no-report"}},
};

TEST(Keys, EveryOptionChangesTheKeysThatTheTableSays) {
    ReconstructOptions plain;
    plain.run.backend = Backend::Cpu;
    const auto before = keys_of(plain);
    std::map<std::string, std::string> table;
    for (const Row& row : kTable)
        for (const char* option : row.options) EXPECT_TRUE(table.emplace(option, row.stages).second) << option << " stands twice";
    for (const OptionFlip<ReconstructOptions>& flip : option_flips<ReconstructOptions>()) {
        if (flip.name == "backend" || flip.name == "device") continue;  // which this machine may not have
        ReconstructOptions changed = plain;
        flip.change(changed);
        std::string stages;
        for (const auto& [stage, key] : keys_of(changed))
            if (key != before.at(stage)) stages += (stages.empty() ? "" : " ") + stage;
        std::printf("%-32s %s\n", flip.name.c_str(), stages.empty() ? "-" : stages.c_str());
        const auto said = table.find(flip.name);
        EXPECT_TRUE(said != table.end() || flip.keyed == Keyed::No) << "--" << flip.name << " is not in the table";
        EXPECT_EQ(stages, said == table.end() ? "" : said->second) << "--" << flip.name;
        if (said != table.end()) table.erase(said);
    }
    for (const auto& [option, stages] : table) ADD_FAILURE() << "--" << option << " is no option any more";
}

}  // namespace
}  // namespace vdbcarve::test
