// SPDX-License-Identifier: Apache-2.0
#include "fair/cpu_engine.h"

namespace vdbcarve::fairing {

CpuEngine::CpuEngine(const openvdb::FloatGrid& hull, const FairEvidence* evidence) : hull_(hull), hulls_{level_of(hull)} {
    find_least(hulls_[0], hulls_[0].hull);
    if (evidence) evidence_.emplace(*evidence);
}

void CpuEngine::coarsen(bool whole) {
    hulls_.push_back(coarser(hulls_.back(), whole));
    if (evidence_) evidence_->coarsen();
}

void CpuEngine::begin() {
    level_ = std::move(hulls_.back());
    hulls_.pop_back();
    level_.field = level_.hull;
    if (evidence_) evidence_->begin(level_);
}

void CpuEngine::begin(const openvdb::FloatGrid& surface) {
    level_ = with_field(hulls_.back(), surface);
    hulls_.pop_back();
}

void CpuEngine::refine() {
    lines_.reset();
    Level finer = carried_over(hulls_.back(), level_);
    coarse_ = std::move(level_);
    level_ = std::move(finer);
    hulls_.pop_back();
}

void CpuEngine::aim(const SightPlan& plan, Progress& progress) {
    lines_ = std::make_unique<SightLines>(level_, coarse_.leaves() ? &coarse_ : nullptr, plan, progress);
}

void CpuEngine::ease(float far_vox) {
    level_.for_voxels([&](size_t at) { level_.field.of[at] = kernel::eased(level_.field.of[at], level_.hull.of[at], far_vox); });
}

void CpuEngine::make_distances() {
    fairing::make_distances(level_, level_.field.of);
    level_.for_voxels([&](size_t at) { level_.field.of[at] = kernel::max_f(level_.field.of[at], level_.hull.of[at]); });
}

}  // namespace vdbcarve::fairing
