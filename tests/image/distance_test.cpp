// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/distance.h"

#include <cmath>
#include <random>

#include "support/scenes.h"
#include "base/vector_loops.h"
#include "vdbcarve/kernel/distance.h"

namespace vdbcarve::test {
namespace {

/// Coverage of a disc, 32 x 32 samples a pixel.
Image8 disc(int width, int height, double cx, double cy, double r, bool binary) {
    Image8 out(width, height);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            int count = 0;
            for (int j = 0; j < 32; ++j)
                for (int i = 0; i < 32; ++i) count += std::hypot(x + (i + 0.5) / 32 - cx, y + (j + 0.5) / 32 - cy) < r;
            out.at(x, y) = binary ? (count >= 512 ? 255 : 0) : static_cast<uint8_t>((count * 255 + 512) / 1024);
        }
    return out;
}

double rms_error(const ImageF& s, double cx, double cy, double r, double within) {
    double sum2 = 0;
    size_t n = 0;
    for (int y = 0; y < s.height; ++y)
        for (int x = 0; x < s.width; ++x) {
            const double exact = std::hypot(x + 0.5 - cx, y + 0.5 - cy) - r;
            if (std::fabs(exact) > within) continue;
            sum2 += (s.at(x, y) - exact) * (s.at(x, y) - exact);
            ++n;
        }
    return std::sqrt(sum2 / static_cast<double>(n));
}

TEST(Distance, SoftDiscIsKnownToATenthOfAPixel) {
    for (const double r : {7.3, 31.8, 90.1}) {
        const ImageF soft = signed_distance(disc(240, 230, 118.37, 112.81, r, false));
        EXPECT_LT(rms_error(soft, 118.37, 112.81, r, 2), 0.1) << r;
        EXPECT_LT(rms_error(soft, 118.37, 112.81, r, r), 0.1) << r;
        EXPECT_LT(rms_error(soft, 118.37, 112.81, r, 1e9), 0.1) << r;
    }
    // What keeping the edge soft is worth.
    EXPECT_GT(rms_error(signed_distance(disc(240, 230, 118.37, 112.81, 31.8, true)), 118.37, 112.81, 31.8, 2), 0.15);
}

Image8 random_mask(int width, int height, uint32_t seed, bool blobs) {
    std::mt19937 engine(seed);
    Image8 out(width, height);
    for (uint8_t& v : out.data) v = static_cast<uint8_t>(engine() & 255);
    if (blobs)
        for (int pass = 0; pass < 4; ++pass) {
            const Image8 before = out;
            for (int y = 1; y + 1 < height; ++y)
                for (int x = 1; x + 1 < width; ++x) {
                    int sum = 0;
                    for (int j = -1; j <= 1; ++j)
                        for (int i = -1; i <= 1; ++i) sum += before.at(x + i, y + j);
                    out.at(x, y) = static_cast<uint8_t>(std::clamp(128 + (sum / 9 - 128) * 3 / 2, 0, 255));
                }
        }
    return out;
}

/// Distance to all crossing points by looking at all of them, and within the refined band to all pieces.
ImageF brute_force(const Image8& m) {
    struct Piece {
        double ax, ay, bx, by;
    };
    std::vector<Vec2d> points;
    std::vector<std::pair<Piece, std::pair<int, int>>> pieces;
    for (int y = 0; y < m.height; ++y)
        for (int x = 0; x < m.width; ++x) {
            if (x + 1 < m.width && (m.at(x, y) >= 128) != (m.at(x + 1, y) >= 128))
                points.emplace_back(x + kernel::crossing(m.at(x, y), m.at(x + 1, y)) / 64.0, y);
            if (y + 1 < m.height && (m.at(x, y) >= 128) != (m.at(x, y + 1) >= 128))
                points.emplace_back(x, y + kernel::crossing(m.at(x, y), m.at(x, y + 1)) / 64.0);
            if (x + 1 < m.width && y + 1 < m.height) {
                const auto p = kernel::contour_pieces(m.at(x, y), m.at(x + 1, y), m.at(x + 1, y + 1), m.at(x, y + 1));
                for (int i = 0; i < p.count; ++i) pieces.push_back({{x + p.ax[i] / 64.0, y + p.ay[i] / 64.0, x + p.bx[i] / 64.0, y + p.by[i] / 64.0}, {x, y}});
            }
        }
    ImageF out(m.width, m.height);
    for (int y = 0; y < m.height; ++y)
        for (int x = 0; x < m.width; ++x) {
            double d = m.width + m.height;
            if (!points.empty()) {
                d = 1e9;
                for (const Vec2d& p : points) d = std::min(d, std::hypot(p.x() - x, p.y() - y));
            }
            for (const auto& [p, cell] : pieces) {
                if (x < cell.first - 3 || x > cell.first + 4 || y < cell.second - 3 || y > cell.second + 4) continue;
                const Vec2d a(p.ax, p.ay), u(p.bx - p.ax, p.by - p.ay), w = Vec2d(x, y) - a;
                const double t = std::clamp(u.dot(w) / u.squaredNorm(), 0.0, 1.0);
                d = std::min(d, (w - t * u).norm());
            }
            out.at(x, y) = static_cast<float>(m.at(x, y) >= 128 ? -d : d);
        }
    return out;
}

TEST(Distance, EqualsBruteForce) {
    for (uint32_t seed = 1; seed <= 8; ++seed) {
        const Image8 m = random_mask(37 + static_cast<int>(seed), 29, seed, seed % 2 == 0);
        const ImageF fast = signed_distance(m), slow = brute_force(m);
        // Rounded to 1/64 px.
        for (size_t i = 0; i < fast.data.size(); ++i) ASSERT_NEAR(fast.data[i], slow.data[i], 0.5 / 64 + 1e-3) << "seed " << seed << " at " << i;
    }
}

TEST(Distance, SignAtAPixelCentreIsTheMask) {
    for (uint32_t seed = 1; seed <= 6; ++seed) {
        const Image8 m = random_mask(64, 50, seed, seed % 2 == 0);
        const ImageF s = signed_distance(m);
        for (size_t i = 0; i < m.data.size(); ++i) {
            ASSERT_EQ(s.data[i] > 0, m.data[i] < 128);
            ASSERT_NE(s.data[i], 0.f);
        }
    }
}

// The node bounds of the carve stand on this.
TEST(Distance, ChangesByAtMostTheDistanceWalkedAndTheSlop) {
    std::mt19937 engine(5);
    for (uint32_t seed = 1; seed <= 6; ++seed) {
        const Image8 m = random_mask(80, 60, seed, true);
        const ImageF s = signed_distance(m);
        for (int n = 0; n < 200000; ++n) {
            const int ax = static_cast<int>(engine() % 80), ay = static_cast<int>(engine() % 60), bx = static_cast<int>(engine() % 80),
                      by = static_cast<int>(engine() % 60);
            ASSERT_LE(std::fabs(s.at(ax, ay) - s.at(bx, by)), std::hypot(ax - bx, ay - by) + 2 * 0.083 + 1.0 / 64 + 1e-5);
        }
    }
}

TEST(Distance, MasksWithoutContour) {
    EXPECT_EQ(signed_distance(Image8(20, 10, 1, 0), 40).at(3, 4), 40.f);
    EXPECT_EQ(signed_distance(Image8(20, 10, 1, 255), 40).at(3, 4), -40.f);
    EXPECT_THROW(signed_distance(Image8(1, 10)), UsageError);
}

TEST(Distance, IgnoredPixelsDoNotCarve) {
    Mask mask;
    mask.coverage = disc(60, 60, 30, 30, 12, false);
    mask.ignore = Image8(60, 60);
    for (int y = 0; y < 60; ++y)
        for (int x = 40; x < 60; ++x) mask.ignore.at(x, y) = 255;
    Progress quiet;
    const auto f = distance_fields({view_of(mask)}, {}, quiet);
    EXPECT_LT(f[0].silhouette.at(55, 30), 0);
    EXPECT_GT(f[0].silhouette.at(5, 30), 0);
    EXPECT_GT(f[0].ignored.at(55, 30), 0);
    EXPECT_LT(f[0].ignored.at(5, 30), 0);
}

TEST(Distance, OffsetGrowsTheSilhouette) {
    Mask mask;
    mask.coverage = disc(60, 60, 30, 30, 12, false);
    Progress quiet;
    DistanceOptions grow;
    grow.silhouette_offset_px = 1.5;
    const auto plain = distance_fields({view_of(mask)}, {}, quiet), grown = distance_fields({view_of(mask)}, grow, quiet);
    EXPECT_FLOAT_EQ(plain[0].silhouette.at(50, 30) - 1.5f, grown[0].silhouette.at(50, 30));
}

// Every instruction set, any reach and size: the same bits.
TEST(Distance, SameBitsOnEveryInstructionSet) {
    for (uint32_t seed = 1; seed <= 6; ++seed) {
        const int width = 61 + 37 * static_cast<int>(seed), height = 90 - 11 * static_cast<int>(seed);
        const Image8 m = random_mask(width, height, seed, seed % 2 == 0);
        for (const int reach : {5, 23, 190}) {
            std::vector<std::vector<int16_t>> results;
            for (const VectorLoops* loops : all_vector_loops()) {
                std::vector<int16_t> out(m.pixels());
                std::vector<int32_t> scratch(window_scratch(width, height));
                loops->window_distance({m.data.data(), width, width, height, 64 * reach, 32, 64 * reach, out.data(), scratch.data()});
                results.push_back(std::move(out));
            }
            for (const auto& r : results) ASSERT_EQ(r, results.front());
        }
    }
}

// A window around the object says what the whole image would say, clamped; blocks never claim too much.
TEST(Distance, WindowAndBlocksAgreeWithTheWholeImage) {
    Progress quiet;
    for (const double offset : {0.0, 2.25, -1.5}) {
        Mask mask;
        mask.coverage = disc(300, 260, 80.4, 90.9, 33.3, false);
        const ImageF whole = signed_distance(mask.coverage);
        DistanceOptions options;
        options.reach_samples = 12;
        options.silhouette_offset_px = offset;
        const DistanceField field = distance_fields({view_of(mask)}, options, quiet).front();
        EXPECT_LT(field.silhouette.width, 120);
        const kernel::FieldView view = field.silhouette.view();
        for (int y = 0; y < 260; ++y)
            for (int x = 0; x < 300; ++x) {
                const double exact = whole.at(x, y) - offset;
                ASSERT_NEAR(field.silhouette.at(x, y), std::clamp(exact, -12.0, 12.0), 1.0 / 64) << x << " " << y;
                const double bound = kernel::distance_bound_px(view, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f, 50);
                if (bound > 0) {
                    ASSERT_LE(bound, exact);
                }
                if (bound < 0) {
                    ASSERT_GE(bound, exact);
                }
                // Not needlessly loose: two blocks and a pixel at most.
                if (std::fabs(exact) > 2 * kernel::kBlock_px * 1.4143 + 2) {
                    ASSERT_GT(std::fabs(bound), std::fabs(exact) - 2 * kernel::kBlock_px * 1.4143 - 2);
                }
            }
    }
}

// Far from a window whose object lies along two of its sides, neither way there adds to the other.
TEST(Distance, BoundsBeyondTheWindowHold) {
    Progress quiet;
    Mask mask;
    mask.coverage = Image8(900, 700);
    for (int y = 260; y < 640; ++y)
        for (int x = 300; x < 860; ++x)
            if (x > 830 || y > 610 || std::abs(y - 260 - (860 - x) * 2 / 3) < 4) mask.coverage.at(x, y) = 255;
    const ImageF whole = signed_distance(mask.coverage);
    DistanceOptions options;
    options.reach_samples = 20;
    const DistanceField field = distance_fields({view_of(mask)}, options, quiet).front();
    ASSERT_GT(field.silhouette.x0, 200);
    const kernel::FieldView view = field.silhouette.view();
    for (int y = 0; y < 700; y += 3)
        for (int x = 0; x < 900; x += 3) {
            const double bound = kernel::distance_bound_px(view, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f, 400), exact = whole.at(x, y);
            if (bound > 0) {
                ASSERT_LE(bound, exact + 1.0 / 64) << x << " " << y;
            }
            if (bound < 0) {
                ASSERT_GE(bound, exact - 1.0 / 64) << x << " " << y;
            }
        }
}

// Coarser samples keep the contour: a soft disc, 4 pixels to a sample.
TEST(Distance, CoarserSamplesStaySubPixel) {
    Progress quiet;
    Mask mask;
    mask.coverage = disc(403, 390, 201.7, 193.2, 141.3, false);
    DistanceOptions options;
    options.scale = 4;
    const DistanceField field = distance_fields({view_of(mask)}, options, quiet).front();
    double sum2 = 0;
    size_t n = 0;
    for (int y = 0; y < 97; ++y)
        for (int x = 0; x < 100; ++x) {
            const double exact = std::hypot(4 * (x + 0.5) - 201.7, 4 * (y + 0.5) - 193.2) - 141.3;
            if (std::fabs(exact) > 8) continue;
            sum2 += std::pow(4 * field.silhouette.at(x, y) - exact, 2);
            ++n;
        }
    EXPECT_LT(std::sqrt(sum2 / static_cast<double>(n)), 0.2);  // px; a twentieth of a sample
    options.conservative = true;
    const DistanceField grown = distance_fields({view_of(mask)}, options, quiet).front();
    for (int y = 0; y < 97; ++y)
        for (int x = 0; x < 100; ++x) ASSERT_LE(grown.silhouette.at(x, y), field.silhouette.at(x, y) + 1.0 / 64);
}

TEST(Distance, CrossingKeepsBothCentresOffTheContour) {
    for (int a = 0; a < 256; ++a)
        for (int b = 0; b < 256; ++b) {
            if ((a >= 128) == (b >= 128)) continue;
            const int t = kernel::crossing(static_cast<uint8_t>(a), static_cast<uint8_t>(b));
            ASSERT_GE(t, 1);
            ASSERT_LE(t, 63);
            // Rounding to 1/64 px, at the ends to the first or last step.
            ASSERT_NEAR(t / 64.0, (127.5 - a) / (b - a), 1.0 / 64 + 1e-12);
            ASSERT_LE(std::abs(t - (64 - kernel::crossing(static_cast<uint8_t>(b), static_cast<uint8_t>(a)))), 1);
        }
}

}  // namespace
}  // namespace vdbcarve::test
