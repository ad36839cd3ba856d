// SPDX-License-Identifier: Apache-2.0
// One file for whoever is to see why a run failed.

#include <cstdlib>

#include "support/job.h"
#include "image/image_io.h"
#include "vdbcarve/app/bundle.h"
#include "vdbcarve/app/report.h"

namespace vdbcarve::test {
namespace {

TEST(Bundle, HoldsASceneThatCarvesAlikeAndNoPhotographs) {
    Job job("cup", true);
    job.options.result.report = true;
    const json r = job.run();
    Progress quiet;
    const fs::path archive = job.folder / "b.tar.gz";
    BundleOptions o;
    o.width_px = 120;
    const size_t bytes = bundle(job.folder / "out", archive, o, quiet);
    EXPECT_EQ(bytes, fs::file_size(archive));
    const std::string first = read_text(archive);
    bundle(job.folder / "out", archive, o, quiet);
    EXPECT_EQ(first, read_text(archive));
    ASSERT_EQ(std::system(("tar xzf '" + archive.string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
    const fs::path root = job.folder / "vdbcarve-bundle";
    for (const char* file : {"README.txt", "versions.json", "report.json", "report.html", "config.toml", "scene/cameras.json", "scene/masks/0003.png"})
        EXPECT_TRUE(fs::exists(root / file)) << file;
    EXPECT_FALSE(fs::exists(root / "scene/images"));
    // The photographs' colours are not in it: COLOR_0, in base64 wherever it may begin.
    const auto has_colors = [](const std::string& page) {
        return page.find("Q09MT1Jf") != std::string::npos || page.find("NPTE9SXz") != std::string::npos || page.find("DT0xPUl8w") != std::string::npos;
    };
    EXPECT_FALSE(has_colors(read_text(root / "report.html")));
    EXPECT_EQ(has_colors(job.bytes("report.html")), report_has_viewer());
    EXPECT_EQ(io::read_image8(root / "scene/masks/0003.png").width, 120);
    ReconstructOptions again = job.options;
    again.views.scene = root / "scene";
    again.run.output = job.folder / "again";
    const json second = json::parse(reconstruct(again, quiet).report_json);
    EXPECT_NEAR(second["mesh"]["volume"].get<double>(), r["mesh"]["volume"].get<double>(), 0.02 * r["mesh"]["volume"].get<double>());
    o.photos = true;
    bundle(job.folder / "out", archive, o, quiet);
    ASSERT_EQ(std::system(("tar xzf '" + archive.string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
    EXPECT_EQ(io::read_image8(root / "scene/images/0003.jpg").width, 120);
    EXPECT_THROW(bundle(job.folder / "scene", archive, o, quiet), InputError);
}

// A later run that fails on a finished result: the bundle's scene is what that run had.
TEST(Bundle, OfALaterRunThatFailedHasItsScene) {
    Arrivals a;
    for (const size_t n : {0, 1, 2, 3, 4, 5}) a.arrive(n);
    a.run(a.options);
    a.arrive(6);
    fs::copy_file(a.folder / ("scene/masks/" + fs::path(a.names[6]).stem().string() + ".png"),
                  a.folder / ("scene/masks/" + fs::path(a.names[7]).stem().string() + ".png"));
    fs::copy_file(a.folder / ("all/images/" + a.names[7]), a.folder / ("scene/images/" + a.names[7]));
    ReconstructOptions o = a.options;
    o.views.added = {a.options.views.scene};
    o.grid.bounds = Box3d(Vec3d(50, 50, 50), Vec3d(51, 51, 51));
    Progress quiet;
    EXPECT_THROW(reconstruct(o, quiet), UsageError);
    bundle(a.folder / "out", a.folder / "b.tar.gz", {}, quiet);
    ASSERT_EQ(std::system(("tar xzf '" + (a.folder / "b.tar.gz").string() + "' -C '" + a.folder.path().string() + "'").c_str()), 0);
    const json cameras = json::parse(read_text(a.folder / "vdbcarve-bundle/scene/cameras.json"));
    EXPECT_EQ(cameras["frames"].size(), 8u);
}

// Killed before it was done, with cameras that were found and are not to be trusted from before: both are in it.
TEST(Bundle, OfARunThatWasKilledHasItsCameras) {
    Job job("cup");
    job.run();
    for (const char* late : {"report.json", "cameras.json", "config.toml"}) fs::remove(job.folder / "out" / late);
    fs::create_directories(job.folder / "out/unverified");
    write_text(job.folder / "out/unverified/report.json", "{}");
    write_text(job.folder / "out/unverified/preview.png", "shows photographs");
    Progress quiet;
    EXPECT_THROW(bundle(job.folder / "out", job.folder / "b.zip", {}, quiet), UsageError);
    EXPECT_THROW(bundle(job.folder / "nowhere", job.folder / "b.tar.gz", {}, quiet), InputError);
    BundleOptions o;
    o.photos = true;
    for (const bool photos : {false, true}) {
        o.photos = photos;
        fs::remove_all(job.folder / "vdbcarve-bundle");
        bundle(job.folder / "out", job.folder / "b.tar.gz", o, quiet);
        ASSERT_EQ(std::system(("tar xzf '" + (job.folder / "b.tar.gz").string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
        const fs::path root = job.folder / "vdbcarve-bundle";
        EXPECT_TRUE(fs::exists(root / "scene/cameras.json"));
        EXPECT_TRUE(fs::exists(root / "unverified/report.json"));
        EXPECT_EQ(fs::exists(root / "unverified/preview.png"), photos);
        EXPECT_EQ(fs::exists(root / "scene/images"), photos);  // from where the run took them
    }
}

// Of a run that failed: what it failed with, and the scene that it failed on.
TEST(Bundle, OfARunThatFailedSaysWhatWith) {
    Job job("cup");
    job.options.grid.bounds = Box3d(Vec3d(50, 50, 50), Vec3d(51, 51, 51));  // nothing is there
    EXPECT_THROW(job.run(), Error);
    Progress quiet;
    bundle(job.folder / "out", job.folder / "b.tar.gz", {}, quiet);
    ASSERT_EQ(std::system(("tar xzf '" + (job.folder / "b.tar.gz").string() + "' -C '" + job.folder.path().string() + "'").c_str()), 0);
    const json failure = json::parse(read_text(job.folder / "vdbcarve-bundle/failure/failure.json"));
    EXPECT_EQ(failure["failure"]["stage"], "carve");
    EXPECT_NE(failure["failure"]["text"].get<std::string>().find("bounds"), std::string::npos);
    job.options.views.scene = job.folder / "vdbcarve-bundle/scene";
    job.options.run.output = job.folder / "again";
    EXPECT_THROW(job.run(), Error);
    job.options.grid.bounds.reset();
    EXPECT_GT(job.run()["mesh"]["volume"], 0);
    EXPECT_FALSE(fs::exists(job.folder / "again/stages/failure.json"));  // it is mended
}

}  // namespace
}  // namespace vdbcarve::test
