// SPDX-License-Identifier: Apache-2.0
// How well cameras are found from silhouettes: vdbcarve_align_study [--from N] [--seeds N] [--verbose] [CASE…] prints the tables of docs/stages/align.md.
//
// Analytic objects (seven ellipsoids and a plate), 640 x 480, unsteady cameras; every case is a change to one base case, and starts from even angles and,
// unless it says so, an unknown focal length.
#include <chrono>
#include <cstdio>
#include <cstring>
#include <functional>
#include <numbers>
#include <random>

#include "support/align_scene.h"
#include "vdbcarve/align.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/synthetic.h"

namespace vdbcarve {
namespace {

Progress quiet;
constexpr double kRadians = std::numbers::pi / 180;

struct Job {
    SyntheticSpec spec;
    AlignOptions options;
    std::vector<double> turned_deg;  ///< true angles, where they are not the rig's
    bool round = false;
    double focal_given = 0;  ///< the start's focal length / the true one; 0: not given
    int broken = 0;          ///< masks of other objects' parts
};

Job base(uint64_t seed) {
    Job j;
    j.spec = test::hand_held_orbit(seed);
    return j;
}

struct Outcome {
    double azimuth = 0, rotation = 0, rotation_max = 0, reprojection = 0, focal = 0, iou = 0, lost = 0, rms = 0, seconds = 0;
    bool right_direction = true, refused = false, wrong = false;
    int named = 0, named_wrongly = 0;
    std::string orbit;
};

/// Points inside all silhouettes.
bool inside(const std::vector<Camera>& cameras, const std::vector<Mask>& masks, const Vec3d& p) {
    for (size_t i = 0; i < cameras.size(); ++i) {
        const auto u = cameras[i].project(p);
        if (!u) return false;
        const int x = static_cast<int>(std::floor(u->x())), y = static_cast<int>(std::floor(u->y()));
        const Image8& m = masks[i].coverage;
        if (x < 0 || y < 0 || x >= m.width || y >= m.height) continue;
        if (m.at(x, y) < 128) return false;
    }
    return true;
}

Outcome run(const Job& job) {
    SyntheticScene scene = synthesize(job.spec, quiet);
    std::vector<Mask> masks = scene.masks;
    std::mt19937_64 random(job.spec.seed + 77);
    std::vector<size_t> broken;
    for (int b = 0; b < job.broken; ++b) {
        const size_t i = (static_cast<size_t>(b) * 13 + 5) % masks.size();
        broken.push_back(i);
        Image8& m = masks[i].coverage;
        const int blob = b % 3;  // a blob, a hole, half the object missing
        int x0 = m.width, x1 = 0;
        for (int y = 0; y < m.height; ++y)
            for (int x = 0; x < m.width; ++x)
                if (m.at(x, y) >= 128) x0 = std::min(x0, x), x1 = std::max(x1, x);
        const double cx = blob == 0 ? x1 : 0.5 * (x0 + x1), cy = 0.5 * m.height, radius = blob == 0 ? 60 : 25;
        for (int y = 0; y < m.height; ++y)
            for (int x = 0; x < m.width; ++x) {
                if (blob == 2 && x > x0 + 0.75 * (x1 - x0)) m.at(x, y) = 0;
                if (blob != 2 && std::hypot(x - cx, y - cy) < radius) m.at(x, y) = blob == 0 ? 255 : 0;
            }
    }
    const Views given = test::without_cameras(scene.views, job.focal_given);
    std::vector<MaskView> views;
    for (const Mask& m : masks) views.push_back(view_of(m));
    Outcome out;
    const auto start = std::chrono::steady_clock::now();
    const AlignResult r = align(given, views, job.options, quiet);
    out.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    out.orbit = name_of(r.orbit);
    for (const AlignedView& v : r.aligned)
        if (v.bad || v.residual_px > 3 * r.rms_px) quiet.detail(v.name + (v.bad ? " is bad" : "") + ", residual " + std::to_string(v.residual_px) + " px");
    out.rms = r.rms_px;
    const std::vector<Camera> truth = scene.views.cameras();
    const std::vector<Camera> found = r.views.cameras();
    std::vector<Vec3d> points;
    for (size_t v = 0; v < scene.truth.vertices.size(); v += std::max<size_t>(1, scene.truth.vertices.size() / 300))
        points.emplace_back(scene.truth.vertices[v][0], scene.truth.vertices[v][1], scene.truth.vertices[v][2]);
    std::vector<Camera> good_truth, good_found;
    for (size_t i = 0; i < truth.size(); ++i)
        if (std::find(broken.begin(), broken.end(), i) == broken.end()) good_truth.push_back(truth[i]), good_found.push_back(found[i]);
    const CameraErrors e = compare_cameras(good_found, good_truth, points);
    out.rotation = e.rotation_rms_deg;
    out.rotation_max = e.rotation_max_deg;
    out.reprojection = e.reprojection_rms_px;
    out.focal = e.focal_ratio;
    double azimuths = 0, mean = 0;
    std::vector<double> differences;
    for (size_t i = 0; i < good_truth.size(); ++i) {
        const Vec3d a = e.truth_from_estimate * good_found[i].centre_world(), b = good_truth[i].centre_world();
        differences.push_back(std::remainder(std::atan2(a.y(), a.x()) - std::atan2(b.y(), b.x()), 2 * std::numbers::pi) / kRadians);
        mean += differences.back() / static_cast<double>(good_truth.size());
    }
    for (double d : differences) azimuths += (d - mean) * (d - mean) / static_cast<double>(differences.size());
    out.azimuth = std::sqrt(azimuths);
    // Object and hulls, sampled.
    Box3d box;
    for (const auto& v : scene.truth.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
    const Vec3d middle = box.center(), half = 0.65 * box.sizes();
    std::uniform_real_distribution<double> unit(-1, 1);
    size_t both = 0, either = 0, object = 0, lost = 0;
    const Similarity& s = e.truth_from_estimate;
    std::vector<Mask> good_masks;
    for (size_t i = 0; i < masks.size(); ++i)
        if (!r.aligned[i].bad) good_masks.push_back(masks[i]);
    std::vector<Camera> used;
    for (size_t i = 0; i < found.size(); ++i)
        if (!r.aligned[i].bad) used.push_back(found[i]);
    for (int k = 0; k < 150000; ++k) {
        const Vec3d p = middle + half.cwiseProduct(Vec3d(unit(random), unit(random), unit(random)));
        const Vec3d q = s.rotation.transpose() * (p - s.translation) / s.scale;
        const bool a = inside(truth, job.broken ? scene.masks : masks, p), b = inside(used, good_masks, q);
        both += a && b;
        either += a || b;
        bool solid = false;
        for (const Solid& x : job.spec.solids) solid |= x.value(p) <= 0;
        object += solid;
        lost += solid && a && !b;
    }
    out.iou = either ? static_cast<double>(both) / static_cast<double>(either) : 0;
    out.lost = object ? static_cast<double>(lost) / static_cast<double>(object) : 0;
    out.refused = !r.failures.empty();
    for (const std::string& f : r.failures) std::fprintf(stderr, "  seed %d: %s\n", static_cast<int>(job.spec.seed), f.c_str());
    out.right_direction = r.direction == Turn::Clockwise || job.round;  // the rig walks counterclockwise
    out.wrong = out.iou < 0.95;
    for (size_t i = 0; i < r.aligned.size(); ++i)
        if (r.aligned[i].bad) (std::find(broken.begin(), broken.end(), i) != broken.end() ? out.named : out.named_wrongly)++;
    return out;
}

struct Case {
    std::string name;
    std::function<void(Job&)> change;
};

std::vector<Case> cases() {
    std::vector<Case> out;
    const auto add = [&](const char* name, std::function<void(Job&)> change) { out.push_back({name, std::move(change)}); };
    add("36 views", [](Job&) {});
    add("24 views", [](Job& j) { j.spec.rig.views = 24; });
    add("16 views", [](Job& j) { j.spec.rig.views = 16; });
    add("focal length given x0.7", [](Job& j) { j.focal_given = 0.7; });
    add("focal length given x1.6", [](Job& j) { j.focal_given = 1.6; });
    add("elevation 15", [](Job& j) { j.spec.rig.elevation_deg = 15; });
    add("elevation 35", [](Job& j) { j.spec.rig.elevation_deg = 35; });
    add("arc of 335, said to be 360", [](Job& j) { j.spec.rig.arc_deg = 335; });
    add("angles +-12", [](Job& j) { j.spec.rig.shake_angle_deg = 12; });
    add("field of view 12, 24 views", [](Job& j) { j.spec.rig.fov_deg = 9.15, j.spec.rig.shake_look_at = 0.006, j.spec.rig.views = 24; });
    add("radius and height +-1 %", [](Job& j) { j.spec.rig.shake_position = 0.01; });
    add("radius and height +-2 %, elevation 20, 24 views",
        [](Job& j) { j.spec.rig.shake_position = 0.02, j.spec.rig.elevation_deg = 20, j.spec.rig.views = 24; });
    add("mask noise 0.5 px", [](Job& j) { j.spec.rig.shake_position = 0.01, j.spec.damage.noise_px = 0.5, j.spec.damage.correlation_px = 4; });
    add("mask noise 1.5 px", [](Job& j) { j.spec.rig.shake_position = 0.01, j.spec.damage.noise_px = 1.5, j.spec.damage.correlation_px = 4; });
    add("masks dilated 1 px", [](Job& j) { j.spec.damage.dilate_px = 1; });
    add("3 of 36 masks broken", [](Job& j) { j.broken = 3; });
    add("turntable", [](Job& j) { j.spec.rig.shake_angle_deg = j.spec.rig.shake_look_at = j.spec.rig.shake_roll_deg = 0, j.spec.rig.elevation_deg = 15; });
    add("hand-turned table +-5", [](Job& j) { j.spec.rig.shake_look_at = j.spec.rig.shake_roll_deg = 0, j.spec.rig.elevation_deg = 15; });
    add("round object", [](Job& j) {
        j.spec.solids = test::round_object();
        j.spec.rig.shake_angle_deg = 0;
        j.round = true;
    });
    add("speed changes, 20 degrees", [](Job& j) { j.spec.rig.speed_variation = 0.35; });
    add("speed changes, 40 degrees", [](Job& j) { j.spec.rig.speed_variation = 0.7; });
    add("speed changes, 50 degrees", [](Job& j) { j.spec.rig.speed_variation = 0.88; });
    for (const double arc : {200.0, 270.0, 430.0, 500.0})
        add(arc == 200   ? "arc 200 unknown"
            : arc == 270 ? "arc 270 unknown"
            : arc == 430 ? "arc 430 unknown"
                         : "arc 500 unknown",
            [arc](Job& j) { j.spec.rig.arc_deg = arc, j.options.arc_known = false; });
    add("arc 270, said to be 360", [](Job& j) { j.spec.rig.arc_deg = 270; });
    add("breathing 1.5 %", [](Job& j) { j.spec.rig.breathing = 0.015; });
    add("breathing 1.5 %, --focal-varies", [](Job& j) { j.spec.rig.breathing = 0.015, j.options.focal_varies = true; });
    add("crop drifts by 8 px", [](Job& j) { j.spec.rig.crop_drift_px = 8; });
    add("crop drifts by 8 px, --centre-varies", [](Job& j) { j.spec.rig.crop_drift_px = 8, j.options.centre_varies = true; });
    add("two rings", [](Job& j) {
        j.spec.rig.kind = Rig::Kind::Rings;
        j.spec.rig.rings = {{18, 5}, {18, 35}};
        j.options.rings = {18, 18};
    });
    add("two sittings", [](Job& j) {
        j.spec.rig.sittings = 2;
        j.spec.rig.views = 48;
        j.spec.rig.arc_deg = 720;  // once around in each
        j.spec.rig.elevation_deg = 15;
        j.options.sittings = {24, 24};
    });
    add("field of view 5", [](Job& j) { j.spec.rig.fov_deg = 3.8, j.spec.rig.shake_look_at = 0.0025; });
    add("field of view 30", [](Job& j) { j.spec.rig.fov_deg = 23, j.spec.rig.shake_look_at = 0.015; });
    return out;
}

}  // namespace
}  // namespace vdbcarve

int main(int argc, char** argv) {
    using namespace vdbcarve;
    int first = 1, seeds = 5;
    std::vector<std::string> wanted;
    for (int a = 1; a < argc; ++a) {
        if (!std::strcmp(argv[a], "--seeds") && a + 1 < argc) seeds = std::atoi(argv[++a]);
        else if (!std::strcmp(argv[a], "--from") && a + 1 < argc) first = std::atoi(argv[++a]);
        else if (!std::strcmp(argv[a], "--verbose")) quiet.on_detail = [](const std::string& text) { std::fprintf(stderr, "    %s\n", text.c_str()); };
        else wanted.push_back(argv[a]);
    }
    std::printf(
        "| case (medians of %d; worst) | rung | azimuth rms deg | reprojection px | f/true | hull IoU | lost %% | residual px | right/refused/WRONG | s "
        "|\n|---|---|---|---|---|---|---|---|---|---|\n",
        seeds);
    for (const Case& c : cases()) {
        if (!wanted.empty() && std::none_of(wanted.begin(), wanted.end(), [&](const std::string& w) { return c.name.find(w) != std::string::npos; })) continue;
        std::vector<Outcome> all;
        for (int s = first; s <= seeds; ++s) {
            Job j = base(static_cast<uint64_t>(s));
            c.change(j);
            try {
                all.push_back(run(j));
            } catch (const std::exception& e) {
                std::printf("%s seed %d: %s\n", c.name.c_str(), s, e.what());
            }
        }
        const auto of = [&](double Outcome::*what, bool largest) {
            std::vector<double> v;
            for (const Outcome& o : all) v.push_back(o.*what);
            std::sort(v.begin(), v.end());
            return std::pair{v[v.size() / 2], largest ? v.back() : v.front()};
        };
        const auto azimuth = of(&Outcome::azimuth, true), reprojection = of(&Outcome::reprojection, true), iou = of(&Outcome::iou, false),
                   lost = of(&Outcome::lost, true), rms = of(&Outcome::rms, true), focal = of(&Outcome::focal, true), focal2 = of(&Outcome::focal, false),
                   seconds = of(&Outcome::seconds, true);
        int right = 0, refused = 0, wrong = 0, named = 0, named_wrongly = 0;
        std::string rungs;
        for (const Outcome& o : all) {
            if (o.refused) ++refused;
            else if (o.wrong || !o.right_direction) ++wrong;
            else ++right;
            named += o.named, named_wrongly += o.named_wrongly;
            rungs += o.orbit[0];
        }
        std::printf("| %s | %s | %.3f; %.3f | %.3f; %.3f | %.4f; %.3f-%.3f | %.4f; %.4f | %.2f; %.2f | %.3f; %.3f | %d/%d/%d%s | %.1f |\n", c.name.c_str(),
                    rungs.c_str(), azimuth.first, azimuth.second, reprojection.first, reprojection.second, focal.first, focal2.second, focal.second, iou.first,
                    iou.second, 100 * lost.first, 100 * lost.second, rms.first, rms.second, right, refused, wrong,
                    named + named_wrongly ? (" named " + std::to_string(named) + ", wrongly " + std::to_string(named_wrongly)).c_str() : "", seconds.first);
        std::fflush(stdout);
    }
    return 0;
}
