// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/align.h"

#include "align/align_options.h"
#include "align/align_scale.h"
#include "align/alignment.h"
#include "align/mat/align_mat.h"
#include "vdbcarve/error.h"

namespace vdbcarve {

AlignResult Alignment::run() {
    progress_.begin("align", 12);
    out_.method = o_.method;
    find();
    out_.mask_noise_px = aligner_.mask_noise_px();
    if (o_.method == AlignMethod::Paper) {
        out_.aligned = judged();
        progress_.step(3);
    } else {
        name_bad();
        disturb();
        hold_unobservable();
        find_symmetry();
    }
    describe();
    judge();
    progress_.step(1);
    return std::move(out_);
}

AlignResult align(const Views& views, const std::vector<MaskView>& masks, const AlignOptions& options, Progress& progress) {
    check_align_options(options, views, masks.size());
    if (options.known_length) check_known_length(views, masks, *options.known_length);
    AlignResult out = options.method == AlignMethod::Mat ? align_to_mat(views, options, progress) : Alignment(views, masks, options, progress).run();
    try {
        apply_scale(out, masks, options, progress);
    } catch (const Interrupted&) {
        throw;
    } catch (const Error& e) {
        if (out.failures.empty()) throw;
        // Of cameras that are not believed no length need be had; what is wrong with them is said first.
        out.failures.push_back(std::string("no scale: ") + e.what());
        if (out.method != AlignMethod::Refine) out.views.units.clear();
    }
    out.views.unverified = out.failures;
    return out;
}

}  // namespace vdbcarve
