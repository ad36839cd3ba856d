// SPDX-License-Identifier: Apache-2.0
// MATLAB's .mat with 3x4 projection matrices: a cell array of them, an array 3x4xN, or variables of 3x4 each.
#include <matio.h>

#include <algorithm>
#include <memory>

#include "views/formats/camera_formats.h"

namespace vdbcarve::io {
namespace {

struct Close {
    void operator()(mat_t* m) const { Mat_Close(m); }
    void operator()(matvar_t* v) const { Mat_VarFree(v); }
};

bool is_double(const matvar_t* v) { return v && v->class_type == MAT_C_DOUBLE && !v->isComplex && v->data && v->data_type == MAT_T_DOUBLE; }
bool is_matrix(const matvar_t* v) { return is_double(v) && v->rank == 2 && v->dims[0] == 3 && v->dims[1] == 4; }

Mat34d matrix_at(const matvar_t* v, size_t n) {
    return Eigen::Map<const Eigen::Matrix<double, 3, 4>>(static_cast<const double*>(v->data) + 12 * n);  // column after column, like MATLAB's
}

std::vector<NamedProjection> matrices_in(const fs::path& file) {
    Mat_LogInit(nullptr);  // what is wrong is said by us
    const std::unique_ptr<mat_t, Close> in(Mat_Open(file.c_str(), MAT_ACC_RDONLY));
    if (!in) return {};
    std::vector<NamedProjection> cells, named;
    while (const auto v = std::unique_ptr<matvar_t, Close>(Mat_VarReadNext(in.get()))) {
        if (v->class_type == MAT_C_CELL && v->data && v->rank == 2 && std::min(v->dims[0], v->dims[1]) == 1) {
            const size_t n = v->dims[0] * v->dims[1];
            auto* const* parts = static_cast<matvar_t**>(v->data);
            if (cells.empty() && n > 0 && std::all_of(parts, parts + n, is_matrix))
                for (size_t i = 0; i < n; ++i) cells.push_back({"", matrix_at(parts[i], 0)});
        } else if (is_double(v.get()) && v->rank == 3 && v->dims[0] == 3 && v->dims[1] == 4) {
            if (cells.empty())
                for (size_t i = 0; i < v->dims[2]; ++i) cells.push_back({"", matrix_at(v.get(), i)});
        } else if (is_matrix(v.get())) {
            named.push_back({v->name ? v->name : "", matrix_at(v.get(), 0)});
        }
    }
    if (!cells.empty()) return cells;
    // In the natural order of their names, which are not the images'.
    std::sort(named.begin(), named.end(), [](const NamedProjection& a, const NamedProjection& b) { return natural_less(a.name, b.name); });
    for (NamedProjection& p : named) p.name.clear();
    return named;
}

}  // namespace

bool understands_matlab(const fs::path& file) { return fs::is_regular_file(file) && file.extension() == ".mat" && !matrices_in(file).empty(); }

Imported read_matlab(const fs::path& file) { return imported_projections(file, matrices_in(file)); }

}  // namespace vdbcarve::io
