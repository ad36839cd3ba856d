// SPDX-License-Identifier: Apache-2.0
// Whether options make sense: each by itself, by the limits that its visit() states, and then with each other.
#include "vdbcarve/config.h"
#include "vdbcarve/error.h"
#include "vdbcarve/file_frame.h"
#include "vdbcarve/video.h"

namespace vdbcarve {
namespace {

class Faults {
  public:
    void need(bool ok, const std::string& what) {
        if (!ok) add(what);
    }
    void add(const std::string& what) {
        if (!what.empty()) all_ += (all_.empty() ? "" : "; ") + what;
    }
    const std::string& all() const { return all_; }

  private:
    std::string all_;
};

void check_masks(const MaskOptions& m, Faults& faults) {
    const bool by_threshold = m.method == MaskMethod::Threshold || (m.method == MaskMethod::GrabCut && m.grabcut.from_threshold);
    const bool from_photographs = by_threshold || m.method == MaskMethod::Chroma || m.method == MaskMethod::CleanPlate || m.method == MaskMethod::GrabCut;
    faults.need(by_threshold || m.threshold == ThresholdOptions(), "--threshold, --threshold-channel and --threshold-invert are of --mask threshold");
    faults.need(m.method == MaskMethod::Chroma || m.chroma == ChromaOptions(), "--chroma-key and --chroma-level are of --mask chroma");
    faults.need(m.method == MaskMethod::CleanPlate || m.plate == PlateOptions(), "--clean-plate and --plate-… are of --mask clean-plate");
    faults.need(m.method == MaskMethod::GrabCut || m.grabcut == GrabCutOptions(), "--grabcut-… is of --mask grabcut");
    faults.need(m.method != MaskMethod::Command || !m.command.empty(), "--mask command: which program? Remedy: --mask-command 'tool {in} {out}'");
    faults.need(
        from_photographs || m.clean_up == MaskCleanUp(),
        "--mask-open, --mask-close, --mask-fill-holes and --mask-all-components are of masks made from photographs (--mask threshold, chroma, clean-plate, "
        "grabcut)");
}

/// What options say of each other.
void check_rules(const ReconstructOptions& o, Faults& faults) {
    faults.need(o.floor.from != FloorOptions::From::Found || o.align.method != AlignMethod::Mat, "--floor auto: the mat says where the floor is");
    faults.need(is_video(o.views.scene) || o.video == VideoOptions(),
                "--video-frames and --video-range are of videos; " + o.views.scene.string() + " is not one");
    faults.need(o.views.units.empty() || metres_per(o.views.units), "--units " + o.views.units + ": must be one of m, cm, mm, km, inch, ft");
    check_masks(o.mask, faults);
    faults.need((o.grid.resolution > 0) + (o.grid.voxel_size > 0) + o.grid.dims.has_value() <= 1, "give one of --resolution, --voxel-size and --grid");
    faults.need(!o.mesh.normals || o.mesh.mesher == Mesher::MarchingCubes, "--normals are made by --mesher marching-cubes only");
    faults.need(o.mesh.mesher == Mesher::Dual || o.mesh.adaptivity == 0, "--adaptivity is of --mesher dual; marching cubes has none");
    faults.need(!o.mesh.quads || o.mesh.mesher == Mesher::Dual, "--quads are made by --mesher dual only");
    faults.need(!o.stereo.is_wanted() || !o.carve.occupancy, "--stereo carves a level set, and --occupancy makes none");
    faults.need(!o.color.options.skip_upright || o.color.options.mode == ColorMode::Best, "--paper is of --color best");
    faults.need(o.color.leave_out != 1, "--color-leave-out is 1, must be 0 (none) or at least 2 (every second)");
    const SmoothOptions& s = o.smooth.factors;
    faults.need(s.lambda > 0 && s.lambda < 1 && s.mu < -s.lambda && s.mu > -2, "--smooth-lambda must be within 0..1 and --smooth-mu less than its negative");
}

}  // namespace

void check_options(const ReconstructOptions& options) {
    ReconstructOptions listed = options;
    Faults faults;
    for (const OptionEntry& e : list_options(listed))
        if (!e.alias) faults.add(e.fault());
    check_rules(options, faults);
    if (!faults.all().empty()) throw UsageError(faults.all());
}

}  // namespace vdbcarve
