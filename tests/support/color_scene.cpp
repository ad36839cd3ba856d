// SPDX-License-Identifier: Apache-2.0
#include "support/color_scene.h"

#include <tbb/parallel_for.h>

#include "base/statistics.h"
#include "support/same_grid.h"
#include "mesh/triangle_tree.h"

namespace vdbcarve::test {

ColorVerdict judge(const ColorScene& s, const ColorResult& result) {
    std::vector<Vec3d> places;
    std::vector<std::array<double, 3>> found;
    std::vector<bool> direct;
    openvdb::FloatGrid::ConstAccessor phi = s.surface->getConstAccessor();
    openvdb::Vec3SGrid::ConstAccessor color = result.color->getConstAccessor();
    const double h = s.voxel();
    for (auto it = result.views->cbeginValueOn(); it; ++it) {
        const openvdb::Coord c = it.getCoord();
        openvdb::Vec3d n(phi.getValue(c.offsetBy(1, 0, 0)) - phi.getValue(c.offsetBy(-1, 0, 0)),
                         phi.getValue(c.offsetBy(0, 1, 0)) - phi.getValue(c.offsetBy(0, -1, 0)),
                         phi.getValue(c.offsetBy(0, 0, 1)) - phi.getValue(c.offsetBy(0, 0, -1)));
        n.normalize();
        const openvdb::Vec3d p = s.surface->transform().indexToWorld(c.asVec3d()) - n * static_cast<double>(phi.getValue(c));
        places.emplace_back(p[0], p[1], p[2]);
        const openvdb::Vec3s v = color.getValue(c);
        found.push_back({v[0], v[1], v[2]});
        direct.push_back(*it > 0);
    }
    const TriangleTree truth(s.scene.truth);
    const std::vector<TrueColor> expected = surface_colors(s.spec, places);
    std::vector<ImageF> edges;  // signed distance to the true masks
    for (const Mask& m : s.scene.masks) edges.push_back(signed_distance(m.coverage, 8));
    std::vector<double> errors(places.size(), -1);
    std::vector<char> visible(places.size(), 0);
    tbb::parallel_for(size_t{0}, places.size(), [&](size_t n) {
        if (expected[n].distance > h) return;
        const TriangleTree::Nearest nearest = truth.nearest(places[n]);
        const Vec3d normal = truth.triangle(nearest.triangle).normal().normalized(), at = truth.nearest_on(nearest.triangle, places[n]) + 0.5 * h * normal;
        for (const ColorInput& input : s.inputs) {
            const Camera& camera = input.camera;
            const auto pixel = camera.project(at);
            if (!input.use || !pixel || pixel->x() < 1 || pixel->y() < 1 || pixel->x() > camera.intrinsics.width_px - 1 ||
                pixel->y() > camera.intrinsics.height_px - 1)
                continue;
            const Vec3d way = camera.intrinsics.orthographic ? Vec3d(-camera.forward_world()) : Vec3d(camera.centre_world() - at);
            if (way.normalized().dot(normal) < 0.2 || truth.hit({at, way.normalized()})) continue;
            visible[n] |= 1;
            const size_t view = static_cast<size_t>(&input - s.inputs.data());
            if (edges[view].at(static_cast<int>(pixel->x()), static_cast<int>(pixel->y())) > -3.f) continue;
            visible[n] = 3;
            break;
        }
        if (!visible[n] || !direct[n]) return;
        const auto& e = expected[n].color;
        errors[n] = ciede2000(lab_from_linear(found[n]), lab_from_linear({e[0], e[1], e[2]}));
    });
    ColorVerdict out;
    std::vector<double> measured;
    for (size_t n = 0; n < places.size(); ++n) {
        out.visible += visible[n] != 0;
        out.inside += visible[n] == 3;
        if (errors[n] < 0) continue;
        ++out.colored;
        out.inside_colored += visible[n] == 3;
        measured.push_back(errors[n]);
        out.wrong += errors[n] > 20;
    }
    out.median = median(measured);
    out.p95 = percentile(measured, 0.95);
    if (!measured.empty()) out.wrong /= static_cast<double>(measured.size());
    return out;
}

std::string line_of(const std::string& name, const ColorVerdict& v, const ColorResult& r) {
    char text[240];
    std::snprintf(text, sizeof text, "| %s | %.2f %% | %.2f %% of %zu | %.2f | %.2f | %.3f %% | %.4f -> %.4f | %.1f %% |", name.c_str(), 100 * v.inside_share(),
                  100 * v.share(), v.visible, v.median, v.p95, 100 * v.wrong, r.exposure.disagreement_before, r.exposure.disagreement,
                  100.0 * static_cast<double>(r.statistics.synthesised) / static_cast<double>(r.statistics.surface_voxels));
    return text;
}

void judge_both_modes(const ColorScene& s, const std::string& name, const std::function<void(const ColorResult&, const ColorVerdict&)>& check) {
    Progress quiet;
    for (const ColorMode mode : {ColorMode::Best, ColorMode::Blend}) {
        ColorOptions options;
        options.mode = mode;
        const ColorResult r = color(*s.surface, s.inputs, options, quiet);
        const ColorVerdict v = judge(s, r);
        std::printf("%s\n", line_of(name + (mode == ColorMode::Best ? ", best" : ", blend"), v, r).c_str());
        EXPECT_GE(v.inside_share(), 0.98);
        EXPECT_GE(v.share(), 0.96);
        check(r, v);
    }
}

void expect_same_colors(const ColorResult& a, const ColorResult& b) {
    expect_same(*a.color, *b.color);
    expect_same(*a.views, *b.views);
    expect_same(*a.confidence, *b.confidence);
    EXPECT_EQ(a.exposure.gains, b.exposure.gains);
    EXPECT_EQ(a.statistics.surface_voxels, b.statistics.surface_voxels);
    EXPECT_EQ(a.statistics.colored, b.statistics.colored);
    EXPECT_EQ(a.statistics.voxels_of_view, b.statistics.voxels_of_view);
}

}  // namespace vdbcarve::test
