// SPDX-License-Identifier: Apache-2.0
// Views that are added to a result.

#include "support/job.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/export.h"

namespace vdbcarve::test {
namespace {

// Views added one by one, in several orders, with and without allowed misses and frames that cut the object: the hull, and all that follows from it, are those
// of carving all of them at once.
TEST(Pipeline, AddedViewsGiveWhatAllAtOnceGive) {
    for (const int variant : {0, 1, 2}) {
        Arrivals a(variant == 2);
        a.options.carve.max_misses = variant == 1;
        const std::vector<size_t> order = variant == 0 ? std::vector<size_t>{4, 7, 1, 8, 0, 6, 2, 5, 3} : std::vector<size_t>{0, 3, 6, 1, 4, 7, 2, 5, 8};
        ReconstructOptions adding = a.options;
        json last;
        for (size_t n = 0; n < order.size(); ++n) {
            a.arrive(order[n]);
            if (n < 3) continue;
            if (n > 3) adding.views.added = {a.options.views.scene};
            last = a.run(adding);
            if (n == 5) last = a.run(adding);  // nothing new: nothing happens
            EXPECT_TRUE(n != 5 || Job::reused(last, "carve"));
            EXPECT_TRUE(n == 5 || !Job::reused(last, "carve"));
        }
        ASSERT_EQ(last["views"].size(), order.size());
        const json whole = a.run(a.batch(last));
        EXPECT_EQ(whole["grid"]["dims"], last["grid"]["dims"]);
        EXPECT_EQ(a.hull(a.folder / "batch"), a.hull(a.folder / "out")) << "variant " << variant;
        for (const char* file : {"volume.vdb", "mesh.ply", "preview.png", "cameras.json"})
            EXPECT_EQ(a.bytes(std::string("batch/") + file), a.bytes(std::string("out/") + file)) << file << " of variant " << variant;
    }
}

TEST(Pipeline, AddingSaysWhatItCannotKeep) {
    Arrivals a;
    for (size_t n = 0; n < 6; ++n) a.arrive(n);
    a.run(a.options);
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    Progress quiet;
    o.grid.resolution = 57;
    EXPECT_THROW(reconstruct(o, quiet), UsageError);
    o.grid.resolution = 56;
    o.grid.bounds = Box3d(Vec3d(-1, -1, -1), Vec3d(1, 1, 1));
    EXPECT_THROW(reconstruct(o, quiet), UsageError);
    o.grid.bounds.reset();
    // A view that moved makes its old bounds worthless, which is said, and carved anew.
    json cameras = json::parse(read_text(a.folder / "scene/transforms.json"));
    for (json& f : cameras["frames"]) f["transform_matrix"][0][3] = f["transform_matrix"][0][3].get<double>() + 0.01;
    write_text(a.folder / "scene/transforms.json", cameras.dump());
    std::string said;
    quiet.on_warning = [&](const std::string& text) { said += text + "\n"; };
    reconstruct(o, quiet);
    EXPECT_NE(said.find("its cameras are others"), std::string::npos) << said;
}

// A second folder of photographs in the same world: its masks are looked for in it, its views are taken too.
TEST(Pipeline, ASecondSceneIsAdded) {
    Arrivals a;
    const auto move_to = [&](const std::string& scene, const std::vector<size_t>& views, const std::string& prefix) {
        json cameras = json::parse(read_text(a.folder / "all/transforms.json")), part = cameras;
        part["frames"] = json::array();
        fs::create_directories(a.folder / (scene + "/images"));
        fs::create_directories(a.folder / (scene + "/masks"));
        for (const size_t n : views) {
            const std::string stem = fs::path(a.names[n]).stem().string();
            for (json f : cameras["frames"])
                if (fs::path(f["file_path"].get<std::string>()).filename() == a.names[n]) {
                    f["file_path"] = "images/" + prefix + a.names[n];
                    part["frames"].push_back(f);
                }
            fs::copy_file(a.folder / ("all/images/" + a.names[n]), a.folder / (scene + "/images/" + prefix + a.names[n]));
            fs::copy_file(a.folder / ("all/masks/" + stem + ".png"), a.folder / (scene + "/masks/" + prefix + stem + ".png"));
        }
        write_text(a.folder / (scene + "/transforms.json"), part.dump());
    };
    move_to("first", {0, 2, 4, 6, 8}, "");
    move_to("second", {1, 3, 5, 7}, "b");
    move_to("clash", {1, 2}, "");
    a.options.views.scene = a.folder / "first";
    const json before = a.run(a.options);
    ReconstructOptions o = a.options;
    o.views.added = {a.folder / "second"};
    const json both = a.run(o);
    EXPECT_EQ(both["views"].size(), 9u);
    EXPECT_EQ(both["grid"]["bounds"], before["grid"]["bounds"]);
    for (const json& v : both["views"]) EXPECT_GT(v["silhouette_iou"], 0.97) << v;
    // The page finds the photographs of both.
    Progress quiet;
    const Views found = result_views(a.folder / "out", {}, quiet);
    for (const View& v : found.views) EXPECT_FALSE(v.image_path.empty()) << v.name;
    o.views.added = {a.folder / "first"};
    EXPECT_THROW(reconstruct(o, quiet), UsageError);  // the second's views would be lost
    o.views.added = {a.folder / "clash"};
    EXPECT_THROW(reconstruct(o, quiet), InputError);  // two photographs called alike
    fs::remove(a.folder / "second/transforms.json");
    o.views.added = {a.folder / "second"};
    EXPECT_THROW(reconstruct(o, quiet), InputError);  // nobody says where they were taken
}

// Two photographs, and their masks, with the same bytes are two views all the same.
TEST(Pipeline, ViewsThatAreAlikeAreAdded) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4}) a.arrive(n);
    for (const char* part : {"images/", "masks/"}) {
        const auto name = [&](size_t n) {
            return a.folder / (std::string("scene/") + part + (part[0] == 'i' ? a.names[n] : fs::path(a.names[n]).stem().string() + ".png"));
        };
        fs::copy_file(name(0), name(8), fs::copy_options::overwrite_existing);
    }
    a.options.color.options.mode = ColorMode::None;
    a.options.carve.max_misses = 1;
    a.run(a.options);
    a.arrive(5);
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    Progress quiet;
    EXPECT_EQ(reconstruct(o, quiet).views, 7u);
}

// What was asked for in other words is not made again: the hull of the first run is the one that is kept, and its config.toml repeats it elsewhere.
TEST(Pipeline, AddingNothingRedoesNothing) {
    for (const bool by_grid : {false, true}) {
        Arrivals a;
        for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
        if (by_grid) {
            a.options.grid.resolution = 0;
            a.options.grid.dims = {56, 48, 40};
        }
        const json first = a.run(a.options);
        ReconstructOptions o = a.options;
        o.views.added = {a.options.views.scene};
        const json second = a.run(o);
        for (const char* stage : {"mask", "carve", "level_set", "color", "mesh"}) EXPECT_TRUE(Job::reused(second, stage)) << stage;
        EXPECT_EQ(first["grid"]["bounds"], second["grid"]["bounds"]);
        EXPECT_EQ(first["grid"]["bounds_automatic"], second["grid"]["bounds_automatic"]);
        a.arrive(6);
        const json third = a.run(o);
        EXPECT_EQ(first["grid"]["bounds"], third["grid"]["bounds"]);
        const std::string config = a.bytes("out/config.toml");
        EXPECT_EQ(config.find("resolution"), std::string::npos);
        EXPECT_NE(config.find("reconstruct.voxel-size="), std::string::npos);
        EXPECT_NE(config.find("reconstruct.bounds=\""), std::string::npos);
        a.run(a.batch(third));
        EXPECT_EQ(a.hull(a.folder / "batch"), a.hull(a.folder / "out"));
    }
}

// Fields of all views together exceed the limit: then views are not added but all are carved, in batches; the same result.
TEST(Pipeline, AddingWithinAMemoryLimit) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
    a.run(a.options);
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    o.run.memory_limit = 1;  // less than the process holds: batches of the least size
    o.run.last_stage = LastStage::Carve;
    a.arrive(6);
    json limited;
    ASSERT_NO_THROW(limited = a.run(o));
    o.run.memory_limit = 0;
    o.run.last_stage = LastStage::Export;
    const json third = a.run(o);
    EXPECT_EQ(limited["grid"]["bounds"], third["grid"]["bounds"]);
    EXPECT_EQ(limited["grid"]["active_voxels"], third["grid"]["active_voxels"]);
}

// Views of another scene that are not named again would be lost silently.
TEST(Pipeline, ViewsThatAreGoneAreNamed) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
    a.run(a.options);
    fs::remove(a.folder / ("scene/images/" + a.names[2]));
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    const json r = a.run(o);
    bool said = false;
    for (const std::string w : r["warnings"])
        said |= w.find(fs::path(a.names[2]).stem().string()) != std::string::npos && w.find("which is not here") != std::string::npos;
    EXPECT_TRUE(said) << r["warnings"];
}

}  // namespace
}  // namespace vdbcarve::test
