// SPDX-License-Identifier: Apache-2.0
// What is said about a result.

#include <algorithm>

#include "support/job.h"
#include "vdbcarve/app/report.h"

namespace vdbcarve::test {
namespace {

// A hull of masks and cameras that do not belong together is written, to be looked at, but not called done.
TEST(Pipeline, AResultThatMostViewsContradictIsNotDone) {
    Job job("boxes");
    job.run();
    EXPECT_EQ(job.last.contradiction, "");
    const auto mask = [&](const char* called, int i) { return job.folder / fs::path("scene/masks/" + std::string(called) + std::to_string(i) + ".png"); };
    for (int i = 0; i < 8; ++i) fs::rename(mask("000", i), mask("m", i));
    for (int i = 0; i < 8; ++i) fs::rename(mask("m", i), mask("000", 3 * i % 8));
    job.run();
    EXPECT_LT(job.last.median_iou, 0.9);
    EXPECT_NE(job.last.contradiction.find("vdbcarve check"), std::string::npos);
    EXPECT_TRUE(fs::exists(job.folder / "out/mesh.ply"));
    // Whoever has the files only is told, too.
    EXPECT_EQ(json::parse(job.last.report_json)["contradiction"], job.last.contradiction);
    Progress quiet;
    EXPECT_NE(report_html(job.folder / "out", {}, quiet).find("contradict each other</b>"), std::string::npos);
}

// One file, nothing fetched: every view with its photograph, worst first, the model in it, every warning.
TEST(Pipeline, AReportSaysWhatTheResultIs) {
    Job job("cup", true);
    job.options.views.up = "-z";  // is warned of
    const json r = job.run();
    Progress quiet;
    const std::string page = report_html(job.folder / "out", {}, quiet);
    // The job writes it, too: but for the model, whose colours it has before they are rounded for a file.
    const auto without_data = [](std::string text) {
        for (const char* kind : {"data:model", "data:image/png"})
            for (size_t from; (from = text.find(kind)) != std::string::npos;) text.erase(from, text.find('"', from) - from);
        return text;
    };
    EXPECT_TRUE(without_data(page) == without_data(job.bytes("report.html")));
    EXPECT_LT(page.size(), 25'000'000u);
    size_t at = page.find("worst first");
    ASSERT_NE(at, std::string::npos);
    std::vector<std::pair<double, std::string>> worst;
    for (const json& v : r["views"]) worst.emplace_back(v["silhouette_iou"], v["name"]);
    std::sort(worst.begin(), worst.end());
    for (const auto& [iou, name] : worst) {
        at = page.find("alt=\"" + name + "\" src=\"data:image/jpeg;base64,", at);
        ASSERT_NE(at, std::string::npos) << name;
    }
    EXPECT_NE(page.find("up is said to be -z"), std::string::npos);
    EXPECT_EQ(page.find("data:model/gltf-binary;base64,") != std::string::npos, report_has_viewer());
    EXPECT_NE(page.find("data:image/png;base64,"), std::string::npos);
    // Nothing of ours points outside. (The viewer's own text names its decoders' homes, which it asks only for compressed models.)
    const std::string ours = page.substr(page.find("<body>"));
    EXPECT_EQ(ours.find("http"), std::string::npos);
    ReportOptions small;
    small.most_faces = 0;
    small.most_photos = 3;
    const std::string less = report_html(job.folder / "out", small, quiet);
    EXPECT_EQ(less.find("gltf-binary;base64"), std::string::npos);
    EXPECT_NE(less.find("5 more views"), std::string::npos);
    EXPECT_THROW(report_html(job.folder / "scene", {}, quiet), InputError);
}

}  // namespace
}  // namespace vdbcarve::test
