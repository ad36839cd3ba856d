// SPDX-License-Identifier: Apache-2.0
#include "pipeline/stages/mask.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <map>

#include "base/atomic_file.h"
#include "image/image_io.h"
#include "pipeline/placed_masks.h"
#include "pipeline/stages/views.h"
#include "base/text.h"

namespace vdbcarve::pipeline {

namespace fs = std::filesystem;
using nlohmann::json;

void MakeMasks::prepare(Run& run) {
    const size_t n = shoot.views.views.size();
    Silhouettes& s = known_;
    s.names = mask_names(shoot.views);
    s.edited = edited_masks(run.out(), s.names, run.progress());
    s.file_hashes.resize(n);
    s.inputs.assign(n, json::object());
    tbb::parallel_for(size_t{0}, n, [&](size_t i) {
        const View& view = shoot.views.views[i];
        std::vector<fs::path> files = mask_files(view, shoot.folder, options);
        if (!s.edited[i].empty()) files.push_back(s.edited[i]);
        if (!view.image_path.empty() && files.front() != view.image_path) files.push_back(view.image_path);
        Sha256 all;
        for (const fs::path& file : files) {
            const std::string hash = sha256_of_file(file);
            all.add(hash);
            s.inputs[i][file.string()] = hash;
        }
        s.file_hashes[i] = all.hex();
    });
    Sha256 everything;  // it stands in volume.vdb, so no version of the code is part of it
    for (size_t i = 0; i < n; ++i) {
        everything.add(s.file_hashes[i]);
        add_camera(everything, shoot.views.views[i].camera);
    }
    s.inputs_sha256 = everything.hex();
    if (fs::is_regular_file(shoot.views.camera_file)) s.camera_file_sha256 = sha256_of_file(shoot.views.camera_file);
}

Key MakeMasks::key_of_view(size_t i, const MaskOptions& settled) const {
    const View& v = shoot.views.views[i];
    MaskOptions of_one = settled;
    of_one.repair = false;  // a stage of its own
    Key key(kName);
    key.of(of_one).of(v.name).of(known_.file_hashes[i]).of(v.orientation).of(v.lens.model).of(!known_.edited[i].empty());
    for (const double c : v.lens.coefficients) key.of(c);
    if (v.lens.distorts()) key.of(v.camera);
    return key.of(v.camera.intrinsics.width_px).of(v.camera.intrinsics.height_px);
}

Key MakeMasks::key() const {
    Key key(kName);
    for (size_t i = 0; i < shoot.views.views.size(); ++i) key.of(key_of_view(i, options).hex());
    return key;
}

std::vector<std::optional<KnownMask>> MakeMasks::known_masks(const Store& store) const {
    struct Place {
        const Slot* slot;
        size_t number;
        bool ignores;
        std::string origin;
    };
    const std::vector<Slot> slots = store.all(kName);
    std::map<std::string, Place> places;
    for (const Slot& slot : slots) try {
            const auto theirs = slot.note.at("keys").get<std::vector<std::string>>(), origins = slot.note.at("origins").get<std::vector<std::string>>();
            const auto ignores = slot.note.at("ignores").get<std::vector<bool>>();
            for (size_t i = 0; i < theirs.size(); ++i) places[theirs[i]] = {&slot, i, ignores.at(i), origins.at(i)};
        } catch (const std::exception&) {
            // A note of another form.
        }
    std::vector<std::optional<KnownMask>> out(view_keys_.size());
    tbb::parallel_for(size_t{0}, view_keys_.size(), [&](size_t i) {
        const auto found = places.find(view_keys_[i]);
        if (found == places.end()) return;
        const auto& [slot, number, ignores, origin] = found->second;
        const std::string coverage = std::to_string(number) + ".png", ignore = std::to_string(number) + "_ignore.png";
        // One that was left out is made, and left out, again; so is one that was damaged.
        if (!slot->has(coverage) || !store.is_whole(*slot, coverage) || (ignores && !store.is_whole(*slot, ignore))) return;
        try {
            out[i] = KnownMask{{io::read_image8(slot->file(coverage)), ignores ? io::read_image8(slot->file(ignore)) : Image8()}, origin};
        } catch (const InputError&) {
            // Damaged: it is made again.
        }
    });
    return out;
}

Silhouettes MakeMasks::run(Run& run) {
    MaskOptions cached = options;
    if (run.is_open()) cached.cache = run.store().folder() / "mask_command";
    const MaskOptions settled = settle(shoot.views, cached, known_.edited, run.progress());
    view_keys_.resize(shoot.views.views.size());
    for (size_t i = 0; i < view_keys_.size(); ++i) {
        Key key = key_of_view(i, settled);
        for (const auto& [path, hash] : known_.inputs[i].items()) key.of(path);  // two photographs may be alike; their masks' origins are not
        view_keys_[i] = key.hex();
    }
    Silhouettes made = known_;
    made.masks = make_masks(shoot.views, shoot.folder, settled, known_.edited, run.progress(),
                            run.is_open() ? known_masks(run.store()) : std::vector<std::optional<KnownMask>>());
    made.files.resize(view_keys_.size());
    return made;
}

void MakeMasks::save(Slot& slot, Silhouettes& made) const {
    tbb::parallel_for(size_t{0}, made.masks.masks.size(), [&](size_t i) {
        const Mask& mask = made.masks.masks[i];
        const std::string stem = std::to_string(i);
        if (mask.coverage.empty()) return;
        io::write_png(slot.file(stem + ".png"), mask.coverage);
        made.files[i] = slot.later(stem + ".png");
        if (!mask.ignore.empty()) io::write_png(slot.file(stem + "_ignore.png"), mask.ignore);
    });
    std::vector<bool> ignores;
    for (const Mask& mask : made.masks.masks) ignores.push_back(!mask.coverage.empty() && !mask.ignore.empty());
    slot.note = {{"origins", made.masks.origins}, {"left_out", made.masks.left_out}, {"keys", view_keys_}, {"ignores", ignores}, {"inputs", made.inputs}};
}

Silhouettes MakeMasks::load(const Slot& slot) const {
    const size_t n = shoot.views.views.size();
    Silhouettes found = known_;
    found.masks.origins = slot.note.at("origins").get<std::vector<std::string>>();
    found.masks.left_out = slot.note.at("left_out").get<std::vector<size_t>>();
    // The same files may lie elsewhere by now.
    const auto& then = slot.note.at("inputs");
    for (size_t i = 0; i < n; ++i)
        for (const auto& [was, hash] : then.at(i).items())
            for (const auto& [path, now] : known_.inputs[i].items())
                if (const size_t at = found.masks.origins.at(i).find(was); now == hash && at != std::string::npos) {
                    found.masks.origins[i].replace(at, was.size(), path);
                    break;
                }
    found.masks.masks.resize(n);
    found.files.resize(n);
    tbb::parallel_for(size_t{0}, n, [&](size_t i) {
        const std::string stem = std::to_string(i);
        if (!slot.has(stem + ".png")) return;
        found.files[i] = slot.file(stem + ".png");
        found.masks.masks[i].coverage = io::read_image8(found.files[i]);
        if (slot.has(stem + "_ignore.png")) found.masks.masks[i].ignore = io::read_image8(slot.file(stem + "_ignore.png"));
    });
    return found;
}

void MakeMasks::report(const Silhouettes& made, json& report) const {
    for (size_t i = 0; i < made.inputs.size(); ++i) report["inputs"][shoot.views.views[i].name]["sha256"] = made.inputs[i];
    if (!made.camera_file_sha256.empty()) report["camera_file_sha256"] = made.camera_file_sha256;
}

std::vector<size_t> choose_used(const ReconstructOptions& options, const Shoot& shoot, const Silhouettes& masks, Progress& progress) {
    const Views& views = shoot.views;
    const std::set<size_t> without(masks.masks.left_out.begin(), masks.masks.left_out.end());
    const bool all = options.run.last_stage == LastStage::Mask || (finds_cameras(options, views) && !shoot.alignment);
    std::vector<size_t> used;
    std::vector<std::string> unused;
    for (size_t i = 0; i < views.views.size(); ++i) {
        const View& v = views.views[i];
        if (without.count(i)) continue;
        if (v.unused.empty() || all) used.push_back(i);
        else unused.push_back(v.name + " (" + v.unused + ")");
    }
    if (used.empty()) throw InputError(views.camera_file.string() + ": no view is left to carve with");
    if (!unused.empty() && !shoot.alignment)  // align() has said it
        progress.warn(counted(unused.size(), "view") + " not used, as " + views.camera_file.string() + " says: " + some_of(unused) +
                      ". Remedy: mend the masks and align again");
    return used;
}

}  // namespace vdbcarve::pipeline
