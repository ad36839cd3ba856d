// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/color.h"

#include <tbb/parallel_for.h>

#include <atomic>
#include <chrono>
#include <cmath>

#include "color/color_plan.h"
#include "volume/leaf_neighbours.h"
#include "volume/nanovdb_bytes.h"
#include "vdbcarve/error.h"
#include "vdbcarve/kernel/color_fill.h"
#include "base/vector_loops.h"

namespace vdbcarve {
namespace {

using kernel::Candidate;
using kernel::ColorView;
using kernel::PointColor;
using kernel::Rgb;
using kernel::SurfacePoint;
using Nano = nanovdb::NanoGrid<float>;
using NanoAccessor = nanovdb::DefaultReadAccessor<float>;

/// The surface as NanoVDB has it, whose leaves stand in the order of the tree's.
class Volume {
  public:
    explicit Volume(const openvdb::FloatGrid& surface)
        : bytes_(to_nanovdb(surface, false)),
          grid_(reinterpret_cast<const Nano*>(bytes_.data.get())),
          base_(color_base(leaf_box(surface))),
          threshold_(sight_threshold(surface)) {
        walls_ = sight_walls(*grid_, threshold_);
    }
    kernel::SightGrid sight() const { return {grid_, walls_.data(), threshold_, base_}; }
    const kernel::ColorBase& base() const { return base_; }
    NanoAccessor accessor() const { return grid_->getAccessor(); }
    const nanovdb::NanoLeaf<float>* leaves() const { return grid_->tree().getFirstNode<0>(); }
    size_t leaf_count() const { return grid_->tree().nodeCount(0); }

  private:
    NanoBuffer bytes_;
    const Nano* grid_;
    kernel::ColorBase base_;
    float threshold_;
    std::vector<uint64_t> walls_;
};

auto reader(const NanoAccessor& accessor) {
    return [&accessor](int i, int j, int k) { return accessor.getValue(nanovdb::Coord(i, j, k)); };
}

/// The contour's voxels, leaf * 512 + offset, in order.
std::vector<uint32_t> contour_of(const Volume& volume) {
    const size_t count = volume.leaf_count();
    std::vector<std::vector<uint32_t>> parts(count);
    for_ranges(count, 16, [&](const tbb::blocked_range<size_t>& range) {
        const NanoAccessor accessor = volume.accessor();
        const auto value = reader(accessor);
        for (size_t n = range.begin(); n < range.end(); ++n) {
            const auto& leaf = volume.leaves()[n];
            for (uint32_t at = 0; at < kLeafVoxels; ++at) {
                const float here = leaf.getValue(at);
                if (!(here < 0.f)) continue;
                const nanovdb::Coord c = leaf.offsetToGlobalCoord(at);
                if (kernel::is_contour(value, here, c[0], c[1], c[2])) parts[n].push_back(static_cast<uint32_t>(n) * kLeafVoxels + at);
            }
        }
    });
    std::vector<uint32_t> out;
    for (const auto& part : parts) out.insert(out.end(), part.begin(), part.end());
    return out;
}

std::vector<SurfacePoint> points_of(const Volume& volume, const std::vector<uint32_t>& contour, float voxel_size, int normal_radius_vox) {
    const std::vector<float> weights = normal_weights(normal_radius_vox);
    const kernel::NormalRule rule{normal_radius_vox, weights.data()};
    std::vector<SurfacePoint> out(contour.size());
    for_ranges(contour.size(), 1024, [&](const tbb::blocked_range<size_t>& range) {
        const NanoAccessor accessor = volume.accessor();
        const auto value = reader(accessor);
        for (size_t n = range.begin(); n < range.end(); ++n) {
            const auto& leaf = volume.leaves()[contour[n] / kLeafVoxels];
            const uint32_t at = contour[n] % kLeafVoxels;
            const nanovdb::Coord c = leaf.offsetToGlobalCoord(at);
            out[n] = kernel::surface_point(value, leaf.getValue(at), voxel_size, c[0], c[1], c[2], rule, volume.base());
        }
    });
    return out;
}

/// Points of one surface, asked of photographs that come in batches.
class Colorist {
  public:
    Colorist(const openvdb::FloatGrid& surface, const Volume& volume, const std::vector<ColorInput>& inputs, const PhotoSource& photos,
             const ColorOptions& options, Progress& progress)
        : inputs_(inputs),
          source_(photos),
          progress_(progress),
          rule_(color_rule(options, leaf_box(surface))),
          sight_(volume.sight()),
          batches_(inputs.size(), options.batch) {
        for (const ColorInput& input : inputs) views_.push_back(make_color_view(input, surface.transform(), volume.base()));
    }

    Observations observe(const std::vector<SurfacePoint>& points) {
        Observations out;
        out.views = inputs_.size();
        out.table.resize(points.size() * out.views, {{0.f, 0.f, 0.f}, 0.f});
        for_batches([&](size_t first, size_t last) {
            for_ranges(points.size(), 64, [&](const tbb::blocked_range<size_t>& range) {
                kernel::SightCells cells(sight_);
                for (size_t n = range.begin(); n < range.end(); ++n)
                    for (size_t v = first; v < last; ++v) out.table[n * out.views + v] = kernel::observe(cells, views_[v], points[n], rule_);
            });
        });
        return out;
    }

    void set_gains(const std::vector<std::array<double, 3>>& gains) { vdbcarve::set_gains(views_, gains); }

    /// The points' colours, and how many have each view as their first choice.
    std::vector<PointColor> colors_of(const std::vector<SurfacePoint>& points, std::vector<size_t>& voxels_of_view) {
        std::vector<PointColor> out(points.size());
        const auto keep = static_cast<size_t>(kernel::kept_candidates(rule_));
        const bool at_once = batches_.all_at_once();
        std::vector<Candidate> found(at_once ? 0 : points.size() * keep);
        std::vector<uint8_t> counts(at_once ? 0 : points.size(), 0);
        std::vector<uint16_t> first_choice(points.size(), UINT16_MAX);
        const auto decide = [&](size_t n, const Candidate* candidates, int count) {
            out[n] = kernel::decide_color(views_.data(), rule_, points[n], candidates, count);
            if (count) first_choice[n] = static_cast<uint16_t>(candidates[0].view);
        };
        for_batches([&](size_t first, size_t last) {
            for_ranges(points.size(), 256, [&](const tbb::blocked_range<size_t>& range) {
                kernel::SightCells cells(sight_);
                Candidate here[kernel::kCandidates];
                for (size_t n = range.begin(); n < range.end(); ++n) {
                    Candidate* candidates = at_once ? here : found.data() + n * keep;
                    const int count = kernel::find_views(cells, views_.data() + first, static_cast<int>(first), static_cast<int>(last), rule_, points[n],
                                                         candidates, at_once ? 0 : counts[n]);
                    if (at_once) decide(n, candidates, count);
                    else counts[n] = static_cast<uint8_t>(count);
                }
                progress_.step(range.size() * (last - first));
            });
        });
        if (!at_once)
            for_ranges(points.size(), 1024, [&](const tbb::blocked_range<size_t>& range) {
                for (size_t n = range.begin(); n < range.end(); ++n) decide(n, found.data() + n * keep, counts[n]);
            });
        voxels_of_view.assign(inputs_.size(), 0);
        for (const uint16_t v : first_choice)
            if (v != UINT16_MAX) ++voxels_of_view[v];
        return out;
    }

    double milliseconds_of_photos() const { return photo_ms_; }

  private:
    /// Calls work(first, last) with the photographs and fields of those views in place.
    template <class Work>
    void for_batches(const Work& work) {
        batches_.each(
            progress_, [&](size_t first, size_t last) { load(first, last); }, work);
    }

    void load(size_t first, size_t last) {
        const auto start = std::chrono::steady_clock::now();
        if (source_) {
            photos_.clear();  // before the next ones come
            photos_ = source_(first, last);
        }
        Progress quiet;
        const SampledMasks masks(inputs_, first, last);
        fields_.clear();
        std::vector<MaskView> present;
        for (const MaskView& m : masks.views())
            if (!m.coverage.empty()) present.push_back(m);
        fields_ = distance_fields(present, margin_fields(), quiet);
        size_t field = 0;
        for (size_t v = first; v < last; ++v) {
            if (!inputs_[v].use) continue;
            const PhotoView photo = source_ ? view_of(photos_[v - first]) : inputs_[v].photo;
            ColorView& view = views_[v];
            view.silhouette = fields_[field++].silhouette.view();
            if (photo.empty()) {
                view.width = view.height = -1;
                continue;
            }
            check_photo("color", inputs_[v], photo);
            view.texels8 = photo.pixels8.data;
            view.texels16 = photo.pixels8.empty() ? photo.pixels16.data : nullptr;
            view.channels = photo.channels();
            view.linear = linear_table(photo.pixels8.empty()).data();
        }
        photo_ms_ += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    }

    const std::vector<ColorInput>& inputs_;
    const PhotoSource& source_;
    Progress& progress_;
    kernel::ColorRule rule_;
    kernel::SightGrid sight_;
    ViewBatches batches_;
    std::vector<ColorView> views_;
    std::vector<Photo> photos_;
    std::vector<DistanceField> fields_;
    double photo_ms_ = 0;
};

/// Colour from the contour over the band, layer by layer.
void spread(openvdb::Vec3SGrid& color, const openvdb::FloatGrid& surface, const std::vector<uint32_t>& contour, const std::vector<Rgb>& colors, int depth_vox) {
    using Leaf = const openvdb::FloatTree::LeafNodeType;
    using ColorLeaf = openvdb::Vec3STree::LeafNodeType;
    std::vector<Leaf*> leaves;
    surface.tree().getNodes(leaves);
    std::vector<ColorLeaf*> color_leaves;
    color.tree().getNodes(color_leaves);
    const auto neighbours = neighbours_of(leaves, numbers_of(leaves));
    const auto voxel = static_cast<float>(surface.voxelSize()[0]);
    const float deepest = -static_cast<float>(depth_vox) * voxel;
    std::vector<uint8_t> layers(leaves.size() * kLeafVoxels, kernel::kNoLayer);
    for (size_t n = 0; n < contour.size(); ++n) {
        layers[contour[n]] = 0;
        color_leaves[contour[n] / kLeafVoxels]->setValueOn(contour[n] % kLeafVoxels, openvdb::Vec3s(colors[n].r, colors[n].g, colors[n].b));
    }
    std::vector<openvdb::util::NodeMask<3>> waiting(leaves.size());
    tbb::parallel_for(size_t{0}, leaves.size(), [&](size_t n) {
        for (auto it = leaves[n]->cbeginValueOn(); it; ++it)
            if (layers[n * kLeafVoxels + it.pos()] == kernel::kNoLayer && *it > deepest) waiting[n].setOn(it.pos());
    });
    const int passes = spread_passes(surface);
    for (int pass = 1; pass <= passes; ++pass)
        tbb::parallel_for(tbb::blocked_range<size_t>(0, leaves.size(), 16), [&](const tbb::blocked_range<size_t>& range) {
            for (size_t n = range.begin(); n < range.end(); ++n) {
                const openvdb::util::NodeMask<3> todo = waiting[n];
                if (todo.isOff()) continue;
                const float* values = leaves[n]->buffer().data();
                for (auto it = todo.beginOn(); it; ++it) {
                    const auto at = it.pos();
                    const auto neighbour = [&](int face, float& value, Rgb& c) {
                        const int shift = face / 2 == 0   ? 6
                                          : face / 2 == 1 ? 3
                                                          : 0,
                                  along = static_cast<int>(at >> shift & 7), to = along + (face % 2 ? 1 : -1);
                        size_t leaf = n;
                        if (to & ~7) {
                            const int32_t other = neighbours[n][static_cast<size_t>(face)];
                            if (other < 0) return false;
                            leaf = static_cast<size_t>(other);
                        }
                        const auto there = (at & ~(openvdb::Index{7} << shift)) | static_cast<openvdb::Index>(to & 7) << shift;
                        // Others may be given their layer, this pass's, at the same time: that is not the one asked for.
                        if (std::atomic_ref(layers[leaf * kLeafVoxels + there]).load(std::memory_order_relaxed) != pass - 1) return false;
                        value = leaf == n ? values[there] : leaves[leaf]->buffer().data()[there];
                        const openvdb::Vec3s& v = color_leaves[leaf]->buffer().data()[there];
                        c = {v[0], v[1], v[2]};
                        return true;
                    };
                    Rgb out;
                    if (!kernel::spread_color(values[at], kernel::kLeastSpread_vox * voxel, neighbour, out)) continue;
                    color_leaves[n]->setValueOn(at, openvdb::Vec3s(out.r, out.g, out.b));
                    std::atomic_ref(layers[n * kLeafVoxels + at]).store(static_cast<uint8_t>(pass), std::memory_order_relaxed);
                    waiting[n].setOff(at);
                }
            }
        });
}

ColorResult color_on_cpu(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const ColorOptions& options,
                         Progress& progress) {
    progress.begin("color", 1);
    ColorResult out;
    auto last = std::chrono::steady_clock::now();
    const auto lap = [&](const char* name, double less = 0) {
        const auto now = std::chrono::steady_clock::now();
        out.milliseconds.emplace_back(name, std::chrono::duration<double, std::milli>(now - last).count() - less);
        last = now;
        progress.check();
    };
    const Volume volume(surface);
    const std::vector<uint32_t> contour = contour_of(volume);
    const std::vector<SurfacePoint> points = points_of(volume, contour, static_cast<float>(surface.voxelSize()[0]), options.normal_radius_vox);
    lap("contour and normals");
    // In steps of a point and a view: half of the time goes into asking which views see a point, the rest in about equal parts into what surrounds that.
    const size_t asked = std::max<size_t>(1, points.size() * inputs.size()), part = asked / 4 + 1;
    progress.begin("color", asked + 4 * part);
    Colorist colorist(surface, volume, inputs, photos, options, progress);
    out.exposure = choose_exposure(options, inputs.size(), [&] {
        std::vector<SurfacePoint> places;
        for (const uint32_t n : exposure_places(contour.size())) places.push_back(points[n]);
        return colorist.observe(places);
    });
    colorist.set_gains(out.exposure.gains);
    const double photo_ms = colorist.milliseconds_of_photos();
    lap("exposure", photo_ms);
    progress.step(part);
    const std::vector<PointColor> seen = colorist.colors_of(points, out.statistics.voxels_of_view);
    lap("views", colorist.milliseconds_of_photos() - photo_ms);
    out.milliseconds.emplace_back("photographs and their fields", colorist.milliseconds_of_photos());

    std::vector<Rgb> colors(contour.size());
    std::vector<uint8_t> known(contour.size());
    std::vector<uint64_t> keys(contour.size());
    std::vector<float> confidence(contour.size());
    for_ranges(contour.size(), 4096, [&](const tbb::blocked_range<size_t>& range) {
        for (size_t n = range.begin(); n < range.end(); ++n) {
            colors[n] = seen[n].color;
            known[n] = static_cast<uint8_t>(seen[n].views);
            confidence[n] = seen[n].confidence;
            const nanovdb::Coord c = volume.leaves()[contour[n] / kLeafVoxels].offsetToGlobalCoord(contour[n] % kLeafVoxels);
            keys[n] = kernel::morton_of_voxel(c[0] - volume.base().i, c[1] - volume.base().j, c[2] - volume.base().k);
        }
    });
    if (std::all_of(known.begin(), known.end(), [](uint8_t k) { return k == 0; })) explain_unseen(inputs);
    fill_colors(keys, known, colors);
    lap("fill");
    progress.step(part);
    out.color = empty_color(surface);
    spread(*out.color, surface, contour, colors, options.depth_vox);
    lap("spread");
    progress.step(part);
    finish_color(out, surface, contour, known, confidence, options);
    lap("grids");
    progress.step(part);
    return out;
}

/// The place, given in index coordinates, with the level set's normal: trilinear, or windowed about the nearest voxel.
SurfacePoint point_at(const NanoAccessor& grid, const Vec3d& p, const kernel::NormalRule& rule, const kernel::ColorBase& base) {
    const auto value = reader(grid);
    Vec3d n = Vec3d::Zero();
    if (rule.radius_vox > 0) {
        const auto nearest = [](double x) { return static_cast<int>(std::lround(x)); };
        const kernel::Vec3 w = kernel::windowed_normal(value, nearest(p.x()), nearest(p.y()), nearest(p.z()), rule.radius_vox, rule.weights);
        n = Vec3d(w.x, w.y, w.z);
    } else {
        const Vec3d f(std::floor(p.x()), std::floor(p.y()), std::floor(p.z()));
        for (int c = 0; c < 8; ++c) {
            const int d[3] = {c >> 2, c >> 1 & 1, c & 1};
            double w = 1;
            for (int a = 0; a < 3; ++a) w *= d[a] ? p[a] - f[a] : 1 - (p[a] - f[a]);
            const int i = static_cast<int>(f.x()) + d[0], j = static_cast<int>(f.y()) + d[1], k = static_cast<int>(f.z()) + d[2];
            n += w * Vec3d(value(i + 1, j, k) - value(i - 1, j, k), value(i, j + 1, k) - value(i, j - 1, k), value(i, j, k + 1) - value(i, j, k - 1));
        }
        if (n.squaredNorm() > 0) n.normalize();
    }
    const Vec3d q = p - Vec3d(base.i, base.j, base.k);
    return {static_cast<float>(q.x()), static_cast<float>(q.y()), static_cast<float>(q.z()),
            static_cast<float>(n.x()), static_cast<float>(n.y()), static_cast<float>(n.z())};
}

}  // namespace

ColorResult color(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const ColorOptions& options, Progress& progress) {
    ColorOptions all = options;
    all.batch = 0;
    return color_in_batches(surface, inputs, {}, all, progress);
}

ColorResult color_in_batches(const openvdb::FloatGrid& surface, const std::vector<ColorInput>& inputs, const PhotoSource& photos, const ColorOptions& options,
                             Progress& progress) {
    check_color(surface, inputs, options);
    return color_on_cpu(surface, inputs, photos, options, progress);
}

size_t color_vertices(Mesh& mesh, const openvdb::Vec3SGrid& color) {
    mesh.colors.assign(mesh.vertices.size(), {0, 0, 0});
    std::atomic<size_t> missed{0};
    for_ranges(mesh.vertices.size(), 4096, [&](const tbb::blocked_range<size_t>& range) {
        const ColorReader reader(color);
        for (size_t n = range.begin(); n < range.end(); ++n) {
            const auto& v = mesh.vertices[n];
            const openvdb::Vec3d p = reader.index_of(Vec3d(v[0], v[1], v[2]));
            Rgb c;
            bool found = reader.interpolate(p, c);
            if (!found) {
                double nearest = 16.0 + 1e-9;
                const openvdb::Coord centre = openvdb::Coord::round(p);
                for (int i = -4; i <= 4; ++i)
                    for (int j = -4; j <= 4; ++j)
                        for (int k = -4; k <= 4; ++k) {
                            const openvdb::Coord at = centre.offsetBy(i, j, k);
                            const double d2 = (at.asVec3d() - p).lengthSqr();
                            if (d2 < nearest && reader.voxel(at[0], at[1], at[2], c)) {
                                nearest = d2;
                                found = true;
                            }
                        }
            }
            if (found) mesh.colors[n] = {c.r, c.g, c.b};
            else missed.fetch_add(1, std::memory_order_relaxed);
        }
    });
    return missed;
}

double color_vertices_from_photos(Mesh& mesh, const openvdb::FloatGrid& surface, const openvdb::Vec3SGrid& color, const std::vector<ColorInput>& inputs,
                                  const PhotoSource& photos, const ColorOptions& options, Progress& progress) {
    check_color(surface, inputs, options);
    color_vertices(mesh, color);
    progress.begin("color", std::max<size_t>(1, mesh.vertices.size() * inputs.size()));
    std::vector<SurfacePoint> points(mesh.vertices.size());
    const Volume volume(surface);
    const std::vector<float> weights = normal_weights(options.normal_radius_vox);
    const kernel::NormalRule rule{options.normal_radius_vox, weights.data()};
    for_ranges(points.size(), 1024, [&](const tbb::blocked_range<size_t>& range) {
        const NanoAccessor accessor = volume.accessor();
        for (size_t n = range.begin(); n < range.end(); ++n) {
            const auto& v = mesh.vertices[n];
            const openvdb::Vec3d p = surface.transform().worldToIndex(openvdb::Vec3d(v[0], v[1], v[2]));
            points[n] = point_at(accessor, Vec3d(p[0], p[1], p[2]), rule, volume.base());
        }
    });
    Colorist colorist(surface, volume, inputs, photos, options, progress);
    if (!options.gains.empty()) colorist.set_gains(options.gains);
    std::vector<size_t> voxels_of_view;
    const std::vector<PointColor> seen = colorist.colors_of(points, voxels_of_view);
    size_t direct = 0;
    for (size_t n = 0; n < points.size(); ++n) {
        if (seen[n].views == 0) continue;
        mesh.colors[n] = {seen[n].color.r, seen[n].color.g, seen[n].color.b};
        ++direct;
    }
    return points.empty() ? 0 : static_cast<double>(direct) / static_cast<double>(points.size());
}

}  // namespace vdbcarve
