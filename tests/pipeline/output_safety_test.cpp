// SPDX-License-Identifier: Apache-2.0
// No command replaces what it reads, whatever names and folders it is given.
#include "base/output_names.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <set>

#include "base/sha256.h"
#include "image/image_io.h"
#include "support/scenes.h"
#include "vdbcarve/evaluate.h"
#include "vdbcarve/export_cameras.h"
#include "vdbcarve/pipeline.h"
#include "vdbcarve/result.h"
#include "vdbcarve/app/watch.h"

namespace vdbcarve::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

/// Every file below a folder with its SHA-256.
std::map<std::string, std::string> hashes_of(const fs::path& folder, const fs::path& without = {}) {
    std::map<std::string, std::string> out;
    for (auto it = fs::recursive_directory_iterator(folder); it != fs::recursive_directory_iterator(); ++it) {
        if (!without.empty() && it->path() == without) it.disable_recursion_pending();
        else if (it->is_regular_file()) out[it->path().lexically_relative(folder).string()] = sha256_of_file(it->path());
    }
    return out;
}

/// A shoot of 8 views; the photographs can be given other places and names. Each view's mask is of its own.
struct Scene {
    TemporaryFolder folder;
    fs::path scene = folder / "scene";
    ReconstructOptions options;

    explicit Scene(bool photos = true) {
        SyntheticSpec spec = small_spec("ellipsoids", 8, 80, 60);
        spec.photos = photos;
        Progress quiet;
        write_scene(synthesize(spec, quiet), scene);
        options.views.scene = scene;
        options.run.output = folder / "out";
        options.grid.resolution = 24;
        options.result.mesh_formats = {"ply"};
        options.result.report = false;
    }

    /// Photograph i moves to `places[i]` (from the test's folder), and the camera file calls it `names[i]`.
    void rename(const std::vector<std::string>& places, const std::vector<std::string>& names) {
        json cameras = json::parse(read_text(scene / "transforms.json"));
        for (size_t i = 0; i < names.size(); ++i) {
            json& file = cameras["frames"][i]["file_path"];
            const fs::path from = scene / file.get<std::string>(), to = folder / places[i];
            fs::create_directories(to.parent_path());
            fs::rename(from, to);
            fs::rename(scene / "masks" / from.filename(), scene / "masks" / (std::to_string(i) + "_moved.png"));
            file = names[i];
            cameras["frames"][i]["mask_path"] = "masks/" + std::to_string(i) + "_moved.png";
        }
        write_text(scene / "transforms.json", cameras.dump(1));
        fs::remove(scene / "transforms_nominal.json");
    }

    Views views() const {
        Progress quiet;
        return load_views(options.views, quiet);
    }
    json run() {
        Progress quiet;
        return json::parse(reconstruct(options, quiet).report_json);
    }
    /// Refused, whatever --force says, and nothing that was there has changed or is gone.
    std::string refused() {
        std::string message;
        for (const bool force : {false, true}) {
            auto before = hashes_of(folder.path());
            std::erase_if(before, [](const auto& file) { return contains(file.first, "stages/failure."); });
            options.run.force = force;
            message = error_of(ExitCode::Output, [&] { run(); });
            auto after = hashes_of(folder.path());
            std::erase_if(after, [](const auto& file) { return contains(file.first, "stages/failure."); });  // what a failed run leaves in a result of ours
            EXPECT_EQ(after, before) << message;
        }
        options.run.force = false;
        return message;
    }
};

Image8 mask_of(const Scene& s, const View& view) {
    return io::read_image8(view.mask_path.empty() ? s.scene / "masks" / view.image_path.filename() : view.mask_path);
}

TEST(OutputSafety, NamesThatAreSafeAndUniqueStay) {
    const std::vector<std::string> safe{"0001.png",       "ring1/0001.jpg", "ring2/0001.jpg", "ring2/deeper/0001.jpg",
                                        "with space.png", "Übung.png",      ".hidden",        "a.b.c"};
    EXPECT_EQ(output_names(safe, Folders::Kept), safe);
    const std::vector<std::string> joined{"0001.png", "ring1_0001.jpg"};
    EXPECT_EQ(output_names(joined, Folders::Joined), joined);
}

TEST(OutputSafety, NamesThatLeaveTheFolderOrClashAreChanged) {
    using Names = std::vector<std::string>;
    EXPECT_EQ(output_names({"/etc/passwd", "../../x.png", "a/../../x.png", "", "..", "/", "./y.png"}, Folders::Kept),
              (Names{"etc/passwd", "x.png", "a/x.png", "view", "view_2", "view_3", "y.png"}));
    EXPECT_EQ(output_names({"..\\..\\x.png", std::string("a\0b.png", 7), "a\nb.png"}, Folders::Kept), (Names{".._.._x.png", "a_b.png", "a_b_2.png"}));
    EXPECT_EQ(output_names({"x.png", "x.png", "X.png", "x_2.png"}, Folders::Kept), (Names{"x_3.png", "x_4.png", "X.png", "x_2.png"}));
    EXPECT_EQ(output_names({"Ring/x.png", "ring/X.PNG"}, Folders::Kept), (Names{"Ring/x.png", "ring/X_2.PNG"}));
    // A name that needs no change is not given to another one.
    EXPECT_EQ(output_names({"l/x.png", "l_x.png"}, Folders::Joined), (Names{"l_x_2.png", "l_x.png"}));
    // No name is another one's folder.
    EXPECT_EQ(output_names({"a", "a/b", "A/c"}, Folders::Kept), (Names{"a_2", "a/b", "A/c"}));
}

TEST(OutputSafety, RandomNamesStayInsideAndApart) {
    std::mt19937 random(7);
    const std::vector<std::string> parts{"..", ".", "", "a", "A", "b", "_", "a_2", "\\", std::string(1, '\0'), "x.png", "X.png", "\x7f"};
    for (const Folders folders : {Folders::Kept, Folders::Joined})
        for (int round = 0; round < 200; ++round) {
            std::vector<std::string> wanted;
            for (int n = 0; n < 30; ++n) {
                std::string name = random() % 5 ? "" : "/";
                for (size_t k = random() % 4; k-- > 0;) name += parts[random() % parts.size()] + (random() % 2 ? "/" : "");
                wanted.push_back(name);
            }
            std::set<std::string> keys, inner;
            const std::vector<std::string> names = output_names(wanted, folders);
            for (const std::string& name : names) {
                const fs::path path(name);
                ASSERT_TRUE(path.is_relative() && !name.empty() && !contains(name, "\\") && name.find('\0') == std::string::npos) << name;
                for (const fs::path& part : path) ASSERT_TRUE(!part.empty() && part != "." && part != "..") << name;
                ASSERT_TRUE(folders == Folders::Kept || !contains(name, "/")) << name;
                std::string key = name;
                for (char& c : key) c = static_cast<char>(std::tolower(c));
                ASSERT_TRUE(keys.insert(key).second) << name;
                for (fs::path at = fs::path(key).parent_path(); !at.empty(); at = at.parent_path()) inner.insert(at.string());
            }
            for (const std::string& key : keys) ASSERT_FALSE(inner.count(key)) << key;
        }
}

// Photographs of several folders share their name; the camera file names them by absolute paths, or by paths that leave its folder.
TEST(OutputSafety, UndistortedPhotographsStayInTheirFolder) {
    for (const bool absolute : {true, false}) {
        Scene s;
        std::vector<std::string> places, names;
        for (int i = 0; i < 8; ++i) {
            places.push_back("photos/ring" + std::to_string(i) + "/x.png");
            names.push_back(absolute ? (s.folder / places.back()).string() : "../" + places.back());
        }
        s.rename(places, names);
        const auto before = hashes_of(s.folder.path());
        Progress quiet;
        CameraExportOptions o;
        o.undistort = true;
        for (const char* target : {"a/colmap", "b/transforms.json"}) {
            const fs::path to = s.folder / target, root = s.folder / std::string(target).substr(0, 1);
            const fs::path set = to.extension().empty() ? to : to.parent_path();
            export_cameras(s.views(), to, o, quiet);
            for (int i = 0; i < 8; ++i) EXPECT_TRUE(fs::exists(set / ("images/ring" + std::to_string(i) + "/x.png"))) << set << i;
            export_cameras(s.views(), to, o, quiet);  // again, over what it wrote itself
            for (const auto& [file, hash] : hashes_of(root)) EXPECT_EQ((root / file).string().rfind(set.string(), 0), 0u) << file;
            fs::remove_all(root);
            EXPECT_EQ(hashes_of(s.folder.path()), before);
        }
    }
}

TEST(OutputSafety, ExportIntoTheSceneIsRefused) {
    Scene s;
    s.run();
    Progress quiet;
    CameraExportOptions plain, undistort;
    undistort.undistort = true;
    const Views views = s.views(), result = result_views(s.folder / "out", {}, quiet);
    const auto refused = [&](const Views& v, const fs::path& target, const CameraExportOptions& o) {
        const auto before = hashes_of(s.folder.path());
        const std::string message = error_of(ExitCode::Output, [&] { export_cameras(v, target, o, quiet); });
        EXPECT_EQ(hashes_of(s.folder.path()), before) << message;
        return message;
    };
    for (const Views& v : {views, result}) {
        EXPECT_TRUE(contains(refused(v, s.scene, undistort), "scene/images"));
        EXPECT_TRUE(contains(refused(v, s.scene, plain), "scene"));
        refused(v, s.scene / "images", undistort);
        refused(v, s.scene / "transforms.json", undistort);
        refused(v, s.scene / "nerf.json", undistort);
    }
    EXPECT_TRUE(contains(refused(views, s.scene / "transforms.json", plain), "transforms.json"));
    EXPECT_TRUE(contains(refused(result, s.folder / "out/cameras.json", plain), "cameras.json"));
    undistort.masks = s.folder / "out/masks";
    EXPECT_TRUE(contains(refused(result, s.folder / "out/transforms.json", undistort), "out/masks"));
    // By another way to the same folder.
    fs::create_directory_symlink(s.scene, s.folder / "link");
    refused(views, s.folder / "link", undistort);
    fs::create_directory(s.folder / "set");
    fs::create_directory_symlink(s.scene / "images", s.folder / "set/images");
    refused(views, s.folder / "set/transforms.json", undistort);
    // A model of another program, from copies of these photographs.
    fs::create_directories(s.folder / "theirs/sparse/0");
    write_text(s.folder / "theirs/sparse/0/cameras.txt", "# Camera list with one line of data per camera:\n");
    EXPECT_TRUE(contains(refused(result, s.folder / "theirs", undistort), "did not write"));
    // Cameras beside the photographs, and into a folder of its own, are what export is for.
    export_cameras(result, s.scene / "nerf.json", plain, quiet);
    export_cameras(result, s.folder / "out/colmap", undistort, quiet);
    EXPECT_TRUE(fs::exists(s.folder / "out/colmap/masks/0003.png.png"));
}

TEST(OutputSafety, ViewsNeverShareAMaskFile) {
    Scene s;
    s.rename({"scene/l/x.png", "scene/r/x.png", "scene/l_x.png", "scene/a.png", "scene/A.png", "scene/b.png", "scene/c.png", "scene/d.png"},
             {"l/x.png", "r/x.png", "l_x.png", "a.png", "A.png", "b.png", "c.png", "d.png"});
    const Views views = s.views();
    const std::vector<std::string> names = mask_names(views);
    ASSERT_EQ(names.size(), 8u);
    for (size_t i = 0; i < 8; ++i)
        EXPECT_TRUE((views.views[i].name != "l_x.png" && views.views[i].name != "b.png") || names[i] == views.views[i].name + ".png") << names[i];
    s.run();
    for (size_t i = 0; i < 8; ++i) {
        const fs::path mask = s.folder / "out/masks" / names[i];
        ASSERT_TRUE(fs::exists(mask)) << names[i];
        EXPECT_EQ(io::read_image8(mask).data, mask_of(s, views.views[i]).data) << views.views[i].name;
    }
    // What other commands make of them.
    Progress quiet;
    CameraExportOptions o;
    o.undistort = true;
    o.masks = s.folder / "out/masks";
    const Views result = result_views(s.folder / "out", {}, quiet);
    export_cameras(result, s.folder / "set/transforms.json", o, quiet);
    const json set = json::parse(read_text(s.folder / "set/transforms.json"));
    std::set<std::string> pictures;
    for (size_t i = 0; i < 8; ++i) {
        const json& frame = set["frames"][i];
        pictures.insert(frame["file_path"].get<std::string>());
        ASSERT_TRUE(frame.contains("mask_path")) << frame;
        EXPECT_EQ(io::read_image8(s.folder / "set" / frame["mask_path"].get<std::string>()).data, mask_of(s, views.views[i]).data);
        EXPECT_EQ(io::read_image8(s.folder / "set" / frame["file_path"].get<std::string>()).data, io::read_image8(views.views[i].image_path).data);
    }
    EXPECT_EQ(pictures.size(), 8u);
    compare_photos(read_mesh(s.folder / "out/mesh.ply"), views, {s.folder / "out", false, s.folder / "pairs"}, quiet);
    EXPECT_EQ(hashes_of(s.folder / "pairs").size(), 8u);
    // An edited mask belongs to one view.
    Image8 edited = io::read_image8(s.folder / "out/masks" / names[0]);
    std::fill_n(edited.data.begin(), edited.data.size() / 2, uint8_t{0});
    const auto png = io::encode_png(edited);
    write_text(s.folder / "out/masks" / names[0], {png.begin(), png.end()});
    const json report = s.run();
    size_t from_out = 0;
    for (const json& view : report["views"]) from_out += contains(view["mask"].get<std::string>(), "out/masks");
    EXPECT_EQ(from_out, 1u);
}

TEST(OutputSafety, TheSceneIsNoOutput) {
    Scene s;
    for (const LastStage last : {LastStage::Mask, LastStage::Align, LastStage::Carve, LastStage::Export}) {
        s.options.run.last_stage = last;
        s.options.run.output = s.scene;
        EXPECT_TRUE(contains(s.refused(), "another -o"));
    }
    for (const char* part : {"images", "masks", "ignore"}) {  // the last is not there yet
        s.options.run.output = s.scene / part;
        EXPECT_TRUE(contains(s.refused(), part));
    }
    fs::create_directory_symlink(s.scene, s.folder / "link");
    s.options.run.output = s.folder / "link";
    s.refused();
    s.options.views.scene = s.folder / "link";
    s.options.run.output = s.scene;
    s.refused();
    // An added scene likewise.
    fs::copy(s.scene, s.folder / "second", fs::copy_options::recursive);
    s.options.views.scene = s.scene;
    s.options.views.added = {s.scene, s.folder / "second"};
    s.options.run.output = s.folder / "second";
    std::string cameras = read_text(s.folder / "second/transforms.json");
    for (size_t at = 0; (at = cameras.find("images/", at)) != std::string::npos; at += 9) cameras.insert(at + 7, "b_");  // no view's name twice
    write_text(s.folder / "second/transforms.json", cameras);
    for (const char* part : {"images", "masks"}) {
        std::vector<fs::path> files;
        for (const auto& entry : fs::directory_iterator(s.folder / "second" / part)) files.push_back(entry.path());
        for (const fs::path& file : files) fs::rename(file, file.parent_path() / ("b_" + file.filename().string()));
    }
    s.refused();
    s.options.views.added.clear();
    // `watch`, too.
    WatchOptions w;
    w.reconstruct = s.options;
    w.reconstruct.run.output = s.scene;
    w.reconstruct.run.force = true;
    w.settle_s = 0;
    w.idle_s = 1;
    w.poll_s = 0.01;
    Progress quiet;
    const auto before = hashes_of(s.folder.path());
    error_of(ExitCode::Output, [&] { watch(w, quiet); });
    EXPECT_EQ(hashes_of(s.folder.path()), before);
}

TEST(OutputSafety, FoldersThatAreReadAreNoOutput) {
    Scene s;
    s.run();
    s.options.mask.masks = s.folder / "out/masks";
    EXPECT_TRUE(contains(s.refused(), "out/masks"));
    s.options.mask.masks.clear();
    s.options.mask.pattern = (s.folder / "out/masks/{stem}.png").string();
    EXPECT_TRUE(contains(s.refused(), "out/masks"));
    s.options.mask.pattern.clear();
    s.options.mask.ignore_masks = s.folder / "out/overlays";
    fs::create_directory(s.folder / "out/overlays");
    EXPECT_TRUE(contains(s.refused(), "out/overlays"));
    s.options.mask.ignore_masks.clear();
    s.options.views.images = s.folder / "out";
    for (const auto& photo : fs::directory_iterator(s.scene / "images")) fs::copy(photo.path(), s.folder / "out" / photo.path().filename());
    EXPECT_TRUE(contains(s.refused(), "photographs"));
    for (const auto& photo : fs::directory_iterator(s.scene / "images")) fs::remove(s.folder / "out" / photo.path().filename());
    s.options.views.images.clear();
    s.options.views.cameras = s.folder / "out/cameras.json";
    EXPECT_TRUE(contains(s.refused(), "out/cameras.json"));
}

/// --force lets a run into a folder with other files; masks in it stay what they are.
TEST(OutputSafety, MasksOfSomebodyElseAreNotReplaced) {
    Scene s;
    const fs::path mine = s.folder / "out/masks/0003.png";
    fs::create_directories(mine.parent_path());
    write_text(mine, "precious");
    s.options.run.force = true;
    EXPECT_TRUE(contains(error_of(ExitCode::Output, [&] { s.run(); }), "0003.png"));
    s.options.run.force = false;  // the folder counts as a result's now
    EXPECT_TRUE(contains(error_of(ExitCode::Output, [&] { s.run(); }), "0003.png"));
    EXPECT_EQ(read_text(mine), "precious");
    fs::remove(mine);
    s.run();
    EXPECT_TRUE(fs::exists(mine));
    // Without the note, or with one of another kind, masks that are as a run would write them are ours all the same.
    for (const char* note : {"", "[]", "{\"0003.png\": 7}"}) {
        if (*note) write_text(s.folder / "out/masks/.written_by_vdbcarve.json", note);
        else fs::remove(s.folder / "out/masks/.written_by_vdbcarve.json");
        s.run();
        EXPECT_EQ(json::parse(read_text(s.folder / "out/masks/.written_by_vdbcarve.json")).size(), 8u);
    }
}

/// Not one that it would write, nor one that a result of fewer formats has not.
TEST(OutputSafety, ForceWritesBesideOtherFilesNotOverThem) {
    for (const char* theirs : {"mesh.stl", "mesh.ply", "cameras.json", "report.json", "stages/act1.txt", "depth/a.depth.tiff", "unverified/cameras.json"}) {
        Scene s;
        const fs::path file = s.options.run.output / theirs;
        fs::create_directories(file.parent_path());
        write_text(file, "precious");
        s.options.run.force = true;
        EXPECT_TRUE(contains(error_of(ExitCode::Output, [&] { s.run(); }), fs::path(theirs).begin()->string())) << theirs;
        EXPECT_EQ(hashes_of(s.options.run.output).size(), 1u) << theirs;
        EXPECT_EQ(read_text(file), "precious");
    }
    // A result whose stages/ were deleted is a result.
    Scene s;
    s.run();
    fs::remove_all(s.options.run.output / "stages");
    EXPECT_TRUE(contains(error_of(ExitCode::Output, [&] { s.run(); }), "--force"));
    s.options.run.force = true;
    s.run();
}

TEST(OutputSafety, PicturesOfAComparisonReplaceNoInput) {
    Scene s;
    s.options.color.options.mode = ColorMode::Blend;
    s.run();
    Progress quiet;
    const Mesh mesh = read_mesh(s.folder / "out/mesh.ply");
    for (const fs::path& save : {s.scene / "images", s.scene / "masks", s.folder / "out/masks"}) {
        const auto before = hashes_of(s.folder.path());
        EXPECT_TRUE(contains(error_of(ExitCode::Output, [&] { compare_photos(mesh, s.views(), {s.folder / "out", false, save}, quiet); }), save.string()));
        EXPECT_EQ(hashes_of(s.folder.path()), before);
    }
}

/// What the pages describe is no mistake.
TEST(OutputSafety, DocumentedUsesStay) {
    Scene s;
    const auto inputs = hashes_of(s.scene);
    // `mask` first, then its masks; the result inside the scene.
    s.options.run.last_stage = LastStage::Mask;
    s.options.run.output = s.folder / "masks";
    s.run();
    s.options.run.last_stage = LastStage::Export;
    s.options.mask.masks = s.folder / "masks/masks";
    s.options.run.output = s.scene / "out";
    s.run();
    s.run();
    EXPECT_EQ(hashes_of(s.scene, s.scene / "out"), inputs);
    // The cameras of one result for another, and a mask edited by hand.
    s.options.mask.masks.clear();
    s.options.views.cameras = s.scene / "out/cameras.json";
    s.options.run.output = s.folder / "third";
    s.run();
    const fs::path mask = s.folder / "third/masks/0002.png";
    Image8 m = io::read_image8(mask);
    std::fill_n(m.data.begin(), m.data.size() / 2, uint8_t{0});
    const auto png = io::encode_png(m);
    write_text(mask, {png.begin(), png.end()});
    const std::string edited = read_text(mask);
    EXPECT_TRUE(contains(s.run()["views"][2]["mask"].get<std::string>(), "third/masks/0002.png"));
    EXPECT_EQ(read_text(mask), edited);
    EXPECT_EQ(hashes_of(s.scene, s.scene / "out"), inputs);
}

}  // namespace
}  // namespace vdbcarve::test
