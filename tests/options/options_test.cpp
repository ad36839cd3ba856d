// SPDX-License-Identifier: Apache-2.0
// What options structs say of their members, and the readers of it: cache keys, text, checks, configuration files.
#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "pipeline/option_hash.h"
#include "support/each_option.h"
#include "support/scenes.h"
#include "vdbcarve/config.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

using namespace test;

template <class O>
std::string hash_of(const O& options) {
    Sha256 h;
    return hash_options(h, options).hex();
}

std::string error_of(const std::function<void()>& run) {
    try {
        run();
    } catch (const UsageError& e) {
        return e.what();
    }
    return "";
}

template <class O>
class Struct : public testing::Test {};
using Structs = testing::Types<ViewsOptions, VideoOptions, ThresholdOptions, ChromaOptions, PlateOptions, GrabCutOptions, MaskCleanUp, MaskOptions,
                               AlignOptions, CamerasOptions, GridOptions, CarveSettings, FloorOptions, FairOptions, SurfaceSettings, StereoTrust, StereoOptions,
                               StereoSettings, ExposureOptions, ColorOptions, ColorSettings, FilterSettings, MeshSettings, SmoothOptions, SmoothSettings,
                               ResultOptions, RunOptions, WatchOptions, ReconstructOptions>;
TYPED_TEST_SUITE(Struct, Structs);

template <class T>
inline constexpr bool is_optional = false;
template <class T>
inline constexpr bool is_optional<std::optional<T>> = true;

/// Becomes anything that a member is made from; an optional, which could also be made from its value, only from the other.
struct Anything {
    template <class T>
    requires(!is_optional<T>) operator T() const;
};
struct AnOptional {
    template <class T>
    operator std::optional<T>() const;
    template <class T>  // or it would become the first member of a struct
    requires(std::is_aggregate_v<T>) operator T() const;
};
template <class T, class... A>
constexpr size_t count_members() {
    if constexpr (requires { T{A{}..., AnOptional{}}; }) return count_members<T, A..., AnOptional>();
    else if constexpr (requires { T{A{}..., Anything{}}; }) return count_members<T, A..., Anything>();
    else return sizeof...(A);
}

class Counter : public Visitor<Counter> {
  public:
    size_t count = 0;
    template <class T, class Limits>
    void operator()(const Option&, T&, const Limits&) {
        ++count;
    }
    template <class Form, class... T>
    void joint(const Option&, const Form&, T&...) {
        count += sizeof...(T);
    }
    template <class T>
    void set_by_job(const char*, T&) {
        ++count;
    }
    template <class... T>
    void ignore(T&...) {
        count += sizeof...(T);
    }
    template <class T>
    void part(T&) {
        ++count;
    }
};

// A member that visit() forgets would be a stale result.
TYPED_TEST(Struct, VisitNamesEveryMember) {
    TypeParam options;
    Counter counter;
    visit(options, counter);
    EXPECT_EQ(counter.count, count_members<TypeParam>());
}

// A key changes with every member, but for those that say that they do not change the result.
TEST(Options, KeyChangesWithEveryOptionThatMatters) {
    const auto flips = option_flips<ReconstructOptions>();
    ASSERT_GT(flips.size(), 100U);
    std::set<std::string> seen{hash_of(ReconstructOptions())};
    for (const auto& f : flips) {
        ReconstructOptions options;
        f.change(options);
        const bool is_new = seen.insert(hash_of(options)).second;
        EXPECT_EQ(is_new, f.keyed == Keyed::Yes) << f.name;
    }
}

// What a method of alignment does not heed is refused, so all that can be given must be known as given.
TEST(Options, EveryOptionOfAlignmentIsKnownAsGiven) {
    for (const auto& f : option_flips<AlignOptions>()) {
        if (f.name == "units (set by the job)" || f.name == "align-points" || f.name == "align-seed") continue;
        AlignOptions options;
        f.change(options);
        EXPECT_EQ(given_options(options).size(), 1U) << f.name;
    }
}

TEST(Options, NamesAreTheirOwn) {
    ReconstructOptions options;
    std::set<std::string> names;
    for (const OptionEntry& e : list_options(options)) EXPECT_TRUE(names.insert(e.about.name).second) << e.about.name;
    EXPECT_GT(names.size(), 100U);
}

TEST(Options, DefaultsAreAllowedAndNotGiven) {
    ReconstructOptions options;
    EXPECT_EQ(error_of([&] { check_options(options); }), "");
    EXPECT_TRUE(given_options(options).empty());
    options.carve.max_misses = 2;
    options.smooth.factors.lambda = 0.5;
    EXPECT_EQ(given_options(options), (std::vector<std::string>{"max-misses", "smooth-lambda"}));
}

/// Options of which each is another than by default, as far as they can be said in text.
ReconstructOptions all_other() {
    ReconstructOptions o;
    o.views.scene = "a scene";
    o.views.images = "im\"ages\\";
    o.views.cameras = "cameras\n#2.json";
    o.views.pixel_centre = PixelCentre::Integer;
    o.views.accept_non_metric = true;
    o.views.up = "-y";
    o.views.units = "mm";
    o.views.added = {"one", "two, and three", "vier [4] \xc3\xbc"};
    o.video.frames = 31;
    o.video.from_s = 0.1;
    o.video.to_s = 1.0 / 3;
    o.mask.masks = "masks";
    o.mask.method = MaskMethod::Command;
    o.mask.pattern = "{stem}_m.png";
    o.mask.ignore_masks = "'ignore'";
    o.mask.invert = o.mask.allow_missing = o.mask.repair = true;
    o.mask.threshold = {127.3, MaskChannel::Green, true};
    o.mask.chroma = {std::array<uint8_t, 3>{1, 2, 255}, 0.31};
    o.mask.plate = {"", 3.7, false};
    o.mask.grabcut = {std::array<int, 4>{-1, 2, 300, 400}, true, 7};
    o.mask.command = "tool \"{in}\" {out} #1";
    o.mask.command_jobs = 3;
    o.mask.clean_up = {1, 2, false, 0.1};
    o.align.method = AlignMethod::Refine;
    o.cameras = {true, true};
    o.align.orbit = Orbit::FixedCamera;
    o.align.direction = Turn::Clockwise;
    o.align.angles_deg = {0, 0.1, 1e-9, 1.0 / 3};
    o.align.arc_deg = 1000.0 / 3;
    o.align.rings = {12, 13};
    o.align.sittings = {25};
    o.align.fov_deg = 40.1;
    o.align.principal_point_px = Vec2d(1.0 / 3, 2e5);
    o.align.focal_varies = o.align.centre_varies = true;
    o.align.known_distance = 1.1;
    o.align.known_height = 2.2;
    o.align.known_length = KnownLength{"01:a", {0.1, 0.2}, {0.3, 1e-7}, 1.0 / 7};
    o.align.mat = MatLayout{MatLayout::Kind::Grid, 5, 7, 0.035, 0.04000000000000001, "5X5_100"};
    o.align.features = false;
    o.align.paper_views = {"a,b\\", "c"};
    o.align.points = 99;
    o.align.restarts = 5;
    o.align.seed = 0xffffffffffffffff;
    o.grid.resolution = 77;
    o.grid.voxel_size = 0.1 + 0.2;
    o.grid.dims = {{1, 65536, 3}};
    o.grid.bounds = Box3d(Vec3d(-1.0 / 3, -1e300, -0.0), Vec3d(5e-324, 2, 1e22));
    o.grid.origin = Vec3d(0.1, -0.2, 123456789.123456789);
    o.carve = {-0.75, 4, 2, 0.123456789012345678, true, true, 5};
    o.floor = {FloorOptions::From::Given, -1.0 / 3, 0.25, true, 0.125};
    o.surface.fair = false;
    o.surface.keep_hull = true;
    o.surface.options.fairness = 0.1;
    o.stereo.use = StereoSettings::Use::Auto;
    o.stereo.maps = true;
    o.stereo.options.scale = 3;
    o.stereo.options.pairs = 4;
    o.stereo.options.trust.agreeing = 3;
    o.color.options.mode = ColorMode::Best;
    o.color.options.test_occlusion = false;
    o.color.options.skip_upright = true;
    o.color.options.exposure_options.per_channel = true;
    o.color.options.exposure_options.noise = 0.3;
    o.color.options.exposure_options.spread *= 0.5;
    o.color.options.exposure_options.iterations += 1;
    StereoOptions& s = o.stereo.options;
    for (double* value :
         {&s.least_angle_deg, &s.most_angle_deg, &s.depth_share, &s.truncation_vox, &s.reach_share, &s.coarser_weight, &s.least_weight, &s.least_piece,
          &s.trust.most_cost, &s.trust.least_contrast, &s.trust.least_margin, &s.trust.agreement_px, &s.trust.normal_deg, &s.trust.rim_px})
        *value *= 0.9;
    s.levels = 2;
    s.passes = 5;
    o.color.options.depth_vox = 9;
    o.color.options.normal_radius_vox = 4;
    o.color.from_photos = true;
    o.color.leave_out = 5;
    o.filter.steps = {{FilterKind::Gaussian, 2, 3}, {FilterKind::MeanCurvature, 1, 12}};
    o.filter.repair_volume = false;
    o.filter.keep_thin_vox = 1.5;
    o.mesh = {Mesher::MarchingCubes, true, true, 0.7, 0.02};
    o.smooth.iterations = 0;
    o.smooth.factors.lambda = 0.51;
    o.smooth.factors.mu = -0.57;
    o.smooth.faces = 2000000000;
    o.smooth.max_error = 0.001;
    o.result = {{"stl", "obj"}, Dcc::Houdini, true, true, true, true, false};
    o.run.output = "out # of 3";
    o.run.backend = Backend::Cpu;
    o.run.device = 2;
    o.run.memory_limit = 9007199254740993;
    o.run.force = o.run.dry_run = true;
    apply_implied(o);
    return o;
}

std::vector<std::pair<std::string, std::vector<std::string>>> values_of(ReconstructOptions options) {
    std::vector<std::pair<std::string, std::vector<std::string>>> out;
    for (const OptionEntry& e : list_options(options)) out.emplace_back(e.about.name, e.values());
    return out;
}

TEST(Options, TextReadsBackToTheSameBits) {
    ReconstructOptions options = all_other(), defaults, read;
    const std::vector<OptionEntry> from = list_options(options), other = list_options(defaults), to = list_options(read);
    for (size_t i = 0; i < from.size(); ++i) {
        const std::vector<std::string> values = from[i].values();
        if (!from[i].alias && std::string(from[i].about.name) != "clean-plate") {
            EXPECT_NE(values, other[i].values()) << from[i].about.name << " is as by default";
        }
        if (!values.empty()) to[i].set(values);
        EXPECT_EQ(to[i].values(), values) << from[i].about.name;
    }
    apply_implied(read);
    EXPECT_EQ(hash_of(read), hash_of(options));
}

TEST(Options, EveryHostileStringSurvivesAConfigurationFile) {
    const ReconstructOptions options = all_other();
    const std::string text = config_text(options);
    const ReconstructOptions read = read_config(text, "config.toml");
    EXPECT_EQ(hash_of(read), hash_of(options)) << text;
    EXPECT_EQ(values_of(read), values_of(options));
    EXPECT_EQ(config_text(read), text);
    for (const char* name :
         {"shoot #3", "a\nb", "(",   "'",    "\"",  "\\",    "\\n", "a\tb",   "[a,b]",          "{x}", "trailing ", " leading", "\xe2\x82\xac", "\x01\x7f",
          "\xff\xfe", "123",  "1e5", "true", "a=b", "# all", "'''", "\"\"\"", "C:\\new\\table", "-",   "nan"}) {
        ReconstructOptions o;
        o.views.scene = name;
        o.run.output = name;
        o.views.added = {name, name};
        const ReconstructOptions back = read_config(config_text(o), "config.toml");
        EXPECT_EQ(back.views.scene, o.views.scene);
        EXPECT_EQ(back.run.output, o.run.output);
        EXPECT_EQ(back.views.added, o.views.added);
    }
}

TEST(Options, ConfigurationsOfPartsSayWhatThePartHas) {
    ReconstructOptions o = all_other();
    o.run.last_stage = LastStage::Mask;
    const std::string text = config_text(o);
    EXPECT_NE(text.find("mask.scene=\"a scene\"\n"), std::string::npos);
    EXPECT_EQ(text.find("resolution"), std::string::npos);
    EXPECT_EQ(read_config(text, "config.toml", "mask").run.last_stage, LastStage::Mask);
    EXPECT_TRUE(read_config(text, "config.toml").views.scene.empty());  // not of reconstruct
    o.run.last_stage = LastStage::Carve;
    EXPECT_NE(config_text(o).find("carve.max-misses=2\n"), std::string::npos);
    EXPECT_EQ(config_text(o).find("carve.mesher"), std::string::npos);
}

// As `vdbcarve reconstruct 'my shoot' -o out --resolution 40 --mesh-formats ply,obj --units mm --up z --mat … --add 'my shoot'` of version 0.1 left it.
constexpr const char* kVersion01 = R"(reconstruct.scene="my shoot"
reconstruct.output="out"
reconstruct.mask="threshold"
reconstruct.allow-missing=true
reconstruct.threshold=25
reconstruct.plate-level=2.5
reconstruct.mask-command-jobs=1
reconstruct.mask-open=0
reconstruct.mask-close=3
reconstruct.mask-fill-holes=0.005
reconstruct.video-frames=72
reconstruct.method="mat"
reconstruct.mat="grid:5x7:0.035:0.005:6X6_250"
reconstruct.no-features=true
reconstruct.arc=360
reconstruct.restarts=2
reconstruct.resolution=40
reconstruct.bounds="-1,-1,-1,1,1,1.5"
reconstruct.max-misses=0
reconstruct.min-seen=0.6
reconstruct.silhouette-offset=0
reconstruct.field-scale="auto"
reconstruct.device=0
reconstruct.memory-limit="8G"
reconstruct.add=["my shoot", "other"]
reconstruct.adaptivity=0
reconstruct.color-depth=3
reconstruct.exposure="gain"
reconstruct.color-leave-out=0
reconstruct.color-grids=["views", "confidence"]
reconstruct.stereo-scale=0
reconstruct.stereo-depth=0.35
reconstruct.stereo-levels=3
reconstruct.filter="auto"
reconstruct.keep-thin=4
reconstruct.min-piece=0.001
reconstruct.smooth="auto"
reconstruct.smooth-lambda=0.6307
reconstruct.smooth-mu=-0.6732
reconstruct.mesh-formats=["ply", "obj"]
reconstruct.up='z'
reconstruct.units="mm"
reconstruct.resume=true
)";

TEST(Options, ConfigurationOfVersion01IsRead) {
    const ReconstructOptions o = read_config(kVersion01, "config.toml");
    EXPECT_EQ(o.views.scene, "my shoot");
    EXPECT_EQ(o.mask.method, MaskMethod::Threshold);
    EXPECT_EQ(o.mask.threshold.level, 25);
    EXPECT_EQ(o.mask.clean_up.close_px, 3);
    EXPECT_TRUE(o.mask.allow_missing && o.views.allow_missing);
    EXPECT_EQ(o.align.method, AlignMethod::Mat);
    EXPECT_TRUE(o.cameras.find_again);
    ASSERT_TRUE(o.align.mat.has_value());
    EXPECT_EQ(o.align.mat->columns, 5);
    EXPECT_FALSE(o.align.features);
    EXPECT_EQ(o.grid.resolution, 40);
    ASSERT_TRUE(o.grid.bounds.has_value());
    EXPECT_EQ(o.grid.bounds->max().z(), 1.5);
    EXPECT_EQ(o.carve.field_scale, 0);
    EXPECT_EQ(o.run.memory_limit, size_t{8} << 30);
    EXPECT_EQ(o.views.added, (std::vector<std::filesystem::path>{"my shoot", "other"}));
    EXPECT_TRUE(o.result.views_grid && o.result.confidence_grid);
    EXPECT_FALSE(o.filter.steps || o.smooth.iterations);
    EXPECT_EQ(o.result.mesh_formats, (std::vector<std::string>{"ply", "obj"}));
    EXPECT_EQ(o.views.up, "z");
    EXPECT_EQ(o.align.units, "mm");
}

TEST(Options, TomlThatUsersWrite) {
    const auto lines = parse_config(
        "\xef\xbb\xbf# a comment\r\n"
        "threads = 2 # all of them\n"
        "\n"
        "[reconstruct]\n"
        "  scene = 'C:\\shoot #3'   # literal\n"
        "output=\"a\\tb\\\"\\u20AC\\U0001F600\"\n"
        "mesh-formats = [ \"ply\", # one\n   'glb',\n ]\n"
        "occupancy = true\n"
        "faces = 50_000\n"
        "[ a . \"b c\" ]\n"
        "d.e = -1.5e-3",
        "my.toml");
    ASSERT_EQ(lines.size(), 7U);
    EXPECT_EQ(lines[0].path, (std::vector<std::string>{"threads"}));
    EXPECT_EQ(lines[0].values, (std::vector<std::string>{"2"}));
    EXPECT_EQ(lines[0].line, 2);
    EXPECT_EQ(lines[1].values.front(), "C:\\shoot #3");
    EXPECT_EQ(lines[2].values.front(), "a\tb\"\xe2\x82\xac\xf0\x9f\x98\x80");
    EXPECT_EQ(lines[3].values, (std::vector<std::string>{"ply", "glb"}));
    EXPECT_TRUE(lines[3].is_list);
    EXPECT_EQ(lines[5].values.front(), "50000");
    EXPECT_EQ(lines[6].path, (std::vector<std::string>{"a", "b c", "d", "e"}));
    EXPECT_EQ(lines[6].values.front(), "-1.5e-3");
    EXPECT_TRUE(parse_config("", "").empty());
}

TEST(Options, WhatIsNotReadIsRefusedWithItsLine) {
    for (const auto& [text, said] : std::vector<std::pair<std::string, std::string>>{
             {"scene", "line 1: scene: '=' and a value"},
             {"\n\nscene = shoot", "line 3: scene: 'shoot' must be a number, true, false, a list, or text in quotes"},
             {"scene = \"shoot", "closing \" is missing"},
             {"scene = \"sh\noot\"", "line 1: the text's closing"},
             {"scene = \"\"\"shoot\"\"\"", "several lines"},
             {"scene = \"a\\qb\"", "\\q means nothing"},
             {"scene = \"\\ud800\"", "is not a character's number"},
             {"scene = \"\\u12", "is not a character's number"},
             {"a = {b = 1}", "{…} is not read"},
             {"[[a]]", "[[…]] is not read"},
             {"[a", "']' is missing"},
             {"a = [1, [2]]", "list of lists"},
             {"a = [1 2]", "',' or ']'"},
             {"a = [1,\n2", "']' is missing"},
             {"a = 1\n[b]\nc = 2\n[ ]", "line 4: a name is expected"},
             {"a = 1 b = 2", "behind the value"},
             {"a.b = 1\n[a]\nb = 2", "line 3: a.b is there twice"},
             {"a = inf", "must be a number"},
             {"a = 1979-05-27", "must be a number"},
             {"= 1", "a name is expected"},
             {"a = ", "must be a number"}}) {
        const std::string error = error_of([&] { parse_config(text, "my.toml"); });
        EXPECT_NE(error.find(said), std::string::npos) << text << ": " << error;
        EXPECT_EQ(error.rfind("my.toml, line ", 0), 0U) << error;
    }
    EXPECT_NE(
        error_of([] { read_config("reconstruct.scene='a'\nreconstruct.colour='best'\n", "c.toml"); }).find("c.toml, line 2: unknown option reconstruct.colour"),
        std::string::npos);
    EXPECT_NE(error_of([] { read_config("reconstruct.max-misses=99\n", "c.toml"); }).find("--max-misses is 99, must be 0..15"), std::string::npos);
}

/// A value that is out of a numeric option's range, as text; empty: none is.
std::string outside(const Range& r) {
    if (r.most < 1e300) return number_text(r.most + 1);
    if (r.least > -1e300) return number_text(r.least - 2);
    return "";
}

/// Sets every numeric member to what is out of its range.
class OutOfRange : public Visitor<OutOfRange> {
  public:
    size_t target = 0, at = 0;
    std::string name, text;
    template <class T, class Limits>
    void operator()(const Option& option, T& member, const Limits& limits) {
        if constexpr (std::is_same_v<Limits, Range>) {
            if (at++ != target) return;
            name = option.name;
            text = outside(limits);
            if (std::is_unsigned_v<T> && !text.empty() && text[0] == '-') text.clear();
            if (!text.empty()) member = static_cast<T>(std::stod(text));
        }
    }
    template <class Form, class... T>
    void joint(const Option&, const Form&, T&...) {}
};

// The same range, in the same words, for who types and for who calls.
TEST(Options, RangesAreCheckedForEverybody) {
    size_t checked = 0;
    for (size_t i = 0;; ++i) {
        ReconstructOptions by_caller, by_text;
        OutOfRange out;
        out.target = i;
        visit(by_caller, out);
        if (out.name.empty()) break;
        if (out.text.empty()) continue;
        const std::string said = error_of([&] { check_options(by_caller); });
        const std::string refused = error_of([&] { change_options(by_text, {{out.name, {out.text}}}); });
        EXPECT_EQ(refused.rfind("--" + out.name + " is ", 0), 0U) << refused;
        EXPECT_NE(said.find(refused), std::string::npos) << said << " | " << refused;
        ++checked;
    }
    EXPECT_GT(checked, 40U);
    ReconstructOptions o;
    o.carve.min_seen = std::nan("");
    o.carve.max_misses = -1;
    o.grid.voxel_size = -2;
    o.grid.bounds = Box3d(Vec3d(0, 0, 0), Vec3d(1, 1, 0));
    o.grid.dims = {{0, 1, 1}};
    o.mesh.normals = true;
    o.result.mesh_formats = {"fbx"};
    const std::string all = error_of([&] { check_options(o); });
    for (const char* one : {"--min-seen is nan, must be 0..1", "--max-misses is -1, must be 0..15", "--voxel-size is -2, must be > 0", "--bounds has no volume",
                            "--grid 0x1x1", "--normals are made by", "--mesh-formats fbx: must be one of ply, obj, glb, stl"})
        EXPECT_NE(all.find(one), std::string::npos) << one << " | " << all;
}

TEST(Options, WordsAndNumbersThatAreNone) {
    ReconstructOptions o;
    const auto refused = [&](const char* name, const char* value) { return error_of([&] { change_options(o, {{name, {value}}}); }); };
    EXPECT_EQ(refused("orbit", "circle"), "--orbit circle: must be one of auto, turntable, fixed-camera, hand-held");
    EXPECT_EQ(refused("orbit", "Turntable"), "");
    EXPECT_EQ(refused("threshold", "bright"), "--threshold bright: must be auto, otsu or 0..255");
    EXPECT_EQ(refused("threshold", "otsu"), "");
    EXPECT_EQ(refused("max-misses", "1.5"), "--max-misses is 1.5, must be a whole number");
    EXPECT_EQ(refused("resolution", "0"), "--resolution is 0, must be > 0");
    EXPECT_EQ(refused("floor-clear", "-1"), "--floor-clear is -1, must be >= 0");
    EXPECT_EQ(refused("occupancy", "maybe"), "--occupancy maybe: must be true or false");
    EXPECT_NE(refused("min-seen", "0.5x"), "");
    EXPECT_NE(refused("colour", "best"), "");
    EXPECT_NE(refused("grid", "1x2"), "");
    EXPECT_NE(refused("filter", "median:9"), "");
    EXPECT_EQ(refused("clean-plate", "plate.png"), "");
    EXPECT_EQ(o.mask.method, MaskMethod::CleanPlate);
    EXPECT_NE(refused("mask-command", "tool {in} {out}").find("only one can count"), std::string::npos);
}

TEST(Options, LaterOptionsAreOfEarlierOnes) {
    ReconstructOptions o;
    change_options(o, {{"smooth-pass-band", {"0.1"}}, {"smooth-lambda", {"0.5"}}});
    EXPECT_EQ(o.smooth.factors.mu, mu_for(0.5, 0.1));
}

TEST(Options, RedoNeedsAResult) {
    TemporaryFolder folder;
    Progress quiet;
    const auto nothing = [](ReconstructOptions&) {};
    EXPECT_THROW(redo(folder / "nowhere", nothing, quiet), InputError);
    std::ofstream(folder / "config.toml") << "mask.scene=\"x\"\n";
    EXPECT_THROW(redo(folder / "", nothing, quiet), InputError);
    std::ofstream(folder / "config.toml") << "reconstruct.scene=x\n";
    EXPECT_THROW(redo(folder / "", nothing, quiet), UsageError);
}

}  // namespace
}  // namespace vdbcarve
