// SPDX-License-Identifier: Apache-2.0
// reconstruct, and its first parts as commands of their own: mask, carve.
#include <spdlog/spdlog.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli.h"
#include "vdbcarve/pipeline.h"
#include "vdbcarve/app/watch.h"

namespace vdbcarve::cli {
namespace {

struct Raw {
    ReconstructOptions options;
    std::string bounds, grid, origin;
    std::string video_range, angles, rings, sittings, principal_point, mat, paper_views, known_length;
    double pass_band = 0;
    bool resume = false;  // finished stages are never redone anyway; the flag says so in scripts
    WatchOptions watch;   // but for its `reconstruct`
};

/// "8G", "500M", "64K" or plain bytes; powers of 1024.
size_t bytes_of(const std::string& option, const std::string& text) {
    std::string digits = text;
    if (!digits.empty() && (digits.back() == 'B' || digits.back() == 'b')) digits.pop_back();
    const size_t unit = digits.empty() ? std::string::npos : std::string("KMGT").find(static_cast<char>(std::toupper(digits.back())));
    if (unit != std::string::npos) digits.pop_back();
    const double bytes = numbers(option, digits, 1)[0] * (unit == std::string::npos ? 1.0 : std::pow(1024.0, static_cast<double>(unit) + 1));
    if (!(bytes >= 1)) throw UsageError(option + " " + text + ": must be > 0");
    return static_cast<size_t>(bytes);
}

/// Words of a list or of a text file: "0,10,20" or angles.txt.
std::vector<double> list_of(const std::string& option, std::string text) {
    const std::string given = text;
    const bool from_file = std::filesystem::is_regular_file(text);
    if (from_file) {
        std::ifstream in(text);
        std::ostringstream all;
        all << in.rdbuf();
        text = all.str();
    }
    for (char& c : text)
        if (c == ',' || c == ';') c = ' ';
    std::vector<double> out;
    std::istringstream words(text);
    for (std::string word; words >> word;) {
        try {
            out.push_back(numbers(option, word, 1)[0]);
        } catch (const UsageError&) {
            throw UsageError(option + " " + given + ": '" + word + "' is no number" + (from_file ? "" : ", and there is no such file"));
        }
    }
    return out;
}

std::vector<int> counts_of(const std::string& option, const std::string& text) {
    std::vector<int> out;
    for (const double v : list_of(option, text)) {
        if (v != std::floor(v) || v < 1 || v > 1e6) throw UsageError(option + " " + text + ": whole numbers of views are expected, like 24,24");
        out.push_back(static_cast<int>(v));
    }
    return out;
}

void read_alignment(Raw& raw) {
    AlignOptions& a = raw.options.align;
    if (!raw.angles.empty() && raw.angles != "equal") a.angles_deg = list_of("--angles", raw.angles);
    if (!raw.rings.empty()) a.rings = counts_of("--rings", raw.rings);
    if (!raw.sittings.empty()) a.sittings = counts_of("--sittings", raw.sittings);
    if (!raw.principal_point.empty()) {
        const auto p = numbers("--principal-point", raw.principal_point, 2);
        a.principal_point_px = Vec2d(p[0], p[1]);
    }
    a.units = raw.options.views.units;
    if (!raw.mat.empty()) a.mat = read_mat(raw.mat);
    if (!raw.paper_views.empty()) {
        const size_t comma = raw.paper_views.find(',');
        if (comma == std::string::npos) throw UsageError("--paper-views " + raw.paper_views + ": two names are expected, like 01,10");
        a.paper_views = {raw.paper_views.substr(0, comma), raw.paper_views.substr(comma + 1)};
    }
    if (!raw.known_length.empty()) {
        const std::string& text = raw.known_length;
        const size_t last = text.rfind(':'), first = last == std::string::npos || last == 0 ? std::string::npos : text.rfind(':', last - 1);
        if (first == std::string::npos || first == 0)
            throw UsageError("--known-length " + text + ": VIEW:X1,Y1,X2,Y2:LENGTH is expected, like 01:100,200,300,200:50");
        const auto p = numbers("--known-length", text.substr(first + 1, last - first - 1), 4);
        a.known_length = KnownLength{text.substr(0, first), {p[0], p[1]}, {p[2], p[3]}, numbers("--known-length", text.substr(last + 1), 1)[0]};
    }
}

void read_raw(Raw& raw) {
    ReconstructOptions& o = raw.options;
    if (!raw.bounds.empty()) {
        const auto b = numbers("--bounds", raw.bounds, 6);
        o.grid.bounds = Box3d();
        o.grid.bounds->min() = Vec3d(b[0], b[1], b[2]);
        o.grid.bounds->max() = Vec3d(b[3], b[4], b[5]);
    }
    if (!raw.grid.empty()) {
        const auto g = numbers("--grid", raw.grid, 3, 'x');
        for (double d : g)
            if (d != std::floor(d) || d < 1 || d > 65536) throw UsageError("--grid " + raw.grid + ": sides must be whole numbers within 1..65536");
        o.grid.dims = {static_cast<int>(g[0]), static_cast<int>(g[1]), static_cast<int>(g[2])};
    }
    if (!raw.origin.empty()) {
        const auto p = numbers("--origin", raw.origin, 3);
        o.grid.origin = Vec3d(p[0], p[1], p[2]);
    }
    if (raw.pass_band > 0) o.smooth.factors.mu = mu_for(o.smooth.factors.lambda, raw.pass_band);
    if (!raw.video_range.empty()) {
        if (std::count(raw.video_range.begin(), raw.video_range.end(), ',') != 1)
            throw UsageError("--video-range " + raw.video_range + ": FROM,TO in seconds is expected, like 2,14.5");
        const auto r = numbers("--video-range", raw.video_range, 2);
        if (!(r[0] >= 0 && r[1] > r[0]))
            throw UsageError("--video-range " + raw.video_range + ": FROM,TO in seconds is expected, the second more than the first");
        o.video.from_s = r[0];
        o.video.to_s = r[1];
    }
    o.views.allow_missing = o.mask.allow_missing;
    read_alignment(raw);
}

/// The effective configuration of one command, as one of the command `to`: everything that has a value, defaults included.
std::string config_of(const CLI::App& program, const std::string& command, const std::string& to) {
    std::istringstream all(program.config_to_str(true, false));
    std::string out, line;
    while (std::getline(all, line)) {
        const size_t equals = line.find('=');
        if (line.rfind(command + ".", 0) != 0 || equals == std::string::npos) continue;
        const std::string value = line.substr(equals + 1);
        // CLI11 spells what was not given as "" or, of a flag, false; reading that back would not parse.
        if (value != "\"\"" && value != "false") out += to + line.substr(command.size()) + "\n";
    }
    return out;
}

}  // namespace

void add_dcc_option(CLI::App& command, Dcc& dcc) {
    add_choice<Dcc>(
        command, "--dcc", dcc, {{"none", Dcc::None}, {"blender", Dcc::Blender}, {"houdini", Dcc::Houdini}, {"maya", Dcc::Maya}},
        "axes, units and colour grid's name for a program, in volumes and meshes alike: blender (z up, m), houdini (y up, m, Cd), maya (y up, cm), none")
        ->group("Result");
}

namespace {

/// An option that says where masks come from, beside another that does.
void imply(MaskOptions& mask, MaskMethod method, const std::string& option) {
    if (mask.method != MaskMethod::Auto && mask.method != method)
        throw UsageError(option + " beside another way to masks (--mask, --clean-plate, --mask-command): only one can count");
    mask.method = method;
}

}  // namespace

void add_scene_options(CLI::App& command, ViewsOptions& views, MaskOptions& mask) {
    CLI::App* app = &command;
    app->add_option("--images", views.images, "folder of photographs")->group("Scene");
    app->add_option("--cameras", views.cameras,
                    "camera file: transforms.json, cameras.json, COLMAP folder, *_par.txt, .pa, .mat or text with 3x4 matrices; experimental: OpenCV's .yml, "
                    ".xml, .json, Metashape's .xml, Bundler's .out, VisualSFM's .nvm, OpenMVG's .json, Meshroom's .sfm, RealityCapture's .csv")
        ->group("Scene");
    app->add_option("--masks", mask.masks, "folder of masks (white = object)")->group("Scene");
    add_choice<MaskMethod>(*app, "--mask", mask.method,
                           {{"auto", MaskMethod::Auto},
                            {"alpha", MaskMethod::Alpha},
                            {"folder", MaskMethod::Folder},
                            {"threshold", MaskMethod::Threshold},
                            {"chroma", MaskMethod::Chroma},
                            {"clean-plate", MaskMethod::CleanPlate},
                            {"grabcut", MaskMethod::GrabCut}},
                           "where masks come from: auto (files, else alpha, else images that are silhouettes), alpha, folder, threshold, chroma (a coloured "
                           "cloth behind), clean-plate (photographs without the object), grabcut (colours, from a box)")
        ->group("Masks");
    app->add_option("--mask-pattern", mask.pattern, "mask files by name, like '{stem}_m.png'")->group("Masks");
    app->add_option("--ignore-masks", mask.ignore_masks, "folder of masks of what neither carves nor confirms")->group("Masks");
    app->add_flag("--mask-invert", mask.invert, "masks are black where the object is")->group("Masks");
    app->add_flag("--allow-missing", mask.allow_missing, "leave out views whose image or mask is missing or empty")->group("Masks");
    app->add_option_function<std::string>(
           "--threshold",
           [&mask](const std::string& text) {
               if (text == "auto") mask.threshold.level = ThresholdOptions::kAuto;
               else if (text == "otsu") mask.threshold.level = ThresholdOptions::kOtsu;
               else mask.threshold.level = numbers("--threshold", text, 1)[0];
               if (mask.threshold.level > 255 || (mask.threshold.level < 0 && text != "auto" && text != "otsu"))
                   throw UsageError("--threshold " + text + ": must be auto, otsu or within 0..255");
           },
           "level 0..255 for --mask threshold; auto: Otsu's of the square root; otsu")
        ->default_str("auto")
        ->group("Masks");
    add_choice<MaskChannel>(*app, "--threshold-channel", mask.threshold.channel,
                            {{"brightness", MaskChannel::Brightness},
                             {"saturation", MaskChannel::Saturation},
                             {"red", MaskChannel::Red},
                             {"green", MaskChannel::Green},
                             {"blue", MaskChannel::Blue}},
                            "brightness (largest of R, G, B), saturation, red, green or blue")
        ->group("Masks");
    app->add_flag("--threshold-invert", mask.threshold.invert, "the object is what is darker")->group("Masks");
    app->add_option_function<std::string>(
           "--chroma-key", [&mask](const std::string& text) { mask.chroma.key_rgb = rgb8_of("--chroma-key", text); },
           "R,G,B (0..255) or #rrggbb of the cloth (default: what the photographs' borders mostly have)")
        ->group("Masks");
    app->add_option("--chroma-level", mask.chroma.level, "object where less than this share of the key is (default: found, 0.3..0.7)")
        ->check(CLI::Range(0.01, 0.99))
        ->group("Masks");
    app->add_option_function<std::string>(
           "--clean-plate",
           [&mask](const std::string& text) {
               mask.plate.plate = text;
               imply(mask, MaskMethod::CleanPlate, "--clean-plate");
           },
           "photograph of the background alone, or a folder with one of each view's name; implies --mask clean-plate")
        ->group("Masks");
    app->add_option("--plate-level", mask.plate.level, "object where the difference is more than so many standard deviations")
        ->capture_default_str()
        ->check(CLI::Range(1.0, 100.0))
        ->group("Masks");
    app->add_flag_function(
           "--plate-keep-shadows", [&mask](int64_t count) { mask.plate.shadows = count <= 0; }, "what is the plate's colour, only darker, counts as object too")
        ->group("Masks");
    app->add_option_function<std::string>(
           "--grabcut-box",
           [&mask](const std::string& text) {
               const auto b = numbers("--grabcut-box", text, 4);
               mask.grabcut.box_px = std::array<int, 4>{static_cast<int>(b[0]), static_cast<int>(b[1]), static_cast<int>(b[2]), static_cast<int>(b[3])};
               if (!(b[2] > b[0] && b[3] > b[1])) throw UsageError("--grabcut-box " + text + ": must be x0,y0,x1,y1 with x1 > x0 and y1 > y0, pixels");
           },
           "x0,y0,x1,y1: pixels that hold the object in every view (default: all but a border)")
        ->group("Masks");
    app->add_flag("--grabcut-from-threshold", mask.grabcut.from_threshold, "start from the mask of --threshold instead of a box")->group("Masks");
    app->add_option_function<std::string>(
           "--mask-command",
           [&mask](const std::string& text) {
               mask.command = text;
               imply(mask, MaskMethod::Command, "--mask-command");
           },
           "'tool {in} {out}': a program that makes the mask of a photograph (a PNG, white or opaque where the object is); run without a shell, its masks are "
           "kept")
        ->group("Masks");
    app->add_option("--mask-command-jobs", mask.command_jobs, "commands at a time")->capture_default_str()->check(CLI::Range(1, 256))->group("Masks");
    app->add_option("--mask-open", mask.clean_up.open_px, "opening of masks made from photographs, px")
        ->capture_default_str()
        ->check(CLI::Range(0, 200))
        ->group("Masks");
    app->add_option("--mask-close", mask.clean_up.close_px, "closing of masks made from photographs, px")
        ->capture_default_str()
        ->check(CLI::Range(0, 200))
        ->group("Masks");
    app->add_option("--mask-fill-holes", mask.clean_up.fill_holes, "fill holes up to this share of the object's area (1: all)")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 1.0))
        ->group("Masks");
    app->add_flag_function(
           "--mask-all-components", [&mask](int64_t count) { mask.clean_up.largest_component = count <= 0; },
           "keep every piece of a mask made from a photograph, not only the largest")
        ->group("Masks");

    add_choice<PixelCentre>(*app, "--pixel-centre", views.pixel_centre, {{"corner", PixelCentre::Corner}, {"integer", PixelCentre::Integer}},
                            "centre of the first pixel: corner (0.5, 0.5) or integer (0, 0); default: the camera format's own")
        ->group("Scene");
    app->add_flag("--accept-non-metric", views.accept_non_metric, "carve in a projective world all the same")->group("Scene");
}

namespace {

void add_alignment(CLI::App& app, Raw& raw) {
    AlignOptions& a = raw.options.align;
    const char* group = "Alignment (without a camera file, or with --method)";
    app.add_option_function<std::string>(
           "--method",
           [&raw](const std::string& text) {
               raw.options.align.method = one_of<AlignMethod>(
                   "--method", text,
                   {{"coherence", AlignMethod::Coherence}, {"refine", AlignMethod::Refine}, {"mat", AlignMethod::Mat}, {"paper", AlignMethod::Paper}});
               raw.options.cameras.find_again = true;
           },
           "how cameras are found: coherence (of silhouettes, from an orbit; default), refine (silhouettes and texture, from the camera file's), mat (markers "
           "under the object, see board), paper (Denkowski 2013, for comparison)")
        ->type_name("WORD")
        ->group(group);
    app.add_option("--mat", raw.mat,
                   "the mat that the object stands on: the .json written beside the print, grid:COLSxROWS:MARKER:GAP:DICT or "
                   "charuco:COLSxROWS:SQUARE:MARKER:DICT (metres)")
        ->group(group);
    app.add_flag_function(
           "--no-features", [&a](int64_t count) { a.features = count <= 0; },
           "leave the photographs' texture alone (it is fitted by refine, and asked for the direction by coherence)")
        ->group(group);
    app.add_option("--paper-views", raw.paper_views, "A,B: names of the views of the front and of a quarter turn on, for --method paper")->group(group);
    add_choice<Orbit>(
        app, "--orbit", a.orbit, {{"auto", Orbit::Auto}, {"turntable", Orbit::Turntable}, {"fixed-camera", Orbit::FixedCamera}, {"hand-held", Orbit::HandHeld}},
        "who moves: turntable (by known steps), fixed-camera (steps uneven), hand-held; auto: the simplest that explains what it was not fitted to")
        ->group(group);
    app.add_option("--angles", raw.angles,
                   "degrees the object has turned at each view: equal (default), a list like 0,20,40 or a file with as many numbers as views")
        ->group(group);
    app.add_option_function<std::string>(
           "--arc",
           [&a](const std::string& text) {
               a.arc_known = text != "auto";
               if (a.arc_known) a.arc_deg = numbers("--arc", text, 1)[0];
           },
           "degrees the object turns over a ring of views: 360 for one whole turn (the last view is one step before the first again), 335 where the walk "
           "stopped short, 720 for two turns; auto: not known")
        ->default_str("360")
        ->group(group);
    add_choice<Turn>(app, "--direction", a.direction, {{"auto", Turn::Auto}, {"cw", Turn::Clockwise}, {"ccw", Turn::Counterclockwise}},
                     "the object's turn from view to view, seen from above: cw, ccw or auto. ccw: what is in front moves to the right in the images\n"
                     "            ccw   .---.          cw   .---.\n"
                     "                 v     |             |     v\n"
                     "                  '-->'               '<--'\n"
                     "                  [cam]               [cam]")
        ->group(group);
    app.add_option("--rings", raw.rings, "views in each ring around the object, in the order of their names, like 24,24")->group(group);
    app.add_option("--sittings", raw.sittings, "views of each sitting (the object laid on another side), likewise")->group(group);
    app.add_option("--fov", a.fov_deg,
                   "horizontal field of view, degrees, to start from (default: what cameras or photographs say, else found); where silhouettes say another, "
                   "that is taken and said")
        ->check(CLI::Range(1.0, 169.0))
        ->group(group);
    app.add_option("--principal-point", raw.principal_point, "x,y in pixels, where it is known (default: found near the middle)")->group(group);
    app.add_flag("--focal-varies", a.focal_varies, "every view has its own focal length, a little different (autofocus)")->group(group);
    app.add_flag("--centre-varies", a.centre_varies, "every view has its own principal point (a stabiliser's crop)")->group(group);
    app.add_option("--known-height", a.known_height, "of the object along the axis, in --units: gives the scale")->check(above_zero())->group(group);
    app.add_option("--known-distance", a.known_distance, "of the cameras from the object's middle, in --units: gives the scale")
        ->check(above_zero())
        ->group(group);
    app.add_option("--known-length", raw.known_length,
                   "VIEW:X1,Y1,X2,Y2:LENGTH: two pixels of a view and how far apart, in --units, the places are that they show: gives the scale")
        ->group(group);
    app.add_option("--restarts", a.restarts, "times to start again from disturbed angles, to see what is left open")
        ->capture_default_str()
        ->check(CLI::Range(0, 20))
        ->group(group);
    app.add_flag("--accept-unobservable", raw.options.cameras.accept_unobservable, "go on with cameras that the silhouettes do not determine")->group(group);
}

/// For the log and, where it is asked for, as JSON.
void say_stage(const std::string& event, bool json) {
    if (json) std::cout << event << std::endl;
    const auto field = [&](const std::string& key) {
        const size_t at = event.find("\"" + key + "\":") + key.size() + 3;
        return event.substr(at, event.find_first_of(",}", at) - at);
    };
    const bool reused = field("reused") == "true";
    spdlog::debug("{:<10} peak memory {:.0f} MB", "", std::stod(field("peak_rss_bytes")) / 1e6);
    spdlog::info("{:<10} {:>8.2f} s{}", field("name").substr(1, field("name").size() - 2), std::stod(field("seconds")), reused ? "  (already there)" : "");
}

void say_result(const Reconstruction& result, const ReconstructOptions& options, bool json) {
    if (json) {
        if (!result.contradiction.empty() && !options.run.dry_run)
            std::cout << nlohmann::json{{"event", "error"}, {"exit_code", static_cast<int>(ExitCode::Contradiction)}, {"text", result.contradiction}}.dump()
                      << std::endl;
        std::string line = result.report_json;
        line.erase(std::remove(line.begin(), line.end(), '\n'), line.end());
        std::cout << line << std::endl;
    } else if (options.run.dry_run) {
        std::cout << result.report_json;
    }
    if (options.run.dry_run) return;
    if (options.run.last_stage == LastStage::Export)
        spdlog::info("mesh: {} vertices, {} faces, {}{}, genus {}, volume {:.6g}; silhouette IoU median {:.4f}, minimum {:.4f}", result.mesh.vertices,
                     result.mesh.faces, result.mesh.manifold ? "closed manifold" : "NOT a closed manifold",
                     result.mesh.components > 1 ? " in " + std::to_string(result.mesh.components) + " pieces" : std::string(), result.mesh.genus,
                     result.mesh.volume, result.median_iou, result.minimum_iou);
    spdlog::info("result in {}", options.run.output.string());
}

/// What watch has besides.
void add_watch_options(CLI::App& app, WatchOptions& w) {
    app.add_option("--first-views", w.first_views, "so many must be here before bounds and voxels are fixed (--bounds, --voxel-size fix them by hand)")
        ->capture_default_str()
        ->check(CLI::Range(1, 65535))
        ->group("Watch");
    app.add_option("--until", w.until_views, "end when the result is of so many views (0: go on)")->capture_default_str()->group("Watch");
    app.add_option("--idle", w.idle_s, "end when nothing has changed for so many seconds (0: go on until Ctrl-C)")
        ->capture_default_str()
        ->check(zero_or_more())
        ->group("Watch");
    app.add_option("--settle", w.settle_s, "a file that did not change for so many seconds is whole")
        ->capture_default_str()
        ->check(zero_or_more())
        ->group("Watch");
}

Command add(CLI::App& program, const char* name, const char* what, LastStage last, const char* example, bool live = false) {
    auto raw = std::make_shared<Raw>();
    ReconstructOptions& o = raw->options;
    o.run.last_stage = last;
    CLI::App* app = program.add_subcommand(name, what);
    app->fallthrough();
    app->add_option("scene", o.views.scene,
                    live ? "folder that photographs arrive in (images/, or directly), with a camera file of all views to come, and masks/ where masks are files"
                         : "folder with images/ (or photos directly in it), masks/ and a camera file; or a film (.mp4, .mov, …)")
        ->required();
    app->add_option("-o,--output", o.run.output, "folder for the result")->required();

    add_scene_options(*app, o.views, o.mask);
    if (last != LastStage::Mask && last != LastStage::Align)
        app->add_flag("--repair-masks", o.mask.repair, "mend masks that contradict all others, by the other views and the photograph")->group("Masks");
    if (!live)
        app->add_option("--video-frames", o.video.frames, "frames to take of a film, evenly in motion, the sharpest near each place")
            ->capture_default_str()
            ->check(CLI::Range(4, 10000))
            ->group("Scene");
    if (!live) app->add_option("--video-range", raw->video_range, "FROM,TO: seconds of the film that are looked at (default: all)")->group("Scene");
    if (last != LastStage::Mask) add_alignment(*app, *raw);
    app->footer(example);
    if (last == LastStage::Align) o.cameras.find_again = true;
    if (last == LastStage::Carve || last == LastStage::Export) {
        app->add_option("--resolution", o.grid.resolution, "voxels along the longest side of the bounds (default: one for a pixel, 64..1024)")
            ->check(above_zero())
            ->group("Grid");
        app->add_option("--voxel-size", o.grid.voxel_size, "edge of a voxel, scene units")->check(above_zero())->group("Grid");
        app->add_option("--grid", raw->grid, "voxels along x, y and z, like 1024x512x1024")->group("Grid");
        app->add_option("--bounds", raw->bounds, "xmin,ymin,zmin,xmax,ymax,zmax: clip to this box (default: found from the silhouettes)")->group("Grid");
        app->add_option("--origin", raw->origin, "x,y,z of the voxel lattice's corner (default 0,0,0)")->group("Grid");
        app->add_option("--max-misses", o.carve.max_misses, "so many views may show background and a voxel stays")
            ->capture_default_str()
            ->check(CLI::Range(0, 15))
            ->group("Carving");
        app->add_option("--min-seen", o.carve.min_seen, "share of the views that must have a point in frame")
            ->capture_default_str()
            ->check(CLI::Range(0.0, 1.0))
            ->group("Carving");
        add_choice<bool>(*app, "--outside", o.carve.outside_is_background, {{"unknown", false}, {"background", true}},
                         "what lies outside an image: unknown (default) or background (the paper)")
            ->group("Carving");
        app->add_option("--silhouette-offset", o.carve.silhouette_offset_px, "grow silhouettes by so many pixels")->capture_default_str()->group("Carving");
        app->add_option_function<std::string>(
               "--field-scale",
               [raw](const std::string& text) {
                   const double value = text == "auto" ? 0 : numbers("--field-scale", text, 1)[0];
                   raw->options.carve.field_scale = static_cast<int>(std::min(value, 1e6));
                   if (text != "auto" && (value < 1 || value > 1e6 || value != std::floor(value)))
                       throw UsageError("--field-scale " + text + ": must be auto or a whole number >= 1");
               },
               "pixels a side of a distance field's sample: auto (at least 2.5 samples to a voxel) or 1, 2, 4 …")
            ->default_str("auto")
            ->group("Carving");
        app->add_flag("--occupancy", o.carve.occupancy, "the paper's binary model: nearest pixel, one bit a voxel")->group("Carving");
        add_choice<Backend>(*app, "--backend", o.run.backend, {{"auto", Backend::Auto}, {"cpu", Backend::Cpu}, {"cuda", Backend::Cuda}},
                            "auto (a GPU where there is one), cpu or cuda; the result is the same")
            ->group("Carving");
        app->add_option("--device", o.run.device, "number of the CUDA device")->capture_default_str()->check(zero_or_more())->group("Carving");
        app->add_option_function<std::string>(
            "--memory-limit", [raw](const std::string& text) { raw->options.run.memory_limit = bytes_of("--memory-limit", text); },
            "resident memory that may be used, like 8G or 500M (default: nine tenths of the machine's)");
        if (!live) app->add_flag("--dry-run", o.run.dry_run, "plan only: views, bounds, grid, memory");
        app->add_option("--add", o.views.added,
                        live ? "SCENE2: its views are taken too, of the same world; once for each scene"
                             : "SCENE2: its views are taken too, of the same world; where OUT holds a result already, its bounds and voxels are kept and its "
                               "hull is extended. Once for each scene that the result is to be of. The scene itself: photographs that came into it")
            ->allow_extra_args(false)
            ->type_name("SCENE2")
            ->group("Scene");
    }
    if (live) add_watch_options(*app, raw->watch);
    if (last == LastStage::Export) {
        add_choice<Mesher>(*app, "--mesher", o.mesh.mesher, {{"dual", Mesher::Dual}, {"marching-cubes", Mesher::MarchingCubes}},
                           "dual (OpenVDB's, default) or marching-cubes")
            ->group("Result");
        app->add_flag("--normals", o.mesh.normals, "vertex normals from the volume's gradient, in mesh.ply (--mesher marching-cubes)")->group("Result");
        app->add_option("--adaptivity", o.mesh.adaptivity, "0: uniform mesh; up to 1: larger faces where flat")
            ->capture_default_str()
            ->check(CLI::Range(0.0, 1.0))
            ->group("Result");
        add_choice<ColorMode>(*app, "--color", o.color.options.mode, {{"none", ColorMode::None}, {"best", ColorMode::Best}, {"blend", ColorMode::Blend}},
                              "blend (default): three views that see the place, weighted; best: the one most in front (the paper); none")
            ->group("Colour");
        add_choice<bool>(
            *app, "--color-source", o.color.from_photos, {{"volume", false}, {"images", true}},
            "vertex colours from the volume (default: mesh and volume agree), or from the images vertex by vertex (sharper where voxels are coarse)")
            ->group("Colour");
        app->add_option("--color-depth", o.color.options.depth_vox, "layers of voxels, from the surface inwards, that get colour")
            ->capture_default_str()
            ->check(CLI::Range(1, 1000))
            ->group("Colour");
        app->add_option_function<std::string>(
               "--exposure",
               [raw](const std::string& text) {
                   raw->options.color.options.exposure = text != "none";
                   raw->options.color.options.exposure_options.per_channel = text == "channels";
               },
               "gain (default): even out the photographs' exposures; channels: their white balance too; none")
            ->check(CLI::IsMember({"gain", "channels", "none"}))
            ->default_str("gain")
            ->group("Colour");
        app->add_option("--color-leave-out", o.color.leave_out, "every N-th view gives no colour, for evaluate --photos to compare with (0: all give)")
            ->capture_default_str()
            ->check(CLI::Range(0, 1000))
            ->group("Colour");
        app->add_option_function<std::vector<std::string>>(
               "--color-grids",
               [raw](const std::vector<std::string>& names) {
                   for (const std::string& n : names) (n == "views" ? raw->options.result.views_grid : raw->options.result.confidence_grid) = true;
               },
               "further grids for volume.vdb: views (how many were blended, 0: made up), confidence")
            ->delimiter(',')
            ->check(CLI::IsMember({"views", "confidence"}))
            ->group("Colour");
        app->add_option("--color-normal-radius", o.color.options.normal_radius_vox,
                        "the paper's normals, from a window of so many voxels (default: the level set's; 3 with --occupancy)")
            ->check(CLI::Range(1, kMaxNormalRadius_vox))
            ->group("Colour");
        add_choice<bool>(*app, "--color-occlusion", o.color.options.test_occlusion, {{"on", true}, {"off", false}},
                         "off: hidden surfaces take the colour of what stands before them, as in the paper")
            ->group("Colour");
        app->add_flag("--paper", o.color.options.skip_upright,
                      "with --color best: faces that look straight up or down (within 2.6 degrees) are left to the fill (the paper's listing 4.2)")
            ->group("Colour");
        add_choice<bool>(*app, "--stereo", o.stereo.on, {{"off", false}, {"on", true}},
                         "on: carve what silhouettes cannot see (concavities) by the photographs' depths, inside the hull; needs texture, and every place seen "
                         "by three photographs 8 to 40 degrees apart. off (default)")
            ->group("Stereo");
        app->add_option("--stereo-scale", o.stereo.options.scale,
                        "photographs are compared at 1/N of their size: 1 finest and slowest; 0: 1 on a GPU, 2 on a CPU")
            ->capture_default_str()
            ->check(CLI::Range(0, 16))
            ->group("Stereo");
        app->add_option("--stereo-depth", o.stereo.options.depth_share, "how deep behind the hull depths are searched, as a share of the object's size")
            ->capture_default_str()
            ->check(CLI::Range(0.01, 1.0))
            ->group("Stereo");
        app->add_flag("--stereo-maps", o.stereo.maps,
                      "OUT/depth gets every view's depths (32-bit float .tiff, along the camera's z, 0: none) and how sure they are (.png)")
            ->group("Stereo");
        app->add_option("--stereo-levels", o.stereo.options.levels, "sizes of photographs that are compared, each half of the one before")
            ->capture_default_str()
            ->check(CLI::Range(1, 4))
            ->group("Stereo");
        app->add_option_function<std::string>(
               "--filter",
               [raw](const std::string& text) {
                   raw->options.filter.steps.reset();
                   if (text != "auto") raw->options.filter.steps = parse_filters(text);
               },
               "NAME[:WIDTH][xITERATIONS],…: median, mean-curvature, laplacian, gaussian, edge-preserving; none; auto: none for soft masks, edge-preserving:2 "
               "for hard ones, :2x4 for --occupancy")
            ->default_str("auto")
            ->group("Filter");
        app->add_flag_function(
               "--no-volume-repair", [raw](int64_t count) { raw->options.filter.repair_volume = count <= 0; }, "leave the volume as the filter leaves it")
            ->group("Filter");
        app->add_option("--keep-thin", o.filter.keep_thin_vox, "parts thinner than so many voxels are not filtered (0: all are)")
            ->capture_default_str()
            ->check(zero_or_more())
            ->group("Filter");
        add_choice<bool>(*app, "--base", o.floor.flat_base, {{"hull", false}, {"flat", true}},
                         "the foot: hull (default; bulges where only slanted views bound it) or flat, cut where the lowest contour was seen (needs an up axis)")
            ->group("Result");
        app->add_option("--cap-tolerance", o.floor.cap_tolerance,
                        "surface farther beyond the highest and lowest contours seen counts as extrapolated, scene units (default: 2 voxels)")
            ->check(zero_or_more())
            ->group("Result");
        app->add_flag("--quads", o.mesh.quads, "keep quads in .ply and .obj (--mesher dual)")->group("Mesh");
        app->add_option("--min-piece", o.mesh.min_piece_share, "pieces with less of the mesh's volume are left out, as a share")
            ->capture_default_str()
            ->check(CLI::Range(0.0, 1.0))
            ->group("Mesh");
        app->add_option_function<std::string>(
               "--smooth",
               [raw](const std::string& text) {
                   raw->options.smooth.iterations.reset();
                   if (text != "auto") raw->options.smooth.iterations = static_cast<int>(numbers("--smooth", text, 1)[0]);
               },
               "iterations of Taubin's smoothing; auto: 0, or 10 with --occupancy --filter none")
            ->default_str("auto")
            ->group("Mesh");
        app->add_option("--smooth-lambda", o.smooth.factors.lambda, "its shrinking factor")->capture_default_str()->check(CLI::Range(0.0, 1.0))->group("Mesh");
        app->add_option("--smooth-mu", o.smooth.factors.mu, "its growing factor, less than the other's negative")
            ->capture_default_str()
            ->check(CLI::Range(-2.0, 0.0))
            ->group("Mesh");
        app->add_option("--smooth-pass-band", raw->pass_band, "the same by the frequency that passes, 1/lambda + 1/mu (0.1; 0: by --smooth-mu)")
            ->check(zero_or_more())
            ->group("Mesh");
        app->add_option("--faces", o.smooth.faces, "decimate to so many faces (0: no)")->check(CLI::Range(0, 2000000000))->group("Mesh");
        app->add_option("--max-error", o.smooth.max_error, "decimate as far as no point moves by more, scene units (0: no)")
            ->check(zero_or_more())
            ->group("Mesh");
        add_dcc_option(*app, o.result.dcc);
        app->add_flag("--vdb-half", o.result.vdb_half, "16-bit floats in volume.vdb: two thirds of the size, three digits")->group("Result");
        app->add_flag("--stl-mm", o.result.stl_mm, "mesh.stl in millimetres, for printers (needs --units, or a scene that says them)")->group("Result");
        app->add_flag_function(
               "--no-report", [&o](int64_t count) { o.result.report = count <= 0; }, "no report.html")
            ->group("Result");
        app->add_option("--mesh-formats", o.result.mesh_formats, "ply,obj,glb,stl")->delimiter(',')->capture_default_str()->group("Result");
    }
    if (last != LastStage::Mask) {
        app->add_option_function<std::string>(
               "--floor",
               [raw](const std::string& text) {
                   raw->options.floor.from = text == "auto" ? FloorOptions::From::Found : FloorOptions::From::Given;
                   try {
                       if (text != "auto") raw->options.floor.height = numbers("--floor", text, 1)[0];
                   } catch (const UsageError&) {
                       throw UsageError("--floor " + text + ": must be auto or a height, a number along the up axis");
                   }
               },
               "height of the table, along up: nothing of the object is lower (reflections are cut off); auto: found in the photographs by the table's "
               "pattern, else the lowest contour (default: the camera file's, of a mat)")
            ->type_name("auto|HEIGHT")
            ->group("Result");
        if (last == LastStage::Export)
            app->add_option("--floor-clear", o.floor.clear,
                            "what a flat patch on the floor makes in the hull is no part of the object (contact shadows); so much higher is allowed for, scene "
                            "units (default: 1 % of the height with --floor; 0: nothing is cleared)")
                ->check(zero_or_more())
                ->group("Result");
    }
    app->add_option("--up", o.views.up, "world up axis: x, y, z, -x, -y, -z")->check(CLI::IsMember({"x", "y", "z", "-x", "-y", "-z"}))->group("Result");
    app->add_option("--units", o.views.units, "length unit of the scene: m, cm, mm, km, inch, ft")->group("Result");
    app->add_flag("--force", o.run.force, "write into a folder that vdbcarve did not make");
    app->add_flag("--resume", raw->resume, "go on where a run stopped (always so: finished stages are never redone)");
    return {app, [raw, app, live, &program](Common& common, Progress& progress) {
                read_raw(*raw);
                ReconstructOptions& options = raw->options;
                const bool json = common.json == "-";
                options.run.on_stage = [&](const std::string& event) { say_stage(event, json); };
                if (live) {
                    // What it makes is a result of reconstruct, which its stages can be done anew from.
                    std::istringstream lines(config_of(program, app->get_name(), "reconstruct"));
                    for (std::string line; std::getline(lines, line);) {
                        const std::string option = line.substr(0, line.find('='));
                        if (option != "reconstruct.first-views" && option != "reconstruct.until" && option != "reconstruct.idle" &&
                            option != "reconstruct.settle" && option != "reconstruct.add")
                            options.run.config_text += line + "\n";
                    }
                    std::string added = "\"" + options.views.scene.string() + "\"";
                    for (const auto& scene : options.views.added) added += ", \"" + scene.string() + "\"";
                    options.run.config_text += "reconstruct.add=[" + added + "]\n";
                    if (!options.mask.allow_missing) options.run.config_text += "reconstruct.allow-missing=true\n";
                    raw->watch.reconstruct = options;
                    raw->watch.on_result = [&](const Reconstruction& result) {
                        say_result(result, options, json);
                        common.report_said = true;
                    };
                    const Reconstruction last = watch(raw->watch, progress);
                    if (!last.contradiction.empty()) throw ContradictionError(last.contradiction);
                    return 0;
                }
                options.run.config_text = config_of(program, app->get_name(), app->get_name());
                const Reconstruction result = reconstruct(options, progress);
                say_result(result, options, json);
                common.report_said = true;
                if (!result.contradiction.empty() && !options.run.dry_run) throw ContradictionError(result.contradiction);
                return 0;
            }};
}

}  // namespace

Command add_reconstruct(CLI::App& program) {
    return add(program, "reconstruct", "everything: views, masks, carving, level set, mesh, files", LastStage::Export,
               "Examples:\n"
               "  vdbcarve reconstruct shoot -o out                                        masks and cameras of the scene\n"
               "  vdbcarve reconstruct photos --mask threshold --known-height 120 --units mm -o out   no cameras: found from the silhouettes\n"
               "  vdbcarve reconstruct photos --cameras aligned/cameras.json -o out        cameras that align found\n"
               "  vdbcarve reconstruct photos --method mat --mat mat.pdf.json -o out       cameras from a mat that board made, in true size\n"
               "  vdbcarve reconstruct shoot --stereo on -o out                            with concavities, of a textured object\n"
               "  vdbcarve reconstruct shoot --units mm --dcc blender -o out               in Blender's axes and metres");
}
Command add_watch(CLI::App& program) {
    return add(program, "watch", "reconstruct while photographs arrive in a folder", LastStage::Export,
               "Examples:\n"
               "  vdbcarve watch shoot -o out                                              shoot has the cameras of all views to come; until Ctrl-C\n"
               "  vdbcarve watch shoot --mask chroma --bounds -100,-100,0,100,100,200 --voxel-size 0.5 -o out   bounds that are known\n"
               "  vdbcarve watch shoot --until 36 -o out                                   ends with the 36th view\n"
               "Masks and the hull are extended by what is new, later stages follow; out/report.html and out/preview.png are of what is there.\n"
               "Takes what reconstruct takes, but for films and --dry-run. Cameras that are to be found are found anew from all photographs each time.",
               true);
}
Command add_align(CLI::App& program) {
    return add(program, "align", "cameras from silhouettes, texture or a marker mat, into OUT/cameras.json", LastStage::Align,
               "Examples:\n"
               "  vdbcarve align photos --mask threshold -o aligned                        an object turned once around, or walked around\n"
               "  vdbcarve align photos --orbit turntable --direction ccw --fov 40 -o aligned   what is known may be said\n"
               "  vdbcarve align photos --cameras colmap --method refine -o aligned        cameras that are nearly right, made better\n"
               "  vdbcarve board -o mat.pdf; vdbcarve align photos --method mat --mat mat.pdf.json -o aligned\n"
               "  vdbcarve reconstruct photos --cameras aligned/cameras.json -o out        goes on from there\n"
               "Of cameras that the scene has already, refine takes everything, mat the lens where it is known, the others focal lengths, principal points and "
               "lenses only.");
}
Command add_mask(CLI::App& program) {
    return add(
        program, "mask", "only the masks, into OUT/masks", LastStage::Mask,
        "Examples:\n"
        "  vdbcarve mask dino --mask threshold --threshold 25 -o masks                          before black\n"
        "  vdbcarve mask toy --mask chroma -o masks                                             before a coloured cloth; --chroma-key where the borders do not "
        "show it\n"
        "  vdbcarve mask toy --clean-plate empty.jpg -o masks                                   a camera that stood still, and a photograph without the "
        "object\n"
        "  vdbcarve mask toy --mask grabcut --grabcut-box 200,50,900,700 -o masks               anything else that differs in colour\n"
        "  vdbcarve mask toy --mask-command 'rembg i {in} {out}' -o masks                       another program's, here one that has learnt what objects are\n"
        "OUT/overlays shows what each mask leaves out (red). A mask in OUT/masks that you mend is used from then on.");
}
Command add_carve(CLI::App& program) {
    return add(program, "carve", "up to the raw hull, into OUT/hull.vdb", LastStage::Carve, "Examples:\n  vdbcarve carve shoot --resolution 512 -o hull");
}

}  // namespace vdbcarve::cli
