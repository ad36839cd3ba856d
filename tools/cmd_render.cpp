// SPDX-License-Identifier: Apache-2.0
#include <spdlog/spdlog.h>

#include <cmath>
#include <memory>

#include "cli.h"
#include "vdbcarve/app/pictures.h"

namespace vdbcarve::cli {

constexpr Word<RenderStyle> kStyleWords[] = {{"surface", RenderStyle::Surface}, {"voxels", RenderStyle::Voxels}, {"xray", RenderStyle::XRay},
                                             {"slices", RenderStyle::Slice},    {"mesh", RenderStyle::Surface},  {"slack", RenderStyle::Surface}};

Command add_render(CLI::App& program) {
    // Reads better whole: one option after the other, in the order in which --help lists them.
    struct Raw {
        PictureRequest request;
        std::string size;
    };
    auto raw = std::make_shared<Raw>();
    PictureRequest& o = raw->request;
    CLI::App* app = program.add_subcommand("render", "a picture, a sheet or a film of a result, a volume or a mesh");
    app->fallthrough();
    app->add_option("in", o.input, "a result's folder, a volume (.vdb, .nvdb) or a mesh (.ply, .obj, .stl, .glb)")->required();
    app->add_option("-o,--output", o.output, "FILE.png; FILE.mp4 or FILE.webm: a film of one turn")->required();
    app->add_option_function<std::string>(
           "--style",
           [raw](const std::string& text) {
               const std::string word = CLI::detail::to_lower(text);
               raw->request.options.style = one_of("--style", word, Words(kStyleWords));
               raw->request.mesh = word == "mesh";
               raw->request.slack = word == "slack";
           },
           "surface (default: the level set under light), voxels (as cubes, nothing interpolated), xray (how thick), slices, mesh (of a result: its mesh), "
           "slack (how much the silhouettes leave open, as colours)")
        ->type_name("WORD");
    const char* where = "From where";
    app->add_option("--azimuth", o.orbit.azimuth_deg, "degrees around the up axis")->capture_default_str()->group(where);
    app->add_option("--elevation", o.orbit.elevation_deg, "degrees above the horizon")->capture_default_str()->check(CLI::Range(-90.0, 90.0))->group(where);
    app->add_option("--fov", o.orbit.fov_deg, "field of view, degrees (0: orthographic)")->capture_default_str()->check(CLI::Range(0.0, 169.0))->group(where);
    app->add_option("--view", o.view, "an input view by name: what its camera would see, pixel for pixel")->group(where);
    app->add_option("--cameras", o.cameras, "camera file for --view and --sheet (default: the result's)")->group(where);
    app->add_option("--images", o.images, "folder of photographs for --sheet (default: where the result says)")->group(where);
    app->add_option("--up", o.up, "world up axis (default: as the result says, else what its cameras stand around, else z)")
        ->check(CLI::IsMember({"x", "y", "z", "-x", "-y", "-z"}))
        ->group(where);
    const char* how = "How";
    app->add_option("--size", raw->size, "WIDTHxHEIGHT in pixels")->default_str("1024x1024")->group(how);
    app->add_option("--samples", o.options.samples, "rays along a pixel's side")->capture_default_str()->check(CLI::Range(1, 16))->group(how);
    app->add_flag_function(
           "--no-color", [raw](int64_t n) { raw->request.options.color = n <= 0; }, "plain clay, also where there are colours")
        ->group(how);
    app->add_option("--ambient", o.options.ambient_rays, "directions that are asked whether something hides the sky (0: no ambient occlusion)")
        ->capture_default_str()
        ->check(CLI::Range(0, 256))
        ->group(how);
    app->add_option_function<std::string>(
           "--background",
           [raw](const std::string& text) {
               auto& b = raw->request.options.background;
               if (text == "none") b.reset();
               else if (text == "white") b = {255, 255, 255};
               else if (text == "black") b = {0, 0, 0};
               else b = rgb8_of("--background", text, "white, black, none");
           },
           "white (default), black, none (transparent), R,G,B or #rrggbb")
        ->type_name("COLOUR")
        ->group(how);
    app->add_option("--iso", o.options.iso, "the surface this far outside (inside where negative), scene units, within the band")
        ->capture_default_str()
        ->group(how);
    add_choice(*app, "--backend", o.backend, Words(kBackendWords), "auto (a GPU where there is one), cpu or cuda; the picture is the same")->group(how);
    app->add_option("--device", o.device, "number of the CUDA device")->capture_default_str()->check(zero_or_more())->group(how);
    const char* several = "Several";
    app->add_option("--sheet", o.sheet, "so many input views beside their photographs, on one sheet")->check(CLI::Range(1, 1000))->group(several);
    app->add_option("--frames", o.frames, "of a film, one turn")->capture_default_str()->group(several);
    app->add_option("--rate", o.rate_hz, "of a film, frames a second")->capture_default_str()->group(several);
    app->add_option("--slices", o.slices, "with --style slices: so many on one sheet; 1: one, at --slice-at")
        ->capture_default_str()
        ->check(CLI::Range(1, 400))
        ->group(several);
    app->add_option("--slice-axis", o.slice_axis, "x, y or z")->capture_default_str()->check(CLI::IsMember({"x", "y", "z"}))->group(several);
    app->add_option("--slice-at", o.slice_at, "with --slices 1: where, as a share of the bounds")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 1.0))
        ->group(several);
    app->footer(
        "Examples:\n"
        "  vdbcarve render out -o picture.png --azimuth 40 --elevation 15           the surface, in its colours\n"
        "  vdbcarve render out -o turn.mp4 --size 720x720                           a film of one turn\n"
        "  vdbcarve render out -o view.png --view 0007 --background none            what an input camera would see\n"
        "  vdbcarve render out -o sheet.png --sheet 12                              photographs and pictures side by side\n"
        "  vdbcarve render out -o voxels.png --style voxels --no-color              the volume as it is\n"
        "  vdbcarve render out -o slices.png --style slices --slice-axis y          sections\n"
        "  vdbcarve render out -o slack.png --style slack                           where silhouettes leave much open");
    return {app, [raw](Common&, Progress& progress) {
                if (!raw->size.empty()) {
                    const auto s = numbers("--size", raw->size, 2, 'x');
                    for (const double side : s)
                        if (side != std::floor(side) || side < 1 || side > 32768)
                            throw UsageError("--size " + raw->size + ": WIDTHxHEIGHT is expected, whole numbers within 1..32768");
                    raw->request.orbit.width_px = static_cast<int>(s[0]);
                    raw->request.orbit.height_px = static_cast<int>(s[1]);
                }
                const PictureSummary s = draw_pictures(raw->request, progress);
                if (raw->request.slack) spdlog::info("slack: grey is none, dark red {:.3g} of the file's units and more", s.most_slack);
                spdlog::info("{}: {} x {} pixels, {:.3f} s on the {}{}{}", raw->request.output.string(), s.width_px, s.height_px,
                             s.seconds / static_cast<double>(s.pictures), s.backend_used,
                             s.device_milliseconds > 0 ? fmt::format(" ({:.2f} ms on the device)", s.device_milliseconds) : std::string(),
                             s.pictures > 1 ? fmt::format(" each, {} of them", s.pictures) : std::string());
                return 0;
            }};
}

}  // namespace vdbcarve::cli
