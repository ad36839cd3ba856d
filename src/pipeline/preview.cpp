// SPDX-License-Identifier: Apache-2.0
#include "pipeline/preview.h"

#include <tbb/parallel_for.h>

#include <algorithm>

#include "image/image_io.h"

namespace vdbcarve::pipeline {

namespace {

/// Points along the mesh's outline just above a floor, a few to each face that it crosses.
std::vector<Vec3d> section(const Mesh& mesh, const Vec3d& axis, double floor) {
    double highest = floor;
    const auto at = [&](uint32_t v) { return Vec3d(mesh.vertices[v][0], mesh.vertices[v][1], mesh.vertices[v][2]); };
    for (uint32_t v = 0; v < mesh.vertices.size(); ++v) highest = std::max(highest, at(v).dot(axis));
    const double height = floor + 0.004 * (highest - floor);
    std::vector<Vec3d> out;
    for (const auto& t : mesh.triangles) {
        std::vector<Vec3d> ends;
        for (size_t c = 0; c < 3; ++c) {
            const Vec3d a = at(t[c]), b = at(t[(c + 1) % 3]);
            const double da = a.dot(axis) - height, db = b.dot(axis) - height;
            if ((da < 0) != (db < 0)) ends.push_back(a + da / (da - db) * (b - a));
        }
        if (ends.size() == 2)
            for (int k = 0; k < 4; ++k) out.push_back(ends[0] + 0.25 * k * (ends[1] - ends[0]));
    }
    return out;
}

}  // namespace

std::vector<SilhouetteAgreement> compare_with_masks(const Mesh& mesh, const std::vector<Camera>& cameras, const Silhouettes& masks,
                                                    const std::vector<size_t>& which, Progress& progress) {
    std::vector<SilhouetteAgreement> out(cameras.size());
    tbb::parallel_for(size_t{0}, which.size(), [&](size_t w) {
        const size_t i = which[w];
        const Mask& mask = masks.masks.masks[i];
        if (!mask.coverage.empty()) out[i] = compare_silhouettes(mesh, cameras[i], view_of(mask), contour_softness(mask.coverage) >= kSoftContours);
        progress.step();
    });
    return out;
}

Image8 draw_preview(const Mesh& mesh, const Shoot& shoot, const Silhouettes& masks, const std::vector<size_t>& which,
                    const std::vector<SilhouetteAgreement>& agreement, Progress& progress) {
    const std::vector<Camera> cameras = shoot.views.cameras();
    const std::vector<Vec3d> cut =
        shoot.views.floor && !shoot.up().empty() ? section(mesh, up_direction(shoot, masks), *shoot.views.floor) : std::vector<Vec3d>();
    std::vector<PreviewView> tiles(which.size());
    tbb::parallel_for(size_t{0}, which.size(), [&](size_t s) {
        const size_t i = which[s];
        tiles[s] = {
            shoot.views.views[i].name, cameras[i], photo_to_show(shoot.views.views[i], progress), masks.masks.masks[i].coverage, agreement[i].missed_blob,
            agreement[i].thin_lost,    cut};
    });
    Image8 sheet = preview_sheet(mesh, tiles);
    if (!shoot.views.unverified.empty()) io::stamp(sheet, "UNVERIFIED");
    return sheet;
}

std::vector<size_t> spread_evenly(const std::vector<size_t>& of, size_t most) {
    std::vector<size_t> out;
    for (size_t n = of.size(), shown = std::min(n, most), s = 0; s < shown; ++s) out.push_back(of[s * n / shown]);
    return out;
}

}  // namespace vdbcarve::pipeline
