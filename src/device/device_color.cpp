// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/device.h"

#include "color/color_plan.h"
#include "device/device_parts.h"

namespace vdbcarve {
namespace {

/// Pictures on their way to the device: read in parallel into page-locked memory, piece by piece, while the piece before travels.
class PhotoUpload {
  public:
    explicit PhotoUpload(const cuda::Stream& stream) : stream_(stream) {}
    void send(uint8_t* to, const void* from, size_t bytes) {
        for (size_t at = 0; at < bytes; at += kPiece) {
            const size_t size = std::min(kPiece, bytes - at);
            cuda::PinnedBuffer<uint8_t>& held = held_[turn_ % 2];
            if (turn_ > 1) gone_[turn_ % 2].wait();
            copy_parallel(held.ensure(kPiece), static_cast<const uint8_t*>(from) + at, size);
            stream_.to_device(to + at, held.data(), size);
            gone_[turn_++ % 2].record(stream_);
        }
    }

  private:
    static constexpr size_t kPiece = size_t{8} << 20;
    const cuda::Stream& stream_;
    cuda::PinnedBuffer<uint8_t> held_[2];
    cuda::Event gone_[2];
    size_t turn_ = 0;
};

}  // namespace

ColorResult Device::color(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& source, const ColorOptions& options,
                          Progress& progress) {
    Parts& p = *parts_;
    p.use();
    check_color(surface, inputs, options);
    const Parts::Volume& volume = p.need(p.surface, "level set");
    const kernel::ColorRule rule = color_rule(options, leaf_box(surface));
    ViewBatches batches(inputs.size(), options.batch);
    ColorResult out;
    out.backend_used = "cuda";

    progress.begin("color", 6);
    const kernel::ColorBase base = color_base(leaf_box(surface));
    if (p.color.find_contour(volume.grid, base, options.normal_radius_vox, normal_weights(options.normal_radius_vox), p.stream, p.times) == 0)
        explain_unseen(inputs);
    progress.step();
    std::vector<kernel::ColorView> views;
    for (const ColorInput& input : inputs) views.push_back(make_color_view(input, surface.transform(), base));
    std::vector<Photo> photos;
    PhotoUpload upload(p.stream);
    const auto load = [&](size_t first, size_t last) {
        photos.clear();
        if (source) photos = source(first, last);
        const SampledMasks masks(inputs, first, last);
        this->upload(masks.views());
        this->distance(margin_fields());
        p.times.measure("color: photographs", p.stream, [&] {
            size_t bytes = 0;
            const auto each = [&](const auto& visit) {
                for (size_t v = first; v < last; ++v) {
                    const PhotoView photo = source ? view_of(photos[v - first]) : inputs[v].photo;
                    if (inputs[v].use && !photo.empty())
                        visit(v, photo,
                              photo.pixels8.pixels() * static_cast<size_t>(photo.pixels8.channels) +
                                  2 * photo.pixels16.pixels() * static_cast<size_t>(photo.pixels16.channels));
                }
            };
            each([&](size_t v, const PhotoView& photo, size_t size) {
                check_photo("color", inputs[v], photo);
                bytes += (size + 255) / 256 * 256;
            });
            uint8_t* to = p.photos.ensure(std::max<size_t>(bytes, 1));
            for (size_t v = first; v < last; ++v) {
                views[v].texels8 = nullptr;
                views[v].texels16 = nullptr;
            }
            each([&](size_t v, const PhotoView& photo, size_t size) {
                kernel::ColorView& view = views[v];
                const bool wide = photo.pixels8.empty();
                upload.send(to, wide ? static_cast<const void*>(photo.pixels16.data) : photo.pixels8.data, size);
                view.texels8 = wide ? nullptr : to;
                view.texels16 = wide ? reinterpret_cast<const uint16_t*>(to) : nullptr;
                view.channels = photo.channels();
                view.linear = p.color.linear(wide, linear_table(wide), p.stream);
                view.silhouette = p.view_of(p.headers[v - first].silhouette, p.silhouettes[v - first]);
                to += (size + 255) / 256 * 256;
            });
        });
        for (size_t v = first; v < last; ++v)
            if (!views[v].texels8 && !views[v].texels16) views[v].width = views[v].height = -1;
    };
    const auto for_batches = [&](const auto& work) {
        batches.each(progress, load, [&](size_t first, size_t last) {
            work(first, std::vector<kernel::ColorView>(views.begin() + static_cast<long>(first), views.begin() + static_cast<long>(last)));
        });
    };

    std::vector<uint32_t> contour(p.color.contour_count());
    out.exposure = choose_exposure(options, inputs.size(), [&] {
        const std::vector<uint32_t> places = exposure_places(contour.size());
        Observations all;
        all.views = inputs.size();
        all.table.resize(places.size() * all.views);
        std::vector<Observation> part;
        for_batches([&](size_t first, const std::vector<kernel::ColorView>& some) {
            p.color.observe(some, rule, places, part, p.stream, p.times);
            for (size_t n = 0; n < places.size(); ++n)
                std::copy_n(part.begin() + static_cast<long>(n * some.size()), some.size(), all.table.begin() + static_cast<long>(n * all.views + first));
        });
        return all;
    });
    set_gains(views, out.exposure.gains);
    progress.step();
    for_batches([&](size_t first, const std::vector<kernel::ColorView>& some) { p.color.find_views(some, static_cast<int>(first), rule, p.stream, p.times); });
    if (p.color.decide(views, rule, p.stream, p.times) == 0) explain_unseen(inputs);
    progress.step();
    p.color.fill(volume.grid, p.stream, p.times);
    progress.step();
    p.color.spread(volume.grid, *volume.topology, options.depth_vox, spread_passes(surface), p.stream, p.times);
    p.stream.wait();
    progress.step();

    // Home: colours leaf by leaf, what is said of the contour's voxels, and the grids of both.
    std::vector<uint8_t> blended(contour.size());
    std::vector<float> confidence(contour.size());
    std::vector<uint32_t> of_view(inputs.size());
    p.stream.to_host(of_view.data(), p.color.voxels_of_view(), of_view.size());
    p.fetcher.fetch_to(contour.data(), p.color.contour(), contour.size() * sizeof(uint32_t), p.stream);
    p.fetcher.fetch_to(blended.data(), p.color.views_blended(), blended.size(), p.stream);
    p.fetcher.fetch_to(confidence.data(), p.color.confidence(), confidence.size() * sizeof(float), p.stream);
    out.color = empty_color(surface);
    std::vector<openvdb::Vec3STree::LeafNodeType*> leaves;
    out.color->tree().getNodes(leaves);
    static_assert(sizeof(kernel::Rgb) == sizeof(openvdb::Vec3s));
    constexpr size_t kLeafBytes = cuda::kLeafVoxels * sizeof(kernel::Rgb);
    p.fetcher.fetch(p.color.leaf_colors(), leaves.size() * kLeafBytes, kLeafBytes, p.stream, [&](const uint8_t* piece, size_t at, size_t size) {
        tbb::parallel_for(size_t{0}, size / kLeafBytes,
                          [&](size_t n) { std::memcpy(static_cast<void*>(leaves[at / kLeafBytes + n]->buffer().data()), piece + n * kLeafBytes, kLeafBytes); });
    });
    p.fetcher.fetch(p.color.layers(), leaves.size() * cuda::kLeafVoxels, cuda::kLeafVoxels, p.stream, [&](const uint8_t* piece, size_t at, size_t size) {
        tbb::parallel_for(size_t{0}, size / cuda::kLeafVoxels, [&](size_t n) {
            openvdb::util::NodeMask<3> active;
            for (openvdb::Index t = 0; t < cuda::kLeafVoxels; ++t)
                if (piece[n * cuda::kLeafVoxels + t] != kernel::kNoLayer) active.setOn(t);
            leaves[at / cuda::kLeafVoxels + n]->setValueMask(active);
        });
    });
    p.stream.wait();
    out.statistics.voxels_of_view.assign(of_view.begin(), of_view.end());
    finish_color(out, surface, contour, blended, confidence, options);
    progress.step();
    for (const auto& [name, ms] : p.times.milliseconds())
        if (name.rfind("color: ", 0) == 0) out.milliseconds.emplace_back(name.substr(7), ms);
    return out;
}

}  // namespace vdbcarve
