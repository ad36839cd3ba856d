// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/app/watch.h"

#include <algorithm>
#include <chrono>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include "views/scene_path.h"
#include "image/image_io.h"
#include "base/text.h"
#include "views/view_called.h"
#include "vdbcarve/error.h"
#include "vdbcarve/video.h"

namespace vdbcarve {

namespace fs = std::filesystem;

namespace {

/// The files of some folders, and since when each has been as it is.
class Folders {
  public:
    Folders(std::vector<fs::path> roots, const fs::path& without, double settle_s)
        : roots_(std::move(roots)), without_(fs::weakly_canonical(without)), settle_s_(settle_s) {}

    /// now_s: of a clock that only ever goes on.
    void look(double now_s) {
        std::map<fs::path, File> seen;
        for (const fs::path& root : roots_) {
            std::error_code gone;  // files and folders may vanish under our eyes: then the next look is taken
            for (auto it = fs::recursive_directory_iterator(
                     root, fs::directory_options::follow_directory_symlink | fs::directory_options::skip_permission_denied, gone);
                 !gone && it != fs::recursive_directory_iterator(); it.increment(gone)) {
                std::error_code error;
                const fs::path path = fs::weakly_canonical(it->path(), error);
                if (error) continue;
                if (it->is_directory(error)) {
                    if (path == without_ || it.depth() > 3) it.disable_recursion_pending();
                    continue;
                }
                File file;
                file.size = it->file_size(error);
                if (!error) file.written = it->last_write_time(error);
                if (error) continue;
                const auto known = files_.find(path);
                if (known != files_.end() && known->second.size == file.size && known->second.written == file.written) {
                    file.since_s = known->second.since_s;
                    file.trouble = known->second.trouble;
                } else {
                    // What was here long before is whole at first sight; a clock that is ahead says nothing.
                    const double age_s = std::chrono::duration<double>(fs::file_time_type::clock::now() - file.written).count();
                    file.since_s = known == files_.end() && age_s > settle_s_ ? -std::numeric_limits<double>::infinity() : now_s;
                }
                seen.emplace(path, file);
            }
            if (gone) return;
        }
        files_ = std::move(seen);
        looked_s_ = now_s;
    }

    /// The photograph is whole, and so is what is called like it: its mask. One that lies elsewhere (a camera file may name it) is taken as it is.
    bool is_whole(const fs::path& photo) {
        std::error_code error;
        const fs::path path = fs::weakly_canonical(photo, error);
        const auto found = files_.find(path);
        if (found == files_.end()) return !error && !is_ours(path);
        if (found->second.size == 0 || !is_settled(found->second)) return false;
        const auto is_like_it = [&](const auto& f) { return f.first == path || is_called_like(f.first.filename().string(), photo); };
        if (std::any_of(files_.begin(), files_.end(), [&](const auto& f) { return is_like_it(f) && !is_settled(f.second); })) return false;
        bool whole = true;
        for (auto& f : files_) whole = (!is_like_it(f) || can_be_read(f.first, f.second)) && whole;
        return whole;
    }

    /// Why photographs that have settled are not taken, one sentence for each file; since forget_damaged().
    const std::set<std::string>& damaged() const { return damaged_; }
    void forget_damaged() { damaged_.clear(); }

    /// Of the files that have settled, by which a change shows.
    std::string state() const {
        std::string out;
        for (const auto& [path, file] : files_)
            if (is_settled(file)) out += path.string() + "|" + std::to_string(file.size) + "|" + std::to_string(file.written.time_since_epoch().count()) + "\n";
        return out;
    }
    size_t unsettled() const {
        return static_cast<size_t>(std::count_if(files_.begin(), files_.end(), [&](const auto& f) { return !is_settled(f.second); }));
    }

  private:
    struct File {
        uintmax_t size = 0;
        fs::file_time_type written;
        double since_s = 0;
        std::optional<std::string> trouble;  ///< why it cannot be read; empty: it can; none: not tried
    };
    /// A picture that ends early or is none would hold up all that come after it. Each is tried once.
    bool can_be_read(const fs::path& path, File& file) {
        if (!io::is_picture(path)) return true;
        if (!file.trouble) {
            try {
                io::read_image8(path);
                file.trouble = "";
            } catch (const InputError& e) {
                file.trouble = e.what();
            }
        }
        if (!file.trouble->empty()) damaged_.insert(*file.trouble);
        return file.trouble->empty();
    }
    bool is_settled(const File& file) const { return looked_s_ - file.since_s >= settle_s_; }
    bool is_ours(const fs::path& path) const {
        return std::any_of(roots_.begin(), roots_.end(),
                           [&](const fs::path& root) { return std::mismatch(root.begin(), root.end(), path.begin(), path.end()).first == root.end(); });
    }

    std::vector<fs::path> roots_;
    fs::path without_;
    double settle_s_;
    std::map<fs::path, File> files_;
    std::set<std::string> damaged_;
    double looked_s_ = 0;
};

}  // namespace

Reconstruction watch(const WatchOptions& options, Progress& progress) {
    const fs::path scene = options.reconstruct.views.scene;
    if (is_video(scene)) throw UsageError(scene.string() + ": is a film, all of which is there. Remedy: vdbcarve reconstruct");
    if (!fs::is_directory(scene)) throw InputError(scene.string() + ": there is no such folder to watch");
    if (!(options.settle_s >= 0) || !(options.poll_s > 0)) throw UsageError("watch: files settle in 0 s or more, and are looked at more than 0 s apart");
    std::vector<fs::path> roots{fs::canonical(scene)};
    const auto watch_too = [&](const fs::path& folder) {
        if (!folder.empty() && fs::is_directory(folder)) roots.push_back(fs::canonical(folder));
    };
    for (const fs::path& given : {options.reconstruct.views.images, options.reconstruct.mask.masks, options.reconstruct.mask.ignore_masks})
        watch_too(io::in_scene(given, scene));
    for (const fs::path& added : options.reconstruct.views.added) watch_too(added);
    Folders folder(roots, options.reconstruct.run.output, options.settle_s);
    ReconstructOptions job = options.reconstruct;
    job.views.added.insert(job.views.added.begin(), scene);
    job.views.allow_missing = job.mask.allow_missing = true;
    job.views.is_whole = [&](const fs::path& file) { return folder.is_whole(file); };

    Reconstruction result;
    std::optional<std::string> done;  ///< state of the folder that was tried last
    std::string waiting;              ///< for what, as it was said last
    std::exception_ptr trouble;       ///< of the last try
    size_t made = 0;
    const auto wait_for = [&](const std::string& what) {
        if (what != waiting) progress.note("waiting: " + what);
        waiting = what;
    };
    const auto in_trouble = [&](const Error& e) {
        trouble = std::current_exception();
        const size_t coming = folder.unsettled();
        wait_for(e.what() + (coming ? " (" + counted(coming, "file") + " still being written)" : std::string()));
    };
    // What stays out is said each time: somebody may be reading the last lines only.
    const auto say_what_is_out = [&](const Views& views) {
        for (const std::string& why : folder.damaged())
            progress.warn(why + "; its photograph is left out until it is whole. Remedy: copy it again, or take it away");
        if (!views.without_camera.empty())
            progress.warn(counted(views.without_camera.size(), "photograph") + " without a camera in " + views.camera_file.string() + ": " +
                          some_of(views.without_camera));
    };
    const auto step = [&] {
        ViewsOptions so_far = job.views;
        so_far.added = options.reconstruct.views.added;
        so_far.allow_unposed = true;
        so_far.units.clear();
        Progress quiet;
        folder.forget_damaged();
        try {
            const Views views = load_views(so_far, quiet);
            say_what_is_out(views);
            if (views.views.size() < options.first_views) {
                trouble = nullptr;
                wait_for(std::to_string(views.views.size()) + " of the first " + counted(options.first_views, "view") + " are here");
                return;
            }
        } catch (const InputError&) {
            say_what_is_out({});
            throw;
        }
        const double start_s = options.now_s();
        result = reconstruct(job, progress);
        trouble = nullptr;
        ++made;
        waiting.clear();
        progress.note(text_of("%s: result in %.1f s", counted(result.views, "view").c_str(), options.now_s() - start_s));
        if (!result.contradiction.empty()) progress.warn(result.contradiction);
        if (options.on_result) options.on_result(result);
    };
    /// Nothing more is expected: what is there, or what it lacks.
    const auto last_result = [&] {
        if (trouble) std::rethrow_exception(trouble);
        if (!made) throw InputError(scene.string() + ": nothing came (" + (waiting.empty() ? "no photograph" : waiting) + ")");
        const std::string so_far = options.reconstruct.run.output.string() + " is of " + counted(result.views, "view");
        if (!folder.damaged().empty())
            throw InputError(*folder.damaged().begin() + (folder.damaged().size() > 1 ? ", and " + std::to_string(folder.damaged().size() - 1) + " more" : "") +
                             ": left out to the end; " + so_far + ". Remedy: copy it again; another watch goes on from there");
        if (result.views < options.until_views)
            throw InputError(scene.string() + ": --until " + std::to_string(options.until_views) + ", and nothing came any more; " + so_far +
                             ". Remedy: a longer --idle; another watch goes on from there");
        return result;
    };
    double changed_s = options.now_s();
    for (;; options.sleep_s(options.poll_s)) {
        try {
            progress.check();
        } catch (const Interrupted&) {
            if (made) progress.note("stopped while waiting: " + options.reconstruct.run.output.string() + " is of " + counted(result.views, "view"));
            throw;
        }
        folder.look(options.now_s());
        const std::string state = folder.state();
        if (done != state) {
            done = state;
            try {
                step();
            } catch (const InputError& e) {
                in_trouble(e);
            } catch (const ContradictionError& e) {
                in_trouble(e);
            } catch (const UndeterminedError& e) {
                in_trouble(e);
            } catch (const fs::filesystem_error& e) {  // something was taken away while it was looked at
                in_trouble(InputError(e.what()));
            }
            changed_s = options.now_s();
            if (options.until_views && made && !trouble && result.views >= options.until_views) return result;
        }
        if (folder.unsettled()) changed_s = options.now_s();
        if (options.idle_s > 0 && options.now_s() - changed_s > options.idle_s) return last_result();
    }
}

}  // namespace vdbcarve
