// SPDX-License-Identifier: Apache-2.0
// What the options structs of the stages say of their members (visit.h): names, limits, help.
#pragma once

#include "vdbcarve/align.h"
#include "vdbcarve/color.h"
#include "vdbcarve/fair.h"
#include "vdbcarve/mask.h"
#include "vdbcarve/option_text.h"
#include "vdbcarve/smooth.h"
#include "vdbcarve/stereo.h"
#include "vdbcarve/video.h"
#include "vdbcarve/views.h"
#include "vdbcarve/visit.h"

namespace vdbcarve {

inline constexpr Word<PixelCentre> kPixelCentreWords[] = {
    {"default", PixelCentre::Default}, {"corner", PixelCentre::Corner}, {"integer", PixelCentre::Integer}};
inline constexpr Word<MaskMethod> kMaskMethodWords[] = {{"auto", MaskMethod::Auto},       {"alpha", MaskMethod::Alpha},
                                                        {"folder", MaskMethod::Folder},   {"threshold", MaskMethod::Threshold},
                                                        {"chroma", MaskMethod::Chroma},   {"clean-plate", MaskMethod::CleanPlate},
                                                        {"grabcut", MaskMethod::GrabCut}, {"command", MaskMethod::Command}};
inline constexpr Word<MaskChannel> kMaskChannelWords[] = {{"brightness", MaskChannel::Brightness},
                                                          {"saturation", MaskChannel::Saturation},
                                                          {"red", MaskChannel::Red},
                                                          {"green", MaskChannel::Green},
                                                          {"blue", MaskChannel::Blue}};
inline constexpr Word<AlignMethod> kAlignMethodWords[] = {
    {"coherence", AlignMethod::Coherence}, {"refine", AlignMethod::Refine}, {"mat", AlignMethod::Mat}, {"paper", AlignMethod::Paper}};
inline constexpr Word<Orbit> kOrbitWords[] = {
    {"auto", Orbit::Auto}, {"turntable", Orbit::Turntable}, {"fixed-camera", Orbit::FixedCamera}, {"hand-held", Orbit::HandHeld}};
inline constexpr Word<Turn> kTurnWords[] = {{"auto", Turn::Auto}, {"cw", Turn::Clockwise}, {"ccw", Turn::Counterclockwise}};
inline constexpr Word<ColorMode> kColorModeWords[] = {{"none", ColorMode::None}, {"best", ColorMode::Best}, {"blend", ColorMode::Blend}};
inline constexpr Word<bool> kOnOffWords[] = {{"on", true}, {"off", false}};
inline constexpr Word<double> kThresholdWords[] = {{"auto", ThresholdOptions::kAuto}, {"otsu", ThresholdOptions::kOtsu}};
inline constexpr const char* kUpWords[] = {"x", "y", "z", "-x", "-y", "-z"};

inline constexpr const char* kAlignGroup = "Alignment (without a camera file, or with --method)";

template <OptionsOf<ViewsOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"scene", "folder with images/ (or photos directly in it), masks/ and a camera file; or a video (.mp4, .mov, …)", "Options", in::kScenes, nullptr,
             "folder that photographs arrive in (images/, or directly), with a camera file of all views to come, and masks/ where masks are files"},
      o.scene, Text{});
    v(Option{"images", "folder of photographs", "Scene", in::kScenes}, o.images, Text{});
    v(Option{"cameras",
             "camera file: transforms.json, cameras.json, COLMAP folder, *_par.txt, .pa, .mat or text with 3x4 matrices; experimental: OpenCV's .yml, .xml, "
             ".json, Metashape's .xml, Bundler's .out, VisualSFM's .nvm, OpenMVG's .json, Meshroom's .sfm, RealityCapture's .csv",
             "Scene", in::kScenes},
      o.cameras, Text{});
    v.set_by_job("allow unposed", o.allow_unposed);
    v(Option{"pixel-centre", "centre of the first pixel: corner (0.5, 0.5) or integer (0, 0); default: the camera format's own", "Scene", in::kScenes},
      o.pixel_centre, Words(kPixelCentreWords));
    v(Option{"accept-non-metric", "carve in a projective world all the same", "Scene", in::kScenes}, o.accept_non_metric, Flag{});
    v.set_by_job("allow missing", o.allow_missing);  // as --allow-missing of masks says
    v.set_by_job("cameras only", o.cameras_only);
    v(Option{"up", "world up axis: x, y, z, -x, -y, -z", "Result"}, o.up, OneOf(kUpWords));
    v(Option{"units", "length unit of the scene: m, cm, mm, km, inch, ft", "Result"}, o.units, Text{});
    v(Option{"add",
             "take the views of SCENE2, too, which is of the same world. Where OUT already holds a result, its bounds and voxels are kept and its hull is "
             "extended. Once for each scene that the result is to be of. The scene itself: photographs that came into it",
             "Scene", in::kCarving, "SCENE2", "take the views of SCENE2, too, which is of the same world; once for each scene"},
      o.added, Text{});
    v.ignore(o.is_whole);
}

template <OptionsOf<FairOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"fairness", "how far the surface may be smoothed with --surface fair, as a share of the object's longest side", "Surface", in::kMeshing},
      o.fairness, within(0, 0.5));
}

template <OptionsOf<VideoOptions> O, class V>
void visit(O& o, V& v) {
    constexpr unsigned kVideos = in::kAll & ~in::kWatch;
    v(Option{"video-frames", "frames to take of a video, evenly in motion, the sharpest near each place", "Scene", kVideos}, o.frames, within(4, 10000));
    v.joint(Option{"video-range", "FROM,TO: seconds of the video to use (default: all)", "Scene", kVideos}, VideoRangeForm{}, o.from_s, o.to_s);
}

template <OptionsOf<ThresholdOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"threshold", "level 0..255 for --mask threshold; auto: Otsu's of the square root; otsu", "Masks", in::kScenes}, o.level,
      within(0, 255).or_words(kThresholdWords));
    v(Option{"threshold-channel", "brightness (largest of R, G, B), saturation, red, green or blue", "Masks", in::kScenes}, o.channel,
      Words(kMaskChannelWords));
    v(Option{"threshold-invert", "the object is what is darker", "Masks", in::kScenes}, o.invert, Flag{});
}

template <OptionsOf<ChromaOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"chroma-key", "R,G,B (0..255) or #rrggbb of the cloth (default: the most frequent colour along the photographs' borders)", "Masks", in::kScenes},
      o.key_rgb, RgbForm{});
    v(Option{"chroma-level", "object where less than this share of the key is (default: found, 0.3..0.7)", "Masks", in::kScenes}, o.level,
      within(0.01, 0.99).or_unset(0));
}

template <OptionsOf<PlateOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"clean-plate", "photograph of the background alone, or a folder with one of each view's name; implies --mask clean-plate", "Masks", in::kScenes},
      o.plate, Text{});
    v(Option{"plate-level", "object where the difference exceeds this many standard deviations", "Masks", in::kScenes}, o.level, within(1, 100));
    v(Option{"plate-keep-shadows", "what has the plate's colour, only darker, counts as object too", "Masks", in::kScenes}, o.shadows, Flag{false});
}

template <OptionsOf<GrabCutOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"grabcut-box", "x0,y0,x1,y1: pixels that hold the object in every view (default: all but a border)", "Masks", in::kScenes}, o.box_px,
      PixelBoxForm{});
    v(Option{"grabcut-from-threshold", "start from the mask of --threshold instead of a box", "Masks", in::kScenes}, o.from_threshold, Flag{});
    v(Option{"grabcut-iterations"}, o.iterations, within(1, 100));
}

template <OptionsOf<MaskCleanUp> O, class V>
void visit(O& o, V& v) {
    v(Option{"mask-open", "opening of masks made from photographs, px", "Masks", in::kScenes}, o.open_px, within(0, 200));
    v(Option{"mask-close", "closing of masks made from photographs, px", "Masks", in::kScenes}, o.close_px, within(0, 200));
    v(Option{"mask-all-components", "keep every piece of a mask made from a photograph, not only the largest", "Masks", in::kScenes}, o.largest_component,
      Flag{false});
    v(Option{"mask-fill-holes", "fill holes up to this share of the object's area (1: all)", "Masks", in::kScenes}, o.fill_holes, within(0, 1));
}

template <OptionsOf<MaskOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"masks", "folder of masks (white = object)", "Scene", in::kScenes}, o.masks, Text{});
    v(Option{"mask",
             "where masks come from: auto (files, else alpha, else images that are silhouettes), alpha, folder, threshold, chroma (a coloured cloth behind), "
             "clean-plate (photographs without the object), grabcut (colours, from a box)",
             "Masks", in::kScenes},
      o.method, Words(kMaskMethodWords));
    v(Option{"mask-pattern", "mask files by name, like '{stem}_m.png'", "Masks", in::kScenes}, o.pattern, Text{});
    v(Option{"ignore-masks", "folder of masks of what neither carves nor confirms", "Masks", in::kScenes}, o.ignore_masks, Text{});
    v(Option{"mask-invert", "masks are black where the object is", "Masks", in::kScenes}, o.invert, Flag{});
    v(Option{"allow-missing", "leave out views whose image or mask is missing or empty", "Masks", in::kScenes}, o.allow_missing, Flag{});
    v.part(o.threshold);
    v.part(o.chroma);
    v.part(o.plate);
    v.part(o.grabcut);
    v(
        Option{
            "mask-command",
            "'tool {in} {out}': a program that makes the mask of a photograph (a PNG, white or opaque where the object is); run without a shell, its masks are "
            "kept",
            "Masks", in::kScenes},
        o.command, Text{});
    v.not_in_key(Option{"mask-command-jobs", "commands at a time", "Masks", in::kScenes}, o.command_jobs, within(1, 256));
    v.part(o.clean_up);
    v(Option{"repair-masks", "mend masks that contradict all others, by the other views and the photograph", "Masks", in::kCarving}, o.repair, Flag{});
    v.ignore(o.cache);
}

template <OptionsOf<AlignOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"align-method"}, o.method, Words(kAlignMethodWords));  // --method is reconstruct's, and also says that cameras are to be found
    v(Option{"mat",
             "the mat that the object stands on: the .json written beside the print, grid:COLSxROWS:MARKER:GAP:DICT or charuco:COLSxROWS:SQUARE:MARKER:DICT "
             "(metres)",
             kAlignGroup, in::kAligning},
      o.mat, MatForm{});
    v(Option{"no-features", "leave the photographs' texture alone (refine fits it, and coherence asks it for the direction)", kAlignGroup, in::kAligning},
      o.features, Flag{false});
    v(Option{"paper-views", "A,B: names of the views of the front and of a quarter turn on, for --method paper", kAlignGroup, in::kAligning}, o.paper_views,
      PaperViewsForm{});
    v(Option{"orbit",
             "who moves: turntable (by known steps), fixed-camera (steps uneven), hand-held; auto: the simplest that explains contour points it was not fitted "
             "to",
             kAlignGroup, in::kAligning},
      o.orbit, Words(kOrbitWords));
    v(Option{"angles", "degrees the object has turned at each view: equal (default), a list like 0,20,40 or a file with as many numbers as views", kAlignGroup,
             in::kAligning},
      o.angles_deg, AnglesForm{});
    v.joint(
        Option{"arc",
               "degrees the object turns over a ring of views: 360 for one whole turn (the last view is one step before the first again), 335 where the walk "
               "stopped short, 720 for two turns; auto: not known",
               kAlignGroup, in::kAligning},
        ArcForm{}, o.arc_deg, o.arc_known);
    v(Option{"direction",
             "the object's turn from view to view, seen from above: cw, ccw or auto. ccw: what is in front moves to the right in the images\n"
             "            ccw   .---.          cw   .---.\n"
             "                 v     |             |     v\n"
             "                  '-->'               '<--'\n"
             "                  [cam]               [cam]",
             kAlignGroup, in::kAligning},
      o.direction, Words(kTurnWords));
    v(Option{"rings", "views in each ring around the object, in the order of their names, like 24,24", kAlignGroup, in::kAligning}, o.rings, CountsForm{});
    v(Option{"sittings", "views of each sitting (the object laid on another side), likewise", kAlignGroup, in::kAligning}, o.sittings, CountsForm{});
    v(Option{"fov",
             "horizontal field of view, degrees, to start from (default: what cameras or photographs say, else found); where silhouettes say another, that one "
             "is "
             "used, with a warning",
             kAlignGroup, in::kAligning},
      o.fov_deg, within(1, 169).or_unset(0));
    v(Option{"principal-point", "x,y in pixels, where it is known (default: found near the middle)", kAlignGroup, in::kAligning}, o.principal_point_px,
      PixelForm{});
    v(Option{"focal-varies", "every view has its own focal length, a little different (autofocus)", kAlignGroup, in::kAligning}, o.focal_varies, Flag{});
    v(Option{"centre-varies", "every view has its own principal point (a stabiliser's crop)", kAlignGroup, in::kAligning}, o.centre_varies, Flag{});
    v(Option{"known-height", "of the object along the axis, in --units: gives the scale", kAlignGroup, in::kAligning}, o.known_height, above(0).or_unset(0));
    v(Option{"known-distance", "of the cameras from the object's middle, in --units: gives the scale", kAlignGroup, in::kAligning}, o.known_distance,
      above(0).or_unset(0));
    v(Option{"known-length", "VIEW:X1,Y1,X2,Y2:LENGTH: two pixels of a view and how far apart, in --units, the places are that they show: gives the scale",
             kAlignGroup, in::kAligning},
      o.known_length, KnownLengthForm{});
    v.set_by_job("units", o.units);
    v(Option{"align-points"}, o.points, within(10, 5000));
    v(Option{"restarts", "times to start again from disturbed angles, to see what is left open", kAlignGroup, in::kAligning}, o.restarts, within(0, 20));
    v(Option{"align-seed"}, o.seed, at_least(0));
}

template <OptionsOf<StereoTrust> O, class V>
void visit(O& o, V& v) {
    v(Option{"stereo-most-cost"}, o.most_cost, within(0, 2));
    v(Option{"stereo-least-contrast"}, o.least_contrast, at_least(0));
    v(Option{"stereo-least-margin"}, o.least_margin, at_least(0));
    v(Option{"stereo-agreeing"}, o.agreeing, at_least(0));
    v(Option{"stereo-agreement"}, o.agreement_px, at_least(0));
    v(Option{"stereo-normal"}, o.normal_deg, within(0, 180));
    v(Option{"stereo-rim"}, o.rim_px, at_least(0));
}

template <OptionsOf<StereoOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"stereo-pairs"}, o.pairs, within(2, 8));
    v(Option{"stereo-least-angle"}, o.least_angle_deg, within(0, 180));
    v(Option{"stereo-most-angle"}, o.most_angle_deg, within(0, 180));
    v(Option{"stereo-scale", "photographs are compared at 1/N of their size: 1 finest and slowest; 0: as fine as the voxels need", "Stereo", in::kMeshing},
      o.scale, within(0, kMostStereoScale));
    v(Option{"stereo-levels", "sizes of photographs that are compared, each half of the one before", "Stereo", in::kMeshing}, o.levels, within(1, 4));
    v(Option{"stereo-passes"}, o.passes, within(1, 1000));
    v(Option{"stereo-depth", "how deep behind the hull depths are searched, as a share of the object's size", "Stereo", in::kMeshing}, o.depth_share,
      within(0.01, 1));
    v.part(o.trust);
    v(Option{"stereo-truncation"}, o.truncation_vox, above(0));
    v(Option{"stereo-reach"}, o.reach_share, at_least(0));
    v(Option{"stereo-coarser-weight"}, o.coarser_weight, at_least(0));
    v(Option{"stereo-least-weight"}, o.least_weight, at_least(0));
    v(Option{"stereo-least-piece"}, o.least_piece, at_least(0));
    v.set_by_job("hull margin", o.hull_margin_px);
}

template <OptionsOf<ExposureOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"exposure-noise"}, o.noise, above(0));
    v(Option{"exposure-spread"}, o.spread, above(0));
    v(Option{"exposure-iterations"}, o.iterations, within(1, 10000));
    v.set_by_job("per channel", o.per_channel);  // --exposure channels
}

template <OptionsOf<ColorOptions> O, class V>
void visit(O& o, V& v) {
    v(Option{"color", "blend (default): three views that see the place, weighted; best: the one most in front (the paper); none", "Colour", in::kMeshing},
      o.mode, Words(kColorModeWords));
    v(Option{"color-occlusion", "off: hidden surfaces take the colour of what stands before them, as in the paper", "Colour", in::kMeshing}, o.test_occlusion,
      Words(kOnOffWords));
    v(Option{"paper", "with --color best: faces that look straight up or down (within 2.6 degrees) are left to the fill (the paper's listing 4.2)", "Colour",
             in::kMeshing},
      o.skip_upright, Flag{});
    v.set_by_job("up", o.up);
    v.set_by_job("exposure", o.exposure);
    v.alias(Option{"exposure", "gain (default): even out the photographs' exposures; channels: their white balance too; none", "Colour", in::kMeshing},
            ExposureForm{}, o.exposure, o.exposure_options.per_channel);
    v.part(o.exposure_options);
    v.set_by_job("gains", o.gains);
    v(Option{"color-depth", "layers of voxels, from the surface inwards, that get colour", "Colour", in::kMeshing}, o.depth_vox, within(1, 1000));
    v(Option{"color-normal-radius", "the paper's normals, from a window of this many voxels (default: the level set's; 3 with --occupancy)", "Colour",
             in::kMeshing},
      o.normal_radius_vox, within(1, kMaxNormalRadius_vox).or_unset(0));
    v.ignore(o.batch);
}

template <OptionsOf<SmoothOptions> O, class V>
void visit(O& o, V& v) {
    v.set_by_job("iterations", o.iterations);
    v(Option{"smooth-lambda", "its shrinking factor", "Mesh", in::kMeshing}, o.lambda, within(0, 1));
    v(Option{"smooth-mu", "its growing factor, below minus lambda", "Mesh", in::kMeshing}, o.mu, within(-2, 0));
    v.alias(Option{"smooth-pass-band", "the same by the frequency that passes, 1/lambda + 1/mu (0.1; 0: by --smooth-mu)", "Mesh", in::kMeshing, "FLOAT"},
            PassBandForm{}, o.lambda, o.mu);
}

}  // namespace vdbcarve
