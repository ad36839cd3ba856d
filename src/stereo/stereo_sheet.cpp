// SPDX-License-Identifier: Apache-2.0
#include "stereo/stereo_sheet.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "base/atomic_file.h"
#include "image/image_io.h"
#include "volume/same_transform.h"
#include "base/statistics.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/render.h"

namespace vdbcarve {
namespace {

constexpr int kTileWidth = 360, kGap = 4, kTitle = 22;

/// Colours of the surface's voxels, linear light: where it lies deeper than the hull by more than half a voxel, depths carved it.
openvdb::Vec3SGrid::Ptr what_was_carved(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface) {
    const openvdb::Vec3f stands(0.5f, 0.5f, 0.52f), carved(0.85f, 0.25f, 0.03f);
    openvdb::Vec3SGrid::Ptr out = openvdb::Vec3SGrid::create(stands);
    out->setTransform(same_transform(surface.transform()));
    out->topologyUnion(surface);
    const auto half = static_cast<float>(0.5 * surface.voxelSize()[0]);
    const openvdb::FloatGrid::ConstAccessor before = hull.getConstAccessor(), after = surface.getConstAccessor();
    for (auto voxel = out->beginValueOn(); voxel; ++voxel)
        voxel.setValue(after.getValue(voxel.getCoord()) - before.getValue(voxel.getCoord()) > half ? carved : stands);
    return out;
}

/// White, yellow, red, blue: from near to far.
std::array<uint8_t, 3> depth_color(double share) {
    constexpr double kStops[4][3] = {{255, 250, 230}, {245, 185, 60}, {175, 45, 80}, {35, 30, 110}};
    const double at = 3 * std::clamp(share, 0.0, 1.0);
    const int i = std::min(2, static_cast<int>(at));
    std::array<uint8_t, 3> out{};
    for (size_t c = 0; c < 3; ++c) out[c] = static_cast<uint8_t>(std::lround(kStops[i][c] + (at - i) * (kStops[i + 1][c] - kStops[i][c])));
    return out;
}

/// The pixel of a map that a tile's pixel shows.
template <class Color>
Image8 shown_map(const ImageF& map, int width, int height, const Color& color) {
    Image8 out(width, height, 3, 255);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const float v =
                map.at(std::min(map.width - 1, (2 * x + 1) * map.width / (2 * width)), std::min(map.height - 1, (2 * y + 1) * map.height / (2 * height)));
            if (!(v > 0.f)) continue;
            const std::array<uint8_t, 3> rgb = color(v);
            for (int c = 0; c < 3; ++c) out.at(x, y, c) = rgb[static_cast<size_t>(c)];
        }
    return out;
}

}  // namespace

Image8 stereo_sheet(const openvdb::FloatGrid& hull, const openvdb::FloatGrid& surface, const std::vector<StereoTile>& tiles) {
    const openvdb::Vec3SGrid::Ptr colors = what_was_carved(hull, surface);
    RenderVolume volume(surface, colors.get());
    RenderOptions look;
    look.background = {{255, 255, 255}};
    std::vector<std::array<Image8, 4>> rows;
    int tile_height = 1;
    for (const StereoTile& t : tiles) {
        const Camera camera = scaled(t.camera, static_cast<double>(kTileWidth) / t.camera.intrinsics.width_px);
        const int width = camera.intrinsics.width_px, height = camera.intrinsics.height_px;
        tile_height = std::max(tile_height, height);
        std::vector<double> depths;
        for (const float d : t.map->depth.data)
            if (d > 0.f) depths.push_back(d);
        const double near = depths.empty() ? 0 : percentile(depths, 0.02), far = depths.empty() ? 1 : percentile(depths, 0.98),
                     reach = std::max(far - near, 1e-12);
        rows.push_back({t.photo.empty() ? Image8(width, height, 3) : io::downscale(t.photo.view(), width, height),
                        shown_map(t.map->depth, width, height, [&](float d) { return depth_color((static_cast<double>(d) - near) / reach); }),
                        shown_map(t.map->confidence, width, height,
                                  [](float c) {
                                      const auto grey = static_cast<uint8_t>(std::lround(210 * (1 - std::clamp(c, 0.f, 1.f))));
                                      return std::array<uint8_t, 3>{grey, grey, grey};
                                  }),
                        render(volume, camera, look)});
    }
    const int columns = 4, pitch = tile_height + kGap;
    Image8 sheet(columns * (kTileWidth + kGap), kTitle + static_cast<int>(rows.size()) * pitch, 3, 255);
    const char* titles[] = {"photograph", "depth: light near, dark far", "confidence: dark is sure", "orange: carved by depth"};
    for (int c = 0; c < columns; ++c) io::write_text(sheet, c * (kTileWidth + kGap) + 4, kTitle - 6, kTileWidth - 8, titles[c]);
    for (size_t r = 0; r < rows.size(); ++r)
        for (size_t c = 0; c < rows[r].size(); ++c) {
            const Image8& tile = rows[r][c];
            const int ox = static_cast<int>(c) * (kTileWidth + kGap), oy = kTitle + static_cast<int>(r) * pitch;
            for (int y = 0; y < tile.height; ++y)
                for (int x = 0; x < tile.width; ++x)
                    for (int k = 0; k < 3; ++k) sheet.at(ox + x, oy + y, k) = tile.at(x, y, tile.channels >= 3 ? k : 0);
        }
    return sheet;
}

void write_depth_maps(const std::filesystem::path& folder, const std::vector<std::string>& names, const std::vector<DepthMap>& maps) {
    tbb::parallel_for(size_t{0}, maps.size(), [&](size_t v) {
        const DepthMap& m = maps[v];
        if (m.depth.data.empty()) return;
        const std::vector<uint8_t> tiff = io::encode_tiff(m.depth);
        write_file(folder / (names[v] + ".depth.tiff"), tiff.data(), tiff.size());
        Image8 confidence(m.confidence.width, m.confidence.height);
        for (size_t p = 0; p < confidence.data.size(); ++p)
            confidence.data[p] = static_cast<uint8_t>(std::lround(255 * std::clamp(m.confidence.data[p], 0.f, 1.f)));
        io::write_png(folder / (names[v] + ".confidence.png"), confidence);
    });
}

}  // namespace vdbcarve
