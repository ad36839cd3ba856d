// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include <tbb/parallel_for.h>

#include "device/device_parts.h"
#include "image/field_plan.h"

namespace vdbcarve {

void Device::upload(const std::vector<MaskView>& masks) {
    Parts& p = *parts_;
    p.use();
    p.mask_of.assign(masks.size(), SIZE_MAX);
    p.mask_sizes.clear();
    p.headers.clear();  // fields of other masks
    std::vector<cuda::HostMask> host;
    for (size_t i = 0; i < masks.size(); ++i) {
        const MaskView& m = masks[i];
        if (m.coverage.empty()) continue;
        p.mask_of[i] = host.size();
        host.push_back({m.coverage.data, m.ignore.empty() ? nullptr : m.ignore.data, m.coverage.width, m.coverage.height});
        p.mask_sizes.push_back({m.coverage.width, m.coverage.height, !m.ignore.empty()});
    }
    p.times.measure("upload", p.stream, [&] {
        p.distance.upload(
            host,
            [](const std::vector<cuda::HostMask>& all, const auto& place) {
                tbb::parallel_for(size_t{0}, all.size(), [&](size_t v) {
                    const size_t bytes = static_cast<size_t>(all[v].width) * static_cast<size_t>(all[v].height);
                    copy_parallel(place(v, false), all[v].coverage, bytes);
                    if (all[v].ignore) copy_parallel(place(v, true), all[v].ignore, bytes);
                });
            },
            p.stream);
    });
}

void Device::distance(const DistanceOptions& options) {
    Parts& p = *parts_;
    p.use();
    check_distance(options);
    for (const auto& m : p.mask_sizes) check_mask_size(m.width, m.height, options.scale);
    const double offset = field_offset(options), reach = field_reach(options);
    p.headers.assign(p.mask_of.size(), {});
    p.silhouettes.assign(p.mask_of.size(), {});
    p.ignored.assign(p.mask_of.size(), {});
    p.times.measure("distance", p.stream, [&] {
        const std::vector<cuda::ObjectBox> boxes = p.distance.prepare(options.scale, options.conservative, p.stream);
        std::vector<cuda::FieldJob> jobs;
        std::vector<cuda::DeviceField*> results;
        const auto order = [&](size_t view, size_t mask, bool of_ignored, const SampledField& header, double field_offset_samples) {
            const FieldLengths l = field_lengths(reach, field_offset_samples);
            jobs.push_back(
                {static_cast<int>(mask), of_ignored, header.x0, header.y0, header.width, header.height, l.reach, l.offset, l.clamp, field_offset_samples});
            results.push_back(of_ignored ? &p.ignored[view] : &p.silhouettes[view]);
        };
        for (size_t v = 0; v < p.mask_of.size(); ++v) {
            const size_t m = p.mask_of[v];
            if (m == SIZE_MAX) continue;
            DistanceField& h = p.headers[v];
            h.scale = options.scale;
            h.mask_width = p.mask_sizes[m].width;
            h.mask_height = p.mask_sizes[m].height;
            const int width = (h.mask_width + options.scale - 1) / options.scale, height = (h.mask_height + options.scale - 1) / options.scale;
            const cuda::ObjectBox& box = boxes[m];
            if (box.x1 < box.x0) {
                h.silhouette = field_header(width, height, {0, 0, 2, 2}, reach);
                order(v, m, false, h.silhouette, 0);
            } else {
                const int around[4] = {box.x0, box.y0, box.x1, box.y1};
                std::copy_n(around, 4, h.object_box);
                h.silhouette = field_header(width, height, window_around(around, width, height, reach, offset), reach);
                order(v, m, false, h.silhouette, offset);
            }
            if (p.mask_sizes[m].ignores) {
                h.ignored = field_header(width, height, {0, 0, width, height}, reach);
                order(v, m, true, h.ignored, 0);
            }
        }
        const std::vector<cuda::DeviceField> made = p.distance.make(jobs, p.stream);
        for (size_t j = 0; j < made.size(); ++j) *results[j] = made[j];
    });
}

std::vector<DistanceField> Device::fields() const {
    const Parts& p = *parts_;
    p.use();
    std::vector<DistanceField> out = p.headers;
    const auto fetch = [&](SampledField& to, const cuda::DeviceField& from) {
        if (!from.samples) return;
        to.samples.resize(from.sample_count);
        to.blocks.resize(from.block_count);
        to.blocks_per_row = from.blocks_per_row;
        p.stream.to_host(to.samples.data(), from.samples, from.sample_count);
        p.stream.to_host(to.blocks.data(), from.blocks, from.block_count);
    };
    for (size_t v = 0; v < out.size(); ++v) {
        fetch(out[v].silhouette, p.silhouettes[v]);
        fetch(out[v].ignored, p.ignored[v]);
    }
    p.stream.wait();
    return out;
}

void Device::set_fields(const std::vector<CarveInput>& inputs) {
    Parts& p = *parts_;
    p.use();
    size_t count = 0;
    const auto each = [&](const auto& visit) {
        for (size_t v = 0; v < inputs.size(); ++v) {
            if (!inputs[v].field) continue;
            visit(v, false, inputs[v].field->silhouette);
            if (!inputs[v].field->ignored.empty()) visit(v, true, inputs[v].field->ignored);
        }
    };
    const auto even = [](size_t n) { return (n + 7) / 8 * 8; };
    each([&](size_t, bool, const SampledField& f) { count += even(f.samples.size()) + even(f.blocks.size()); });
    int16_t* to = p.uploaded_fields.ensure(count);
    p.headers.assign(inputs.size(), {});
    p.silhouettes.assign(inputs.size(), {});
    p.ignored.assign(inputs.size(), {});
    each([&](size_t v, bool of_ignored, const SampledField& f) {
        p.stream.to_device(to, f.samples.data(), f.samples.size());
        cuda::DeviceField& d = (of_ignored ? p.ignored : p.silhouettes)[v];
        d = {to, to + even(f.samples.size()), f.blocks_per_row, f.samples.size(), f.blocks.size()};
        p.stream.to_device(to + even(f.samples.size()), f.blocks.data(), f.blocks.size());
        to += even(f.samples.size()) + even(f.blocks.size());
        const DistanceField& from = *inputs[v].field;
        DistanceField& h = p.headers[v];
        h.scale = from.scale;
        h.mask_width = from.mask_width;
        h.mask_height = from.mask_height;
        std::copy_n(from.object_box, 4, h.object_box);
        SampledField& s = of_ignored ? h.ignored : h.silhouette;
        s.x0 = f.x0;
        s.y0 = f.y0;
        s.width = f.width;
        s.height = f.height;
        s.reach = f.reach;
        std::copy_n(f.cut, 4, s.cut);
    });
    p.stream.wait();
}

}  // namespace vdbcarve
