// SPDX-License-Identifier: Apache-2.0
// The whole job, from a scene to the files of a result. Each line below is a stage in stages/, run and kept by run.h.
#include "pipeline/advice.h"
#include "pipeline/kept_grid.h"
#include "pipeline/publish.h"
#include "pipeline/stages/align.h"
#include "pipeline/stages/carve.h"
#include "pipeline/stages/color.h"
#include "pipeline/stages/distance.h"
#include "pipeline/stages/fair.h"
#include "pipeline/stages/filter.h"
#include "pipeline/stages/floor.h"
#include "pipeline/stages/level_set.h"
#include "pipeline/stages/mask.h"
#include "pipeline/stages/mesh.h"
#include "pipeline/stages/repair.h"
#include "pipeline/stages/smooth.h"
#include "pipeline/stages/stereo.h"
#include "pipeline/stages/views.h"
#include "vdbcarve/config.h"

namespace vdbcarve {

using namespace pipeline;

namespace {

/// Cameras are found, and refused where they must not be trusted. From a mat before there are masks, from silhouettes after.
void find_cameras(Run& run, Shoot& shoot, Silhouettes& masks) {
    shoot = run(Align{run.options(), shoot, masks});
    if (!masks.names.empty()) masks.used = choose_used(run.options(), shoot, masks, run.progress());
    refuse_or_warn(run, shoot, masks);
    run.keep_cameras(shoot.views);
}

Silhouettes find_silhouettes(Run& run, const Shoot& shoot) {
    Silhouettes masks = run(MakeMasks{shoot, run.options().mask});
    masks.used = choose_used(run.options(), shoot, masks, run.progress());
    show_masks(run, masks);
    return masks;
}

}  // namespace

Reconstruction reconstruct(const ReconstructOptions& o, Progress& progress) {
    openvdb::initialize();
    check_options(o);
    Run run(o, progress);
    return run.guarded([&] {
        const LastStage last = o.run.last_stage;
        const bool by_mat = o.align.method == AlignMethod::Mat && last != LastStage::Mask;
        warn_of_idle_options(o, progress);
        Shoot shoot = run(LoadViews{o});
        Silhouettes masks;
        if (by_mat) find_cameras(run, shoot, masks);
        if (!by_mat || last != LastStage::Align) masks = find_silhouettes(run, shoot);
        if (last == LastStage::Mask) return publish(run, shoot, masks);
        if (!by_mat && finds_cameras(o, shoot.views)) find_cameras(run, shoot, masks);
        if (o.floor.from != FloorOptions::From::File) shoot.stand_on(run(FindFloor{shoot, masks, o.floor, o.carve.min_seen}));
        if (last == LastStage::Align) return publish_cameras(run, shoot, masks);
        if (o.mask.repair && !o.run.dry_run) masks = run(RepairMasks{shoot, masks});
        const std::optional<KeptGrid> kept = grid_to_keep(o, shoot, progress);
        Carve carve{o, shoot, masks, kept};
        carve.plan = run(Distance{o, shoot, masks, kept, carve.is_there(run)});
        if (o.run.dry_run) return publish(run, shoot, masks, carve.plan);
        Hull hull = run(std::move(carve));
        if (last == LastStage::Carve) return publish(run, shoot, masks, kept, hull);
        Surface surface = run(LevelSet{o, shoot, masks, hull});
        const openvdb::FloatGrid::Ptr level_set = surface.grid;
        if (o.stereo.is_wanted())
            if (Surface carved = run(Stereo{o, shoot, masks, hull.grid, surface}); Stereo::is_used(o.stereo, carved)) surface = std::move(carved);
        if (makes_fair(o)) surface = run(Fair{o, shoot, masks, hull.grid, level_set, std::move(surface)});
        const Colors colors = o.color.options.mode == ColorMode::None ? Colors() : run(Color{o, shoot, masks, hull.grid, surface});
        surface = run(Filter{o, shoot, masks, hull.grid, level_set, std::move(surface)});
        MeshMade mesh = run(ExtractMesh{o, shoot, masks, surface, colors});
        mesh = run(Smooth{o, surface, std::move(mesh)});
        return publish(run, {shoot, masks, kept, hull, surface, colors, mesh});
    });
}

}  // namespace vdbcarve
