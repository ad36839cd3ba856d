// SPDX-License-Identifier: Apache-2.0
// Stereo with other settings than the usual ones, against the truth: what docs/stages/stereo.md's tables are made with.
//
//   vdbcarve_stereo_study SCENE N [--cpu] [--meshes PREFIX] [--synth name=value,…] [--pose-noise PX] [name=value,name=value …]
//
// SCENE is a packed scene with photographs (tests/device/pack_scene.cpp), which may hold truth.ply; or what `vdbcarve synth` takes, a built-in object or a
// closed mesh, photographed here as --synth says (rings of 36 views of 1024 x 768 else), whose distances are in percent of its longest side. N is the voxels
// along the longest side of its bounds. --pose-noise turns every camera about its centre, so that pictures move by that much (standard deviation, along either
// axis). A row for the hull and one for each list of settings ("usual": none changed).
#include <openvdb/openvdb.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <random>
#include <sstream>

#include "support/packed_scene.h"
#include "vdbcarve/device.h"
#include "vdbcarve/carve.h"
#include "vdbcarve/distance.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/filter.h"
#include "vdbcarve/level_set.h"
#include "vdbcarve/mesh.h"
#include "vdbcarve/stereo.h"
#include "vdbcarve/synthetic.h"

namespace {

using namespace vdbcarve;

int median = 0;  ///< passes afterwards

using Setters = std::map<std::string, std::function<void(const std::string&)>>;

void set_all(const std::string& list, const Setters& names) {
    std::istringstream words(list);
    for (std::string word; list != "usual" && std::getline(words, word, ',');) {
        const size_t equals = word.find('=');
        if (equals == std::string::npos || !names.count(word.substr(0, equals))) throw UsageError(word + ": is no setting");
        names.at(word.substr(0, equals))(word.substr(equals + 1));
    }
}

StereoOptions settings(const std::string& list) {
    StereoOptions o;
    median = 0;
    const auto number = [](auto& to) { return [&to](const std::string& v) { to = static_cast<std::remove_reference_t<decltype(to)>>(std::atof(v.c_str())); }; };
    set_all(list, {{"pairs", number(o.pairs)},
                   {"scale", number(o.scale)},
                   {"levels", number(o.levels)},
                   {"coarser", number(o.coarser_weight)},
                   {"passes", number(o.passes)},
                   {"least_angle", number(o.least_angle_deg)},
                   {"most_angle", number(o.most_angle_deg)},
                   {"depth", number(o.depth_share)},
                   {"cost", number(o.trust.most_cost)},
                   {"contrast", number(o.trust.least_contrast)},
                   {"margin", number(o.trust.least_margin)},
                   {"agreeing", number(o.trust.agreeing)},
                   {"agreement", number(o.trust.agreement_px)},
                   {"normal", number(o.trust.normal_deg)},
                   {"rim", number(o.trust.rim_px)},
                   {"reach", number(o.reach_share)},
                   {"median", number(median)},
                   {"truncation", number(o.truncation_vox)},
                   {"weight", number(o.least_weight)}});
    return o;
}

/// A shoot of a built-in object or a mesh, and its truth.
test::PackedScene photographed(const std::string& object, const std::string& list, Mesh& truth, Progress& progress) {
    SyntheticSpec spec;
    if (std::filesystem::is_regular_file(object)) spec.mesh = read_mesh(object);
    else spec = builtin_spec(object);
    spec.rig.kind = Rig::Kind::Rings;
    int views = 36;
    double low = 0, high = 35;  ///< elevations of the rings, degrees
    spec.rig.width_px = 1024;
    spec.rig.height_px = 768;
    const auto number = [](auto& to) { return [&to](const std::string& v) { to = static_cast<std::remove_reference_t<decltype(to)>>(std::atof(v.c_str())); }; };
    set_all(list, {{"views", number(views)},
                   {"width", number(spec.rig.width_px)},
                   {"height", number(spec.rig.height_px)},
                   {"gloss", number(spec.look.gloss)},
                   {"noise", number(spec.look.noise)},
                   {"flat", number(spec.look.flat)},
                   {"low", number(low)},
                   {"high", number(high)},
                   {"pattern", [&](const std::string& v) { spec.pattern = pattern_called(v); }},
                   {"motion", [&](const std::string& v) { spec.rig.motion = v == "turntable" ? Rig::Motion::Turntable : Rig::Motion::Camera; }},
                   {"rig", [&](const std::string& v) { spec.rig.kind = v == "dome"    ? Rig::Kind::Dome
                                                                       : v == "orbit" ? Rig::Kind::Orbit
                                                                                      : Rig::Kind::Rings; }}});
    spec.rig.views = views;
    spec.rig.rings = {{(views + 1) / 2, low}, {views / 2, high}};
    SyntheticScene scene = synthesize(spec, progress);
    test::PackedScene out;
    for (const View& v : scene.views.views) {
        out.names.push_back(v.name);
        out.cameras.push_back(v.camera);
    }
    out.masks = std::move(scene.masks);
    for (Image8& photo : scene.photos) out.photos.push_back(Photo{std::move(photo)});
    truth = std::move(scene.truth);
    out.bounds = automatic_bounds(out.inputs(), out.mask_views(), 0, {}, progress);
    return out;
}

void shake(std::vector<Camera>& cameras, double pixels) {
    std::mt19937 dice(7);
    std::normal_distribution<double> off(0, pixels);
    for (Camera& c : cameras) {
        const Vec3d turn(off(dice) / c.intrinsics.fy, off(dice) / c.intrinsics.fx, 0);
        const Rigid3 small{Eigen::AngleAxisd(turn.norm(), turn.norm() > 0 ? Vec3d(turn.normalized()) : Vec3d::UnitX()).toRotationMatrix(), Vec3d::Zero()};
        c.camera_from_world = small * c.camera_from_world;
    }
}

void print_row(const std::string& name, const Mesh& mesh, const Mesh& truth, bool percent, Progress& progress) {
    std::printf("%-40s", name.c_str());
    if (!truth.triangles.empty()) {
        EvaluateOptions o;
        const Evaluation e = evaluate(mesh, truth, o, progress);
        Box3d box;
        for (const auto& v : truth.vertices) box.extend(Vec3d(v[0], v[1], v[2]));
        const double unit = percent ? 100 / box.sizes().maxCoeff() : 1;
        std::printf(" excess %6.2f %% lost %5.2f %% IoU %.4f | accuracy %.3f p90 %.3f p95 %.3f | completeness %.3f, %.1f %% | chamfer %.4f | normals %.1f",
                    100 * e.volume_excess, 100 * e.truth_lost, e.iou, unit * e.to_truth.mean, unit * e.to_truth.p90, unit * e.to_truth.p95,
                    unit * e.from_truth.mean, 100 * e.from_truth.within, 0.5 * unit * (e.to_truth.mean + e.from_truth.mean), e.normal_error_mean_deg);
    }
    std::printf("\n");
    std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 3)
        return std::fprintf(
                   stderr,
                   "usage: vdbcarve_stereo_study SCENE N [--cpu] [--meshes PREFIX] [--synth name=value,...] [--pose-noise PX] [name=value,name=value ...]\n"),
               2;
    openvdb::initialize();
    try {
        const std::filesystem::path folder = argv[1];
        const int resolution = std::atoi(argv[2]);
        bool cpu = false;
        std::string meshes, synth = "usual";
        double pose_noise_px = 0;
        std::vector<std::string> lists;
        for (int a = 3; a < argc; ++a) {
            const std::string word = argv[a];
            if (word == "--cpu") cpu = true;
            else if (word == "--meshes" && a + 1 < argc) meshes = argv[++a];
            else if (word == "--synth" && a + 1 < argc) synth = argv[++a];
            else if (word == "--pose-noise" && a + 1 < argc) pose_noise_px = std::atof(argv[++a]);
            else lists.push_back(word);
        }
        if (lists.empty()) lists = {"usual"};
        Progress progress;
        const bool packed = std::filesystem::is_directory(folder);
        Mesh truth;
        test::PackedScene scene = packed ? test::read_packed_scene(folder) : photographed(folder, synth, truth, progress);
        if (packed && std::filesystem::exists(folder / "truth.ply")) truth = read_mesh(folder / "truth.ply");
        shake(scene.cameras, pose_noise_px);
        std::printf("%s %d %s pose noise %g px\n", folder.filename().c_str(), resolution, synth.c_str(), pose_noise_px);
        CarveOptions c;
        c.bounds_world = scene.bounds;
        c.lattice.voxel_size = scene.bounds.sizes().maxCoeff() / resolution;
        const FieldPlan plan = plan_fields(scene.cameras, c);
        DistanceOptions d;
        d.scale = plan.scale;
        d.reach_samples = plan.reach_samples;
        const std::vector<DistanceField> fields = distance_fields(scene.mask_views(), d, progress);
        std::vector<CarveInput> inputs = scene.inputs();
        for (size_t v = 0; v < inputs.size(); ++v) inputs[v].field = &fields[v];
        const openvdb::FloatGrid::Ptr surface = level_set(carve(inputs, c, progress).hull, {}, progress);
        print_row("hull", extract_mesh(*surface, {}, progress), truth, !packed, progress);
        std::optional<Device> device;
        if (choose_backend(cpu ? Backend::Cpu : Backend::Auto, 0) == Backend::Cuda) device.emplace();
        for (const std::string& list : lists) {
            StereoOptions o = settings(list);
            const auto start = std::chrono::steady_clock::now();
            const StereoResult r =
                device ? stereo(*device, *surface, scene.color_inputs(), {}, o, progress) : stereo(*surface, scene.color_inputs(), {}, o, progress);
            const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
            openvdb::FloatGrid::Ptr result = r.surface;
            if (median) {
                FilterOptions filters;
                filters.steps = parse_filters("median:1x" + std::to_string(median));
                filters.repair_volume = false;
                result = filter(result, filters, progress).surface;
            }
            const Mesh mesh = extract_mesh(*result, {}, progress);
            std::printf("%zu pieces ", component_volumes(*result).size());
            print_row(list, mesh, truth, !packed, progress);
            size_t object = 0, matched = 0, trusted = 0;
            for (const StereoViewStatistics& v : r.views) object += v.object_pixels, matched += v.matched_pixels, trusted += v.trusted_pixels;
            std::printf("    %s, scale %d: %zu pixels, %.1f %% matched, %.1f %% trusted; %.3f s:", r.backend_used.c_str(), r.scale, object,
                        100.0 * static_cast<double>(matched) / static_cast<double>(object), 100.0 * static_cast<double>(trusted) / static_cast<double>(object),
                        seconds);
            for (const auto& [name, ms] : r.milliseconds) std::printf(" %s %.0f", name.c_str(), ms);
            std::printf(" ms\n");
            if (!meshes.empty()) write_mesh(meshes + list + ".ply", mesh);
        }
    } catch (const Error& e) {
        return std::fprintf(stderr, "error: %s\n", e.what()), static_cast<int>(e.code());
    }
    return 0;
}
