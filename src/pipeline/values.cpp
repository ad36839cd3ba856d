// SPDX-License-Identifier: Apache-2.0
#include "pipeline/values.h"

#include <tbb/parallel_for.h>

#include <algorithm>

#include "image/image_io.h"
#include "vdbcarve/caps.h"

namespace vdbcarve::pipeline {

using nlohmann::json;

json statistics_json(const CarveStatistics& s) {
    return {{"active_voxels", s.active_voxels}, {"leaves", s.leaves}, {"bytes", s.bytes}, {"node_tests", s.node_tests}, {"voxel_lookups", s.voxel_lookups},
            {"clipped_share", s.clipped_share}};
}

CarveStatistics statistics_of(const json& j) {
    CarveStatistics s;
    s.active_voxels = j.at("active_voxels");
    s.leaves = j.at("leaves");
    s.bytes = j.at("bytes");
    s.node_tests = j.at("node_tests");
    s.voxel_lookups = j.at("voxel_lookups");
    s.clipped_share = j.at("clipped_share");
    return s;
}

void to_json(json& j, const GridFacts& g) {
    j = {{"dims", g.dims},
         {"voxel_size", g.voxel_size},
         {"origin", g.origin},
         {"bounds", g.bounds},
         {"bounds_automatic", g.bounds_automatic},
         {"bounds_seconds", g.bounds_seconds},
         {"pixel_footprint", g.pixel_footprint},
         {"px_per_voxel", g.px_per_voxel},
         {"field_scale", g.field_scale}};
    if (g.floor_clips) j["floor_clips"] = true;
    if (g.expected)
        j.update({{"expected_leaves", std::llround(g.expected->leaves)},
                  {"expected_bytes", std::llround(g.expected->bytes)},
                  {"expected_field_bytes", std::llround(g.expected->field_bytes)},
                  {"expected_peak_bytes", std::llround(g.expected->peak_bytes)},
                  {"memory_limit_bytes", std::llround(g.expected->limit_bytes)}});
    if (g.statistics) j.update(statistics_json(*g.statistics));
    if (!g.bricks.empty()) j["bricks"] = g.bricks;
}

void from_json(const json& j, GridFacts& g) {
    g.dims = j.at("dims");
    g.voxel_size = j.at("voxel_size");
    g.origin = j.at("origin");
    g.bounds = j.at("bounds");
    g.bounds_automatic = j.at("bounds_automatic");
    g.bounds_seconds = j.at("bounds_seconds");
    g.pixel_footprint = j.at("pixel_footprint");
    g.px_per_voxel = j.at("px_per_voxel");
    g.field_scale = j.at("field_scale");
    g.floor_clips = j.value("floor_clips", false);
    if (j.contains("expected_leaves"))
        g.expected = MemoryExpected{j.at("expected_leaves"), j.at("expected_bytes"), j.at("expected_field_bytes"), j.at("expected_peak_bytes"),
                                    j.at("memory_limit_bytes")};
    if (j.contains("leaves")) g.statistics = statistics_of(j);
    if (j.contains("bricks")) g.bricks = j.at("bricks").get<std::vector<std::string>>();
}

std::vector<Camera> used_cameras(const Shoot& shoot, const Silhouettes& masks) {
    const std::vector<Camera> all = shoot.views.cameras();
    std::vector<Camera> out;
    for (const size_t u : masks.used) out.push_back(all[u]);
    return out;
}

std::vector<MaskView> used_mask_views(const Shoot& shoot, const Silhouettes& masks) {
    std::vector<MaskView> out(shoot.views.views.size());
    for (const size_t u : masks.used) out[u] = view_of(masks.masks.masks[u]);
    return out;
}

void add_photographs(Key& key, const Shoot& shoot, const Silhouettes& masks) {
    for (const size_t i : masks.used) {
        const View& view = shoot.views.views[i];
        key.of(masks.file_hashes[i]).of(view.camera).of(view.orientation).of(view.lens.model);
        for (const double c : view.lens.coefficients) key.of(c);
    }
}

Vec3d up_direction(const Shoot& shoot, const Silhouettes& masks) { return up_direction(shoot.up(), used_cameras(shoot, masks)); }

VdbMetadata metadata_of(const Shoot& shoot, const Silhouettes& masks, double voxel_size) {
    return {shoot.views.units, shoot.views.up, masks.used.size(), voxel_size, masks.inputs_sha256};
}

Image8 photo_to_show(const View& view, Progress& progress) {
    if (view.image_path.empty()) return {};
    try {
        return load_photo8(view);
    } catch (const InputError& e) {
        progress.warn(std::string(e.what()) + "; the preview shows it black");  // carving needed its mask only
        return {};
    }
}

bool photos_are_masks(const Shoot& shoot, const Silhouettes& masks) {
    const auto is_own = [&](size_t i) { return masks.masks.origins[i].rfind(shoot.views.views[i].image_path.string() + " (", 0) == 0; };
    if (std::all_of(masks.used.begin(), masks.used.end(), is_own)) return true;
    const View& first = shoot.views.views[masks.used.front()];
    if (first.image_path.empty() || first.lens.distorts()) return false;
    try {
        const Image8 photo = io::read_photo8(first.image_path, first.orientation);
        return photo.channels == 1 && photo.data == masks.masks.masks[masks.used.front()].coverage.data;
    } catch (const InputError&) {
        return false;
    }
}

std::vector<ColorInput> color_inputs(const Shoot& shoot, const Silhouettes& masks, int leave_out) {
    const std::vector<Camera> cameras = shoot.views.cameras();
    std::vector<ColorInput> out;
    for (size_t u = 0; u < masks.used.size(); ++u) {
        const size_t i = masks.used[u];
        const View& view = shoot.views.views[i];
        const bool withheld = leave_out >= 2 && u % static_cast<size_t>(leave_out) == static_cast<size_t>(leave_out) / 2;
        out.push_back({view.name, cameras[i], view_of(masks.masks.masks[i]), {}, !withheld && !view.image_path.empty()});
    }
    return out;
}

PhotoSource Photographs::source() {
    return [this](size_t first, size_t last) {
        std::vector<Photo> out(last - first);
        tbb::parallel_for(first, last, [&](size_t u) {
            const View& view = shoot_.views.views[masks_.used[u]];
            if (view.image_path.empty()) return;
            try {
                out[u - first] = load_photo(view);
            } catch (const InputError& e) {
                // Carving needed its mask only.
                if (!missing_[u].said.exchange(true)) progress_.warn(std::string(e.what()) + "; it gives no colour");
            }
        });
        return out;
    };
}

double largest_photo_bytes(const Shoot& shoot, const Silhouettes& masks) {
    double largest = 1;
    for (const size_t i : masks.used) {
        const Intrinsics& k = shoot.views.views[i].camera.intrinsics;
        largest = std::max(largest, kPhotoBytesPerPixel * k.width_px * k.height_px);
    }
    return largest;
}

}  // namespace vdbcarve::pipeline
