// SPDX-License-Identifier: Apache-2.0
// Silhouettes that contradict the others.
#include "align/alignment.h"

#include <algorithm>
#include <map>

#include "align/align_scale.h"
#include "base/statistics.h"
#include "mask/mask_consensus.h"
#include "vdbcarve/error.h"

namespace vdbcarve {
namespace {

constexpr size_t kLeastVoters = 12;  ///< silhouettes, for one to be outvoted by the rest

}  // namespace

void Alignment::name_bad() {
    out_.aligned = judged();
    std::vector<size_t> bad = judge_.contradicting(out_.aligned, {}, c_.misses > 0);
    const auto fits = [](const AlignedView& v) { return v.residual_px < 1 && v.dissent < 0.004; };
    for (int round = 0; round < 6 && !bad.empty(); ++round) {
        for (size_t i : bad) silhouettes_.set_bad(i, true);
        aligner_.settle(c_);
        // Judged anew with all of them: others may fit now, or turn out to be wrong.
        for (size_t i : silhouettes_.seen()) silhouettes_.set_bad(i, false);
        out_.aligned = judged();
        // What contradicts the rest without having taken part stays out.
        std::erase_if(bad, [&](size_t i) { return fits(out_.aligned[i]); });
        const std::vector<size_t> now = judge_.contradicting(out_.aligned, bad, c_.misses > 0);
        const bool settled = now == bad;
        bad = now;
        if (settled) break;
    }
    if (!bad.empty() || c_.misses > 0) {
        for (size_t i : bad) silhouettes_.set_bad(i, true);
        c_.misses = 0;
        aligner_.settle(c_);
        // One that is wrong draws touches away from where they belong, and its neighbours seem wrong too: each is asked alone, now that cameras are better.
        // Who fits was named for nothing, and with it back in its place the next may fit.
        std::map<size_t, double> dissent;
        while (!bad.empty()) {
            const std::vector<size_t> named = bad;
            dissent.clear();
            for (size_t i : named) {
                silhouettes_.set_bad(i, false);
                const AlignedView alone = judged()[i];
                silhouettes_.set_bad(i, true);
                if (fits(alone)) std::erase(bad, i);
                else dissent[i] = alone.dissent;
            }
            if (bad.size() == named.size()) break;
            for (size_t i : named) silhouettes_.set_bad(i, std::find(bad.begin(), bad.end(), i) != bad.end());
            aligner_.settle(c_);
        }
        out_.aligned = judged();
        for (const auto& [i, share] : dissent) out_.aligned[i].dissent = share;
    }
    name_holes();
    if (o_.method == AlignMethod::Coherence && c_.orbit != Orbit::Turntable) move_strays();
    progress_.step(1);
}

void Alignment::move_strays() {
    std::vector<size_t> strays = silhouettes_.good();
    const size_t views = strays.size();
    std::vector<double> own;
    for (size_t i : strays) own.push_back(out_.aligned[i].residual_px);
    const double limit_px = std::max(0.1, 4 * median(own));
    std::erase_if(strays, [&](size_t i) { return !(out_.aligned[i].residual_px > limit_px); });
    if (strays.empty() || 6 * strays.size() > views) return;
    Candidate anew = c_;
    for (size_t i : strays) silhouettes_.set_bad(i, true);
    aligner_.settle(anew);
    for (size_t i : strays) silhouettes_.set_bad(i, false);
    aligner_.polish(anew);
    aligner_.trace("%zu strays started anew: %.4f px, before %.4f", strays.size(), anew.rms_px(), c_.rms_px());
    if (anew.rms_px() > 0.8 * c_.rms_px()) return;
    c_ = anew;
    out_.aligned = judged();
}

void Alignment::name_holes() {
    const std::vector<size_t>& seen = silhouettes_.seen();
    if (seen.size() < kLeastVoters || c_.rms_px() > 0.01 * silhouettes_.size_px()) return;
    const std::vector<MaskView> trusted = trusted_masks(out_, masks_);
    Progress quiet;
    std::vector<Consensus> said;
    try {
        said = consensus_of(given_.names(), with_cameras(given_, c_.fit.model).cameras(), trusted, trusted, 1, quiet);
    } catch (const Interrupted&) {
        throw;
    } catch (const Error&) {
        return;  // there is no hull, or it has no bounds; other tests say why
    }
    std::vector<size_t> holed;
    for (size_t i : seen) {
        if (said[i].carved_px > 0) aligner_.trace("%zu carves alone: %.0f of 250 x 250", i, said[i].carved_px);
        if (said[i].carved_px >= Consensus::kLeast_px) holed.push_back(i);
    }
    if (holed.empty()) return;
    if (4 * holed.size() > seen.size()) {  // no mistake of single ones
        out_.failures.push_back(
            text_of("%zu of %zu silhouettes each call background what nearly all others keep: %s. Remedy: is it one of these? Several rings or sittings "
                    "(--rings, --sittings), masks of different objects, holes in most masks",
                    holed.size(), seen.size(), some_of(names_of(holed)).c_str()));
        return;
    }
    for (size_t i : holed) silhouettes_.set_bad(i, true);
    aligner_.settle(c_);
    out_.aligned = judged();
}

}  // namespace vdbcarve
