// SPDX-License-Identifier: Apache-2.0
#include "align/align_options.h"

#include <algorithm>
#include <cmath>

#include "base/text.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

constexpr AlignMethod kMethods[] = {AlignMethod::Coherence, AlignMethod::Refine, AlignMethod::Mat, AlignMethod::Paper};
enum : unsigned { kCoherence = 1, kRefine = 2, kMat = 4, kPaper = 8 };  ///< in that order

struct Option {
    const char* name;
    bool given;
    unsigned heeded_by;
};

std::vector<Option> options_of(const AlignOptions& o) {
    const AlignOptions meant;
    return {{"--method", o.method != meant.method, kCoherence | kRefine | kMat | kPaper},
            {"--mat", o.mat.has_value(), kMat},
            {"--orbit", o.orbit != meant.orbit, kCoherence},
            {"--direction", o.direction != meant.direction, kCoherence | kPaper},
            {"--angles", !o.angles_deg.empty(), kCoherence | kPaper},
            {"--arc", o.arc_known && o.arc_deg != meant.arc_deg, kCoherence | kPaper},
            {"--arc auto", !o.arc_known, kCoherence},
            {"--rings", !o.rings.empty(), kCoherence},
            {"--sittings", !o.sittings.empty(), kCoherence},
            {"--fov", o.fov_deg != meant.fov_deg, kCoherence | kRefine | kMat},
            {"--principal-point", o.principal_point_px.has_value(), kCoherence | kRefine | kMat | kPaper},
            {"--focal-varies", o.focal_varies, kCoherence | kRefine},
            {"--centre-varies", o.centre_varies, kCoherence | kRefine},
            {"--known-distance", o.known_distance != 0, kCoherence | kRefine | kPaper},
            {"--known-height", o.known_height != 0, kCoherence | kRefine | kPaper},
            {"--known-length", o.known_length.has_value(), kCoherence | kRefine | kPaper},
            {"--no-features", !o.features, kCoherence | kRefine},
            {"--paper-views", !o.paper_views[0].empty() || !o.paper_views[1].empty(), kPaper},
            {"--restarts", o.restarts != meant.restarts, kCoherence | kRefine}};
}

std::string names_of_methods(unsigned which) {
    std::string out;
    for (unsigned m = 0; m < std::size(kMethods); ++m)
        if (which & (1U << m)) out += (out.empty() ? "" : " or ") + std::string(name_of(kMethods[m]));
    return out;
}

}  // namespace

std::vector<std::string> given_options(const AlignOptions& o) {
    std::vector<std::string> out;
    for (const Option& x : options_of(o))
        if (x.given) out.push_back(x.name);
    return out;
}

void check_align_options(const AlignOptions& o, const Views& scene, size_t masks) {
    const size_t views = scene.views.size();
    std::string wrong;
    const auto need = [&](bool ok, const std::string& what) {
        if (!ok) wrong += (wrong.empty() ? "" : "; ") + what;
    };
    need(masks == views || o.method == AlignMethod::Mat, "align: as many masks as views are needed");
    const auto method = static_cast<unsigned>(std::find(std::begin(kMethods), std::end(kMethods), o.method) - std::begin(kMethods));
    for (const Option& x : options_of(o))
        need(!x.given || (x.heeded_by & (1U << method)),
             text_of("%s is of --method %s, not of %s%s", x.name, names_of_methods(x.heeded_by).c_str(), name_of(o.method),
                     o.method == AlignMethod::Mat && std::string(x.name).find("--known") == 0 ? " (the mat gives the scale)" : ""));
    need(o.method != AlignMethod::Mat || o.mat, "--method mat: which mat? Remedy: --mat FILE, the layout that was written beside the print");
    need(o.angles_deg.empty() || o.angles_deg.size() == views,
         "--angles: " + counted(o.angles_deg.size(), "angle") + " for " + counted(views, "view") + ". Remedy: one for each view, or none");
    for (const auto& [name, counts] : {std::pair{"--rings", &o.rings}, {"--sittings", &o.sittings}}) {
        int sum = 0;
        for (int c : *counts) {
            need(c >= 4, std::string(name) + ": " + counted(static_cast<size_t>(c), "view") + " together, at least 4 are needed");
            sum += c;
        }
        need(counts->empty() || static_cast<size_t>(sum) == views, std::string(name) + ": " + counted(static_cast<size_t>(sum), "view") + ", the scene has " +
                                                                       std::to_string(views) + ". Remedy: numbers that add up to it");
    }
    need(o.angles_deg.empty() || (o.arc_known && o.arc_deg == AlignOptions().arc_deg),
         "--angles say how far the object turned: --arc would say it again. Remedy: one of them");
    need(o.arc_deg >= 20 && o.arc_deg <= 3600, text_of("--arc: %g degrees, must be 20..3600", o.arc_deg));
    need(o.fov_deg == 0 || (o.fov_deg >= 1 && o.fov_deg <= 169), text_of("--fov: %g degrees, must be within 1..169", o.fov_deg));
    if (o.principal_point_px && views > 0) {
        const Intrinsics& k = scene.views.front().camera.intrinsics;
        const auto near = [](double x, int size) { return size == 0 || std::fabs(x - 0.5 * size) <= size; };  // a crop may leave it outside
        need(near(o.principal_point_px->x(), k.width_px) && near(o.principal_point_px->y(), k.height_px),
             text_of("--principal-point %g,%g: far outside of the images, which have %d x %d pixels; their middle is %g,%g", o.principal_point_px->x(),
                     o.principal_point_px->y(), k.width_px, k.height_px, 0.5 * k.width_px, 0.5 * k.height_px));
    }
    need(o.points >= 10 && o.points <= 5000, text_of("align: %d contour points a view, must be 10..5000", o.points));
    need(o.restarts >= 0 && o.restarts <= 20, text_of("--restarts: %d, must be 0..20", o.restarts));
    const int lengths = (o.known_distance != 0) + (o.known_height != 0) + o.known_length.has_value();
    need(o.known_distance >= 0 && o.known_height >= 0 && lengths <= 1 &&
             (!o.known_length || (o.known_length->length > 0 && o.known_length->from_px.allFinite() && o.known_length->to_px.allFinite())),
         "give one of --known-distance, --known-height and --known-length, > 0");
    if (!wrong.empty()) throw UsageError(wrong);
}

}  // namespace vdbcarve
