// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/repair.h"

#include "image/image_io.h"
#include "mask/mask_consensus.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace {

std::vector<size_t> broken_masks(const Shoot& shoot, const Silhouettes& masks, Progress& progress) {
    return find_broken_masks(shoot.views.names(), shoot.views.cameras(), used_mask_views(shoot, masks), progress);
}

}  // namespace

void warn_of_broken_masks(const Shoot& shoot, const Silhouettes& masks, Progress& progress) {
    std::vector<std::string> names;
    for (const size_t i : broken_masks(shoot, masks, progress)) names.push_back(shoot.views.views[i].name);
    if (!names.empty())
        progress.warn(counted(names.size(), "mask") + " against all others: " + some_of(names) +
                      ". Where such a mask is wrong, the object loses what it leaves out. Remedy: look at " + (names.size() == 1 ? "it" : "them") +
                      ", and mend or delete what is wrong, or --repair-masks");
}

Silhouettes RepairMasks::run(Run& run) {
    Progress& progress = run.progress();
    Silhouettes out = masks;
    for (const size_t i : broken_masks(shoot, masks, progress)) {
        if (masks.edited[i].empty()) mended_.push_back(i);
        else
            progress.warn(masks.edited[i].string() +
                          ": is against all others, but was edited by hand and is left as it is. Remedy: delete it to have it made again");
    }
    if (mended_.empty()) return out;
    std::vector<Mask> used(shoot.views.views.size());
    for (const size_t u : masks.used) used[u] = masks.masks.masks[u];
    Progress quiet;
    const std::vector<std::string> done = repair_masks(
        shoot.views.names(), shoot.views.cameras(), used, mended_, [&](size_t i) { return photo_to_show(shoot.views.views[i], progress); }, quiet);
    progress.warn(counted(mended_.size(), "mask") + " against all others, mended: " + some_of(done) + ". Remedy: look at " + (run.out() / "masks").string());
    for (const size_t i : mended_) {
        out.masks.masks[i] = std::move(used[i]);
        out.masks.origins[i] += " (repaired)";
    }
    return out;
}

void RepairMasks::save(Slot& slot, Silhouettes& made) const {
    for (const size_t i : mended_) {
        const std::string stem = std::to_string(i);
        const Mask& mask = made.masks.masks[i];
        if (!mask.coverage.empty()) io::write_png(slot.file(stem + ".png"), mask.coverage);
        if (!mask.ignore.empty()) io::write_png(slot.file(stem + "_ignore.png"), mask.ignore);
        made.files[i] = slot.later(stem + ".png");
    }
    slot.note = {{"views", mended_}};
}

Silhouettes RepairMasks::load(const Slot& slot) const {
    Silhouettes out = masks;
    for (const size_t i : slot.note.at("views").get<std::vector<size_t>>()) {
        const auto take = [&](const char* what) {
            const std::string name = std::to_string(i) + what;
            return slot.has(name) ? io::read_image8(slot.file(name)) : Image8();
        };
        out.masks.masks.at(i) = {take(".png"), take("_ignore.png")};
        out.masks.origins[i] += " (repaired)";
        out.files[i] = slot.file(std::to_string(i) + ".png");
    }
    return out;
}

}  // namespace vdbcarve::pipeline
