// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include "device/device_parts.h"
#include "render/render_plan.h"

namespace vdbcarve {

void Device::set_colors(const openvdb::Vec3SGrid& grid) {
    const NanoBuffer colors = to_nanovdb(grid);
    Parts& p = *parts_;
    p.use();
    p.render.set_colors(colors.data.get(), colors.size, p.stream);
    p.stream.wait();
}

Image8 Device::render(const Camera& camera, const RenderOptions& options) {
    Parts& p = *parts_;
    p.use();
    const auto& volume = p.surface.topology ? p.surface : p.need(p.hull, "volume");
    const cuda::GridSpec& spec = volume.grid.spec();
    const std::array<int, 6> box = p.render.leaf_box(volume.grid, p.stream, p.times);
    const RenderFrame frame({{box[0], box[1], box[2]}, {box[3], box[4], box[5]}},
                            Vec3d(spec.first_voxel_world[0], spec.first_voxel_world[1], spec.first_voxel_world[2]), spec.voxel_size);
    const kernel::RenderRule rule = render_rule(frame, camera, options);
    const uint8_t* pixels = p.render.render(volume.grid, frame.base, frame.box, rule, ambient_directions(rule.ambient_rays), srgb_table(), p.stream, p.times);
    Image8 out(rule.width, rule.height, 4);
    p.fetcher.fetch_to(out.data.data(), pixels, out.data.size(), p.stream);
    p.stream.wait();
    return out;
}

}  // namespace vdbcarve
