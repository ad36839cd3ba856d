// SPDX-License-Identifier: Apache-2.0
// 3x4 projection matrices as text: one `.pa` file a view, or one text file with 12 numbers a view.
#include <algorithm>
#include <cmath>

#include "views/formats/camera_formats.h"

namespace vdbcarve::io {
namespace {

std::vector<double> numbers_in(const fs::path& file) {
    std::istringstream in(read_text(file));
    std::vector<double> out;
    std::string word;
    while (in >> word) {
        out.push_back(number_in(word, file.string() + " (rows of 3x4 matrices)"));
    }
    return out;
}

std::vector<fs::path> pa_files(const fs::path& folder) {
    std::vector<fs::path> out;
    for (const auto& entry : fs::directory_iterator(folder))
        if (entry.is_regular_file() && entry.path().extension() == ".pa") out.push_back(entry.path());
    std::sort(out.begin(), out.end(), [](const fs::path& a, const fs::path& b) { return natural_less(a.string(), b.string()); });
    return out;
}

}  // namespace

bool understands_projections(const fs::path& candidate) {
    if (fs::is_directory(candidate)) return !pa_files(candidate).empty();
    if (!fs::is_regular_file(candidate)) return false;
    if (candidate.extension() == ".pa") return true;
    if (candidate.extension() != ".txt") return false;
    try {
        const size_t n = numbers_in(candidate).size();
        return n > 0 && n % 12 == 0;
    } catch (const Error&) {
        return false;
    }
}

Imported read_projections(const fs::path& candidate) {
    std::vector<NamedProjection> matrices;
    const auto to_matrix = [](const double* v) {
        Mat34d p;
        for (int i = 0; i < 12; ++i) p(i / 4, i % 4) = v[i];
        return p;
    };
    if (fs::is_regular_file(candidate) && candidate.extension() == ".txt") {
        const std::vector<double> v = numbers_in(candidate);
        // No names in such a file: images in natural order are matrices in order (resolved by load_views).
        for (size_t i = 0; i + 12 <= v.size(); i += 12) matrices.push_back({"", to_matrix(&v[i])});
    } else {
        const fs::path folder = fs::is_directory(candidate) ? candidate : candidate.parent_path();
        for (const fs::path& file : pa_files(folder)) {
            const std::vector<double> v = numbers_in(file);
            if (v.size() != 12) throw InputError(file.string() + ": has " + std::to_string(v.size()) + " numbers, a 3x4 matrix has 12");
            matrices.push_back({file.stem().string(), to_matrix(v.data())});
        }
    }
    return imported_projections(candidate, matrices);
}

Imported imported_projections(const fs::path& file, std::vector<NamedProjection> matrices) {
    Imported out;
    out.integer_pixel_centres = true;
    std::vector<DecomposedProjection> parts;
    for (const NamedProjection& m : matrices) {
        try {
            parts.push_back(decompose_projection(m.projection));
        } catch (const Error& e) {
            throw InputError(file.string() + ": view " + m.name + ": " + e.what());
        }
    }
    const auto cameras_of = [&] {
        std::vector<Camera> cameras;
        for (const DecomposedProjection& d : parts) {
            Camera c;
            c.camera_from_world = d.camera_from_world;
            cameras.push_back(c);
        }
        return cameras;
    };
    // P is known up to sign only. decompose_projection chose det R = +1; if what all cameras look at then
    // lies behind them, the world itself is left-handed: mirror it (negate z) and decompose again.
    if (const std::optional<Vec3d> target = look_at_point(cameras_of())) {
        size_t behind = 0;
        for (const DecomposedProjection& d : parts) behind += (d.camera_from_world * *target).z() < 0;
        if (behind * 2 > parts.size()) {
            for (size_t i = 0; i < matrices.size(); ++i) {
                matrices[i].projection.col(2) *= -1;
                parts[i] = decompose_projection(matrices[i].projection);
            }
            out.warnings.push_back("the world of these projection matrices is left-handed (mirrored); z was negated to mirror it back");
        }
    } else {
        out.notes.push_back("all optical axes are parallel: whether this world is mirrored cannot be told");
    }
    for (size_t i = 0; i < matrices.size(); ++i) {
        ImportedView v;
        v.view.name = matrices[i].name;
        const Mat3d& k = parts[i].k;
        v.view.camera.intrinsics = {k(0, 0), k(1, 1), k(0, 1), k(0, 2), k(1, 2), 0, 0, false};
        v.view.camera.camera_from_world = parts[i].camera_from_world;
        out.views.push_back(v);
        // A camera of glass has nearly square pixels and hardly any skew; matrices from a projective
        // reconstruction have neither, and no distances in their world.
        const double aspect = k(0, 0) / k(1, 1);
        if (aspect < 0.7 || aspect > 1.4 || std::abs(k(0, 1)) > 0.1 * k(0, 0)) out.metric = false;
    }
    return out;
}

}  // namespace vdbcarve::io
