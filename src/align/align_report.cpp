// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

#include "vdbcarve/align.h"

namespace vdbcarve {

const char* name_of(Orbit orbit) {
    switch (orbit) {
        case Orbit::Auto:
            return "auto";
        case Orbit::Turntable:
            return "turntable";
        case Orbit::FixedCamera:
            return "fixed-camera";
        case Orbit::HandHeld:
            return "hand-held";
    }
    return "";
}
const char* name_of(Turn turn) { return turn == Turn::Auto ? "auto" : turn == Turn::Clockwise ? "cw" : "ccw"; }
const char* name_of(AlignMethod method) {
    switch (method) {
        case AlignMethod::Coherence:
            return "coherence";
        case AlignMethod::Refine:
            return "refine";
        case AlignMethod::Mat:
            return "mat";
        case AlignMethod::Paper:
            return "paper";
    }
    return "";
}

std::string alignment_json(const AlignResult& r) {
    using nlohmann::json;
    json out{{"method", name_of(r.method)},
             {"orbit", name_of(r.orbit)},
             {"direction", name_of(r.direction)},
             {"residual_rms_px", r.rms_px},
             {"coherent_share", r.coherent},
             {"mask_noise_px", r.mask_noise_px},
             {"focal_px", r.focal_px},
             {"focal_start_px", r.focal_start_px},
             {"focal_spread", r.focal_spread},
             {"principal_point_px", {r.principal_x_px, r.principal_y_px}},
             {"elevation_deg", r.elevation_deg},
             {"other_direction_rms_px", r.other_direction_px},
             {"azimuth_spread_deg", r.azimuth_spread_deg},
             {"angles_observable", r.angles_observable},
             {"symmetry", r.symmetry},
             {"focal_sd_px", r.focal_sd_px},
             {"features", {{"count", r.features}, {"rms_px", r.features_rms_px}, {"near_share", r.features_near}}},
             {"left_out", r.left_out},
             {"picture", r.picture_name},
             {"units", r.views.units.empty() ? "arbitrary" : r.views.units},
             {"verified", r.failures.empty()},
             {"failures", r.failures}};
    for (const AlignRung& g : r.rungs)
        out["rungs"].push_back({{"orbit", name_of(g.orbit)},
                                {"direction", name_of(g.direction)},
                                {"residual_rms_px", g.rms_px},
                                {"held_out_px", g.held_out_px},
                                {"unknowns", g.unknowns}});
    for (const AlignedView& v : r.aligned)
        out["views"].push_back({{"name", v.name},
                                {"residual_before_px", v.residual_before_px},
                                {"residual_px", v.residual_px},
                                {"residual_p95_px", v.residual_p95_px},
                                {"coherent_share", v.coherent},
                                {"dissent_share", v.dissent},
                                {"bad", v.bad},
                                {"azimuth_deg", v.azimuth_deg},
                                {"azimuth_spread_deg", v.azimuth_spread_deg}});
    return out.dump(1);
}

std::string orbit_svg(const AlignResult& r) {
    const std::vector<Camera> cameras = r.views.cameras();
    double reach = 0;
    for (const Camera& c : cameras) reach = std::max(reach, c.centre_world().head<2>().norm());
    if (!(reach > 0)) reach = 1;
    constexpr double kMiddle = 300, kScale = 240;
    const auto x = [&](double world) { return kMiddle + kScale * world / reach; };
    const auto y = [&](double world) { return kMiddle - kScale * world / reach; };
    std::ostringstream s;
    s.precision(5);
    s << "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 600 640\" font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" "
         "fill=\"white\"/>\n";
    s << "<circle cx=\"300\" cy=\"300\" r=\"240\" fill=\"none\" stroke=\"#ddd\"/>\n";
    for (const auto& t : r.touches_world) s << "<circle cx=\"" << x(t[0]) << "\" cy=\"" << y(t[1]) << "\" r=\"0.8\" fill=\"#888\"/>\n";
    double worst = 1e-9;
    for (const AlignedView& v : r.aligned) worst = std::max(worst, v.residual_px);
    for (size_t i = 0; i < cameras.size(); ++i) {
        const Vec3d c = cameras[i].centre_world(), f = cameras[i].forward_world();
        // Green fits, red does not.
        const double share = std::clamp(r.aligned[i].residual_px / std::max(worst, 1.0), 0.0, 1.0);
        s << "<g stroke=\""
          << (r.aligned[i].bad
                  ? "#000"
                  : "rgb(" + std::to_string(static_cast<int>(40 + 200 * share)) + "," + std::to_string(static_cast<int>(150 - 110 * share)) + ",60)")
          << "\"><line x1=\"" << x(c.x()) << "\" y1=\"" << y(c.y()) << "\" x2=\"" << x(c.x() + 0.1 * reach * f.x()) << "\" y2=\""
          << y(c.y() + 0.1 * reach * f.y()) << "\"/><circle cx=\"" << x(c.x()) << "\" cy=\"" << y(c.y()) << "\" r=\"3\"/></g>";
        if (cameras.size() <= 60 || i % (cameras.size() / 30) == 0)
            s << "<text x=\"" << x(1.08 * c.x()) << "\" y=\"" << y(1.08 * c.y()) + 4 << "\" text-anchor=\"middle\">" << i << "</text>";
        s << "\n";
    }
    s << "<text x=\"20\" y=\"620\">From above: cameras by number, the object's outline (grey). Green fits, red strays up to " << worst
      << " px, black contradicts the others.</text>\n</svg>\n";
    return s.str();
}

}  // namespace vdbcarve
