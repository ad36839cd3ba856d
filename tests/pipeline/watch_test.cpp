// SPDX-License-Identifier: Apache-2.0
// Photographs become a result while they arrive. Time is simulated: nothing here waits.
#include "vdbcarve/app/watch.h"

#include <algorithm>
#include <chrono>
#include <fstream>
#include <functional>
#include <map>

#include "support/job.h"

namespace vdbcarve::test {
namespace {

/// Seconds that pass only while the watch sleeps, and what happens meanwhile.
class SimulatedClock {
  public:
    void at(double seconds, std::function<void()> what) { events_.emplace(seconds, std::move(what)); }
    void use_in(WatchOptions& options) {
        // Far longer than any test takes: that a file was written this very minute must not depend on the machine.
        options.settle_s = 1000;
        options.poll_s = 100;
        options.idle_s = 5000;
        options.now_s = [this] { return now_; };
        options.sleep_s = [this](double seconds) {
            now_ += seconds;
            while (!events_.empty() && events_.begin()->first <= now_) {
                const auto what = std::move(events_.begin()->second);
                events_.erase(events_.begin());
                what();
            }
        };
    }

  private:
    double now_ = 0;
    std::multimap<double, std::function<void()>> events_;
};

TEST(Watch, PhotographsBecomeAResultWhileTheyArrive) {
    Arrivals a(false, 8);
    WatchOptions w;
    w.reconstruct = a.options;
    w.until_views = a.names.size();
    SimulatedClock clock;
    clock.use_in(w);
    std::vector<size_t> sizes;
    size_t extended = 0;
    w.on_result = [&](const Reconstruction& r) {
        sizes.push_back(r.views);
        extended += r.added_views;
    };
    for (const size_t n : {3, 1, 5, 0}) a.arrive(n);
    // One goes on being written for longer than files take to settle, a piece at each look.
    const fs::path slow = a.folder / ("scene/images/" + a.names[2]);
    clock.at(3000, [&] {
        const std::string whole = a.bytes("all/images/" + a.names[2]);
        write_text(slow, whole.substr(0, whole.size() / 2));
    });
    for (int i = 1; i <= 25; ++i) clock.at(3000 + 100 * i, [&] { std::ofstream(slow, std::ios::app) << "x"; });
    clock.at(6000, [&] { a.arrive(2); });
    clock.at(8000, [&] { a.arrive(7); });
    clock.at(10000, [&] { a.arrive(4); });
    clock.at(12000, [&] { a.arrive(6); });
    Progress progress;
    const Reconstruction last = watch(w, progress);
    EXPECT_EQ(last.views, a.names.size());
    EXPECT_EQ(sizes, (std::vector<size_t>{4, 5, 6, 7, 8}));
    EXPECT_EQ(extended, 4u);
    const json report = json::parse(last.report_json);
    a.run(a.batch(report));
    EXPECT_EQ(a.hull(a.folder / "batch"), a.hull(a.folder / "out"));
    EXPECT_EQ(a.bytes("batch/mesh.ply"), a.bytes("out/mesh.ply"));
}

// Masks made from the photographs themselves: one that was written badly is named and left out, and holds nobody up.
TEST(Watch, ADamagedPhotographHoldsUpNobody) {
    Arrivals a;
    fs::remove_all(a.folder / "scene/masks");
    const auto arrive = [&](size_t n) {
        fs::copy_file(a.folder / ("all/images/" + a.names[n]), a.folder / ("scene/images/" + a.names[n]), fs::copy_options::overwrite_existing);
    };
    for (const size_t n : {0, 2, 4, 6}) arrive(n);
    const std::string whole = a.bytes("all/images/" + a.names[1]);
    write_text(a.folder / ("scene/images/" + a.names[1]), whole.substr(0, whole.size() / 2));
    arrive(8);
    write_text(a.folder / "scene/images/stranger.png", whole);
    WatchOptions w;
    w.reconstruct = a.options;
    w.reconstruct.mask.method = MaskMethod::Threshold;
    SimulatedClock clock;
    clock.use_in(w);
    size_t views = 0;
    w.on_result = [&](const Reconstruction& r) { views = r.views; };
    Progress progress;
    EXPECT_NE(error_of(ExitCode::Input, [&] { watch(w, progress); }).find(a.names[1]), std::string::npos);
    EXPECT_EQ(views, 5u);
    std::string said;
    for (const std::string& warning : progress.warnings()) said += warning + "\n";
    EXPECT_NE(said.find(a.names[1]), std::string::npos) << said;
    EXPECT_NE(said.find("stranger.png"), std::string::npos) << said;
    arrive(1);
    w.until_views = 7;
    EXPECT_THROW(watch(w, progress), InputError);  // 6 have come
    EXPECT_EQ(views, 6u);
    w.until_views = 6;
    EXPECT_EQ(watch(w, progress).views, 6u);
}

TEST(Watch, EndsWhenNothingComesAndSaysWhatWasWrong) {
    Arrivals a;
    WatchOptions w;
    w.reconstruct = a.options;
    SimulatedClock clock;
    clock.use_in(w);
    Progress quiet;
    EXPECT_THROW(watch(w, quiet), InputError);  // nothing at all
    for (size_t n = 0; n < 5; ++n) a.arrive(n);
    write_text(a.folder / ("scene/masks/" + fs::path(a.names[2]).stem().string() + ".png"), "no picture");
    EXPECT_THROW(watch(w, quiet), InputError);
    a.arrive(2);
    EXPECT_EQ(watch(w, quiet).views, 5u);
    // What is empty for good holds nothing up, nor does a folder of another kind.
    write_text(a.folder / "scene/images/.keep", "");
    write_text(a.folder / ("scene/images/" + fs::path(a.names[1]).stem().string() + ".lock"), "");
    // Another watch goes on from there.
    a.arrive(5);
    EXPECT_EQ(watch(w, quiet).added_views, 1u);
    // Something broken, and nothing else comes.
    write_text(a.folder / ("scene/masks/" + fs::path(a.names[6]).stem().string() + ".png"), "no picture");
    fs::copy_file(a.folder / ("all/images/" + a.names[6]), a.folder / ("scene/images/" + a.names[6]));
    WatchOptions broken = w;
    broken.reconstruct.run.output = a.folder / "broken";
    EXPECT_THROW(watch(broken, quiet), InputError);
    fs::remove(a.folder / ("scene/masks/" + fs::path(a.names[6]).stem().string() + ".png"));
    EXPECT_EQ(watch(broken, quiet).views, 6u);
    // Photographs and masks elsewhere, by whatever path.
    fs::rename(a.folder / "scene/images", a.folder / "photographs");
    fs::create_directory_symlink(a.folder / "photographs", a.folder / "link");
    broken.reconstruct.views.images = a.folder / "link";
    broken.reconstruct.run.output = a.folder / "elsewhere";
    EXPECT_EQ(watch(broken, quiet).views, 6u);
    w.reconstruct.views.scene = a.folder / "nowhere";
    EXPECT_THROW(watch(w, quiet), InputError);
}

// Files that were written long before the watch began are whole at first sight.
TEST(Watch, OldFilesNeedNoTimeToSettle) {
    Arrivals a;
    for (size_t n = 0; n < 4; ++n) a.arrive(n);
    for (const char* folder : {"scene", "scene/images", "scene/masks"})
        for (const auto& entry : fs::directory_iterator(a.folder / folder))
            if (entry.is_regular_file()) fs::last_write_time(entry, fs::file_time_type::clock::now() - std::chrono::hours(1));
    WatchOptions w;
    w.reconstruct = a.options;
    w.reconstruct.run.last_stage = LastStage::Mask;
    w.until_views = 4;
    SimulatedClock clock;
    clock.use_in(w);
    w.sleep_s = [](double) { FAIL() << "there is nothing to wait for"; };
    Progress quiet;
    EXPECT_EQ(watch(w, quiet).views, 4u);
}

}  // namespace
}  // namespace vdbcarve::test
