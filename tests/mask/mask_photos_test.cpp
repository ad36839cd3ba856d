// SPDX-License-Identifier: Apache-2.0
// Masks made from photographs, and masks that contradict each other.
#include "vdbcarve/mask.h"

#include <fstream>
#include <random>

#include "image/image_io.h"
#include "mask/mask_consensus.h"
#include "mask/mask_methods.h"
#include "support/scenes.h"
#include "vdbcarve/synthetic.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;

/// Share of the pixels that object and truth share, of those that either has.
double iou(const Image8& a, const Image8& b) {
    size_t both = 0, either = 0;
    for (size_t i = 0; i < a.data.size(); ++i) {
        const bool x = a.data[i] >= 128, y = b.data[i] >= 128;
        both += x && y, either += x || y;
    }
    return static_cast<double>(both) / static_cast<double>(either);
}

/// How far the contour of a mask lies from the truth's, pixels (rms, and in which direction on average: > 0 outside).
struct Apart {
    double rms = 0, mean = 0;
};
Apart contours_apart(const Image8& made, const Image8& truth) {
    const ImageF a = signed_distance(made), b = signed_distance(truth);
    double sum = 0, squares = 0;
    size_t n = 0;
    for (size_t i = 0; i < a.data.size(); ++i) {
        if (std::fabs(b.data[i]) > 1) continue;
        const double d = std::clamp<double>(b.data[i] - a.data[i], -5, 5);
        sum += d, squares += d * d, ++n;
    }
    return {std::sqrt(squares / static_cast<double>(n)), sum / static_cast<double>(n)};
}

SyntheticSpec before(const char* object, uint64_t seed) {
    SyntheticSpec spec = builtin_spec(object);
    spec.rig.views = 4;
    spec.rig.width_px = 320, spec.rig.height_px = 240;
    spec.look.noise = 2;
    spec.seed = seed;
    return spec;
}

/// The scene on disk, its own masks away.
struct Shoot {
    TemporaryFolder folder;
    Progress progress;
    SyntheticScene scene;
    Views views;
    MaskOptions options;

    explicit Shoot(const SyntheticSpec& spec) : scene(synthesize(spec, progress)) {
        write_scene(scene, folder / "scene");
        fs::rename(folder / "scene/masks", folder / "truth");
        ViewsOptions o;
        o.scene = folder / "scene";
        views = load_views(o, progress);
        for (View& v : views.views) v.mask_path.clear();
    }
    Masks make() { return make_masks(views, folder / "scene", options, {}, progress); }
};

TEST(ChromaMask, FoldsAndSpillAreNotTheObject) {
    for (const Vec3d& cloth : {Vec3d(0.02, 0.3, 0.08), Vec3d(0.03, 0.08, 0.45)}) {
        SyntheticSpec spec = before("ellipsoids", 3);
        spec.look.backdrop = cloth;
        spec.look.spill = 0.3;
        Shoot s(spec);
        s.options.method = MaskMethod::Chroma;
        const Masks made = s.make();
        for (size_t i = 0; i < made.masks.size(); ++i) {
            EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.985) << i;
            const Apart a = contours_apart(made.masks[i].coverage, s.scene.masks[i].coverage);
            EXPECT_LT(a.rms, 0.35) << i;
            EXPECT_LT(std::fabs(a.mean), 0.2) << i;
            EXPECT_NE(made.origins[i].find("chroma key of"), std::string::npos);
        }
    }
}

TEST(ChromaMask, AGivenKeyAndBackdropsWithoutColour) {
    SyntheticSpec spec = before("pair", 3);
    spec.look.backdrop = Vec3d(0.02, 0.3, 0.08);
    Shoot s(spec);
    s.options.method = MaskMethod::Chroma;
    s.options.clean_up.largest_component = false;
    s.options.chroma.key_rgb = std::array<uint8_t, 3>{40, 150, 80};
    const Masks made = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.98) << i;
    s.options.chroma = {};
    s.options.chroma.key_rgb = std::array<uint8_t, 3>{128, 130, 128};
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("nearly grey"), std::string::npos);
}

TEST(PlateMask, LampsMayDrift) {
    SyntheticSpec spec = before("ellipsoids", 5);
    spec.look.plates = true;
    spec.look.light_drift = 0.15;
    spec.look.table = true;  // with a shadow and a reflection
    spec.look.table_reflection = 0;
    Shoot s(spec);
    s.options.method = MaskMethod::CleanPlate;
    s.options.plate.plate = "plates";
    const Masks made = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) {
        EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.97) << i;
        EXPECT_LT(contours_apart(made.masks[i].coverage, s.scene.masks[i].coverage).rms, 0.9) << i;
    }
    // The drift is what would be wrong without being allowed for: a shadow's is larger, and is object when it is kept.
    s.options.plate.shadows = false;
    EXPECT_LT(iou(s.make().masks[0].coverage, s.scene.masks[0].coverage), iou(made.masks[0].coverage, s.scene.masks[0].coverage));
    fs::remove(s.folder / "scene/plates" / "0002.png");
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("0002"), std::string::npos);
    s.options.plate.plate = "nowhere";
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("neither a photograph nor a folder"), std::string::npos);
}

TEST(GrabCutMask, FromABoxAndTheSameTwice) {
    SyntheticSpec spec = before("ellipsoids", 7);
    spec.look.backdrop = Vec3d(0.5, 0.5, 0.55);
    Shoot s(spec);
    s.options.method = MaskMethod::GrabCut;
    const Masks made = s.make(), again = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) {
        EXPECT_GT(iou(made.masks[i].coverage, s.scene.masks[i].coverage), 0.97) << i;
        EXPECT_EQ(made.masks[i].coverage.data, again.masks[i].coverage.data) << i;
    }
    s.options.grabcut.box_px = std::array<int, 4>{0, 0, 320, 240};
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("leaves background around it"), std::string::npos);
}

TEST(MaskCommand, WordsAreSplitAsAShellWould) {
    EXPECT_EQ(words_of_command("tool -a 'two words' \"{in}\" x\\ y={out}"), (std::vector<std::string>{"tool", "-a", "two words", "{in}", "x y={out}"}));
    for (const auto& [text, part] : {std::pair{"tool {in}", "{out}"}, {"tool {in} '{out}", "not closed"}, {"", "{in}"}})
        EXPECT_NE(error_of(ExitCode::Usage, [&] { words_of_command(text); }).find(part), std::string::npos) << text;
}

TEST(MaskCommand, AnotherProgramIsRunOnceForAPhotograph) {
    Shoot s(before("ellipsoids", 9));
    const fs::path tool = s.folder / "a tool.sh";
    const auto write_tool = [&](const std::string& body) {
        std::ofstream(tool) << "#!/bin/sh\n" << body << "\n";
        fs::permissions(tool, fs::perms::owner_all);
    };
    const std::string truth = (s.folder / "truth").string(), log = (s.folder / "log").string();
    write_tool("echo x >> '" + log + "'\ncp '" + truth + "'/$(basename \"$1\") \"$2\"");
    s.options.method = MaskMethod::Command;
    s.options.command = "'" + tool.string() + "' {in} {out}";
    s.options.cache = s.folder / "cache";
    const auto runs = [&] { return read_text(log).size() / 2; };
    const Masks made = s.make();
    for (size_t i = 0; i < made.masks.size(); ++i) EXPECT_EQ(made.masks[i].coverage.data, s.scene.masks[i].coverage.data) << i;
    EXPECT_EQ(runs(), 4u);
    s.make();
    EXPECT_EQ(runs(), 4u);
    fs::copy_file(s.folder / "scene/images/0000.png", s.folder / "scene/images/0001.png", fs::copy_options::overwrite_existing);
    s.make();  // the same content under another name
    EXPECT_EQ(runs(), 4u);
    s.options.command += " --better";
    s.options.command_jobs = 4;
    s.make();
    EXPECT_GE(runs(), 7u);
    for (const auto& [body, part] : {std::pair{"echo out of luck; exit 3", "status 3; it said:\n    out of luck"},
                                     {"exit 0", "wrote no {out}; it said nothing"},
                                     {"kill -9 $$", "signal 9"},
                                     {"head -c 20 \"$1\" > \"$2\"", "a tool.sh: wrote no picture"}}) {
        write_tool(body);
        s.options.cache = s.folder / "elsewhere";
        s.options.command_jobs = 1;
        EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find(part), std::string::npos) << body;
    }
    s.options.command = "no-such-tool {in} {out}";
    EXPECT_NE(error_of(ExitCode::Input, [&] { s.make(); }).find("could not be started"), std::string::npos);
}

/// Three masks that are wrong, each in its way.
std::vector<size_t> break_masks(std::vector<Mask>& masks) {
    Image8& limb = masks[3].coverage;
    for (int y = 0; y < limb.height; ++y)
        for (int x = 0; x < limb.width; ++x)
            if (y < 0.45 * limb.height) limb.at(x, y) = 0;
    for (uint8_t& v : masks[11].coverage.data) v = static_cast<uint8_t>(255 - v);
    Image8& blob = masks[17].coverage;
    for (int y = 0; y < blob.height; ++y)
        for (int x = 0; x < blob.width; ++x)
            if (std::hypot(x - 0.12 * blob.width, y - 0.2 * blob.height) < 20) blob.at(x, y) = 255;
    return {3, 11, 17};
}

TEST(Consensus, ABrokenMaskIsNamedAndACleanOneIsNot) {
    Progress quiet;
    for (const char* object : {"ellipsoids", "cup", "boxes", "torus", "pair"})
        for (const Rig::Kind kind : {Rig::Kind::Orbit, Rig::Kind::Dome}) {
            SyntheticSpec spec = before(object, 11);
            spec.rig.kind = kind;
            spec.rig.views = 24;
            spec.photos = false;
            SyntheticScene scene = synthesize(spec, quiet);
            EXPECT_TRUE(find_broken_masks(scene.views.names(), scene.views.cameras(), views_of(scene.masks), quiet).empty()) << object;
            if (std::string(object) != "ellipsoids") continue;
            const std::vector<size_t> broken = break_masks(scene.masks);
            EXPECT_EQ(find_broken_masks(scene.views.names(), scene.views.cameras(), views_of(scene.masks), quiet), broken);
        }
}

TEST(Consensus, PhotographsMendMasks) {
    Progress quiet;
    SyntheticSpec spec = before("ellipsoids", 11);
    spec.rig.views = 24;
    spec.look.backdrop = Vec3d(0.5, 0.5, 0.55);
    SyntheticScene scene = synthesize(spec, quiet);
    const std::vector<Mask> truth = scene.masks;
    const std::vector<size_t> broken = break_masks(scene.masks);
    std::vector<Mask> without = scene.masks;
    const auto names = scene.views.names();
    const auto cameras = scene.views.cameras();
    EXPECT_NE(repair_masks(
                  names, cameras, scene.masks, broken, [&](size_t i) { return scene.photos[i]; }, quiet)[0]
                  .find("by its photograph"),
              std::string::npos);
    for (const size_t i : broken) EXPECT_GT(iou(scene.masks[i].coverage, truth[i].coverage), 0.97) << i;
    // Without photographs what nobody else bears out is ignored, or away.
    EXPECT_NE(repair_masks(
                  names, cameras, without, broken, [&](size_t) { return Image8(); }, quiet)[0]
                  .find("ignored"),
              std::string::npos);
    for (const size_t i : broken) {
        size_t wrong = 0, object = 0;
        for (size_t p = 0; p < truth[i].coverage.data.size(); ++p) {
            const bool is = truth[i].coverage.data[p] >= 128;
            object += is;
            wrong += (without[i].ignore.empty() || !without[i].ignore.data[p]) && is != (without[i].coverage.data[p] >= 128);
        }
        EXPECT_LT(wrong, 0.12 * static_cast<double>(object)) << i;
    }
}

}  // namespace
}  // namespace vdbcarve::test
