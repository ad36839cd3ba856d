// SPDX-License-Identifier: Apache-2.0
#include "vdbcarve/app/pictures.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>

#include "base/atomic_file.h"
#include "image/image_io.h"
#include "base/text.h"
#include "views/view_called.h"
#include "vdbcarve/caps.h"
#include "vdbcarve/device.h"
#include "vdbcarve/error.h"
#include "vdbcarve/file_frame.h"
#include "vdbcarve/volume.h"
#include "vdbcarve/result.h"
#include "vdbcarve/raster.h"
#include "vdbcarve/color_space.h"
#include "vdbcarve/video.h"
#include "vdbcarve/views.h"

namespace vdbcarve {
namespace {

namespace fs = std::filesystem;

bool is_volume(const fs::path& file) { return file.extension() == ".vdb" || file.extension() == ".nvdb"; }
bool is_film(const fs::path& file) { return file.extension() == ".mp4" || file.extension() == ".webm"; }

/// Slack as colours, linear light: clay where there is none, dark red for `most` and more.
openvdb::Vec3SGrid::Ptr slack_colors(const openvdb::FloatGrid& slack, double& most) {
    constexpr double kAlmostAll = 0.98;  // a few places would take all the colours
    constexpr double kStops_srgb[][3] = {{196, 196, 200}, {248, 208, 96}, {232, 108, 48}, {136, 16, 56}};
    constexpr size_t kSteps = std::size(kStops_srgb) - 1;
    std::vector<float> values;
    for (auto v = slack.cbeginValueOn(); v; ++v) values.push_back(*v);
    if (!values.empty()) {
        const auto at = values.begin() + static_cast<long>(kAlmostAll * static_cast<double>(values.size() - 1));
        std::nth_element(values.begin(), at, values.end());
        most = static_cast<double>(*at);
    }
    auto out = openvdb::Vec3SGrid::create(std::make_shared<openvdb::Vec3STree>(slack.tree(), openvdb::Vec3s(0), openvdb::TopologyCopy()));
    out->setTransform(slack.transform().copy());
    const auto values_of = slack.getConstAccessor();
    for (auto v = out->beginValueOn(); v; ++v) {
        const double share = most > 0 ? std::clamp(static_cast<double>(values_of.getValue(v.getCoord())) / most, 0.0, 1.0) * kSteps : 0;
        const size_t step = std::min(static_cast<size_t>(share), kSteps - 1);
        const double part = share - static_cast<double>(step);
        openvdb::Vec3s color;
        for (int c = 0; c < 3; ++c)
            color[c] = static_cast<float>(linear_from_srgb((kStops_srgb[step][c] + part * (kStops_srgb[step + 1][c] - kStops_srgb[step][c])) / 255));
        v.setValue(color);
    }
    return out;
}

class PictureRun {
  public:
    PictureRun(const PictureRequest& request, Progress& progress) : request_(request), progress_(progress), options_(request.options) {}

    PictureSummary run() {
        check();
        load();
        if (request_.options.style == RenderStyle::Slice) slices();
        else if (is_film(request_.output)) film();
        else if (request_.sheet > 0) sheet();
        else if (!request_.view.empty()) save(picture(view_camera(view_called_by_user())));
        else save(picture(orbit_camera(bounds_, up_, request_.orbit)));
        return summary_;
    }

  private:
    void check() {
        const std::string e = request_.output.extension().string();
        if (e != ".png" && !is_film(request_.output))
            throw UsageError(request_.output.string() + ": the extension says what to make: .png, or .mp4 or .webm (a film)");
        if (!fs::exists(request_.input)) throw InputError(request_.input.string() + ": no such file or folder");
        if (is_film(request_.output) && (request_.sheet > 0 || !request_.view.empty() || options_.style == RenderStyle::Slice))
            throw UsageError(request_.output.string() + ": a film is one turn around the object; a view, a sheet and slices are pictures. Remedy: -o FILE.png");
        if (request_.sheet > 0 && !request_.view.empty()) throw UsageError("--sheet and --view: give one of them");
        if (request_.frames < 2 || request_.frames > 100000 || !(request_.rate_hz > 0 && request_.rate_hz <= 240))
            throw UsageError("--frames must be 2..100000, --rate above 0 and at most 240");
        if (is_film(request_.output) && !options_.background)
            throw UsageError(request_.output.string() + ": a film has no transparency. Remedy: another --background");
        if (is_film(request_.output) && (request_.orbit.width_px % 2 || request_.orbit.height_px % 2))
            throw UsageError(request_.output.string() + ": sides of a film must be even. Remedy: --size");
    }

    void load() {
        fs::path source = request_.input;
        const bool result = fs::is_directory(source);
        if (result) {
            require_finished(source);
            std::vector<const char*> names{"volume.vdb", "hull.vdb"};
            if (request_.mesh) names = {"mesh.ply", "mesh.glb", "mesh.obj", "mesh.stl"};
            const auto found = std::find_if(names.begin(), names.end(), [&](const char* n) { return fs::exists(request_.input / n); });
            if (found == names.end())
                throw InputError(request_.input.string() + ": holds no " + (request_.mesh ? "mesh" : "volume") +
                                 " of vdbcarve's. Remedy: `vdbcarve reconstruct` makes one");
            source /= *found;
        }
        // A result's files lie to its cameras as its report says.
        if (const fs::path folder = result ? request_.input : source.parent_path(); fs::exists(folder / "report.json")) {
            frame_ = frame_from_scene(folder, source.filename().string());
            folder_ = folder.empty() ? fs::path(".") : folder;
        }
        std::string up = request_.up;
        if (is_volume(source)) {
            openvdb::MetaMap metadata;
            const openvdb::GridPtrVec grids = source.extension() == ".nvdb" ? read_nvdb(source) : read_vdb(source, &metadata);
            openvdb::FloatGrid::Ptr surface;
            openvdb::Vec3SGrid::Ptr color;
            for (const openvdb::GridBase::Ptr& grid : grids) {
                if (!surface && grid->isType<openvdb::FloatGrid>() && grid->getGridClass() == openvdb::GRID_LEVEL_SET)
                    surface = openvdb::gridPtrCast<openvdb::FloatGrid>(grid);
                if (!color && grid->isType<openvdb::Vec3SGrid>() && (grid->getName() == "color" || grid->getName() == "Cd"))
                    color = openvdb::gridPtrCast<openvdb::Vec3SGrid>(grid);
            }
            if (!surface) throw InputError(source.string() + ": has no level set to render");
            if (request_.slack) {
                const auto slack =
                    std::find_if(grids.begin(), grids.end(), [](const auto& g) { return g->getName() == "slack" && g->template isType<openvdb::FloatGrid>(); });
                if (slack == grids.end())
                    throw InputError(source.string() + ": has no grid \"slack\". Remedy: reconstruct with --surface fair, which writes it into volume.vdb");
                color = slack_colors(*openvdb::gridPtrCast<openvdb::FloatGrid>(*slack), summary_.most_slack);
            }
            if (const auto said = metadata["up_axis"]; up.empty() && said && said->str() != "unknown") up = said->str();
            bounds_ = box_of_inside(*surface);
            const Backend backend = choose_backend(request_.backend, request_.device);
            summary_.backend_used = name_of(backend);
            if (backend == Backend::Cuda) {
                device_.emplace(request_.device);
                device_->set_surface(*surface);
                if (color) device_->set_colors(*color);
            } else {
                volume_.emplace(*surface, color.get());
            }
        } else {
            if (options_.style != RenderStyle::Surface || request_.slack)
                throw UsageError(source.string() + ": a mesh has no voxels, no thickness and no sections, and its slack is not drawn. Remedy: the volume");
            if (request_.backend == Backend::Cuda) throw UsageError("--backend cuda: meshes are rendered on the CPU. Remedy: without it, or the volume");
            mesh_ = read_mesh(source);
            if (mesh_.triangles.empty()) throw InputError(source.string() + ": has no faces");
            for (const auto& v : mesh_.vertices) bounds_.extend(Vec3d(v[0], v[1], v[2]));
            if (up.empty() && (source.extension() == ".glb" || source.extension() == ".obj")) up = "y";
            summary_.backend_used = "cpu";
        }
        if (!up.empty()) up_ = Vec3d::Unit(up.back() - 'x') * (up.front() == '-' ? -1 : 1);
        else if (!folder_.empty() && fs::exists(folder_ / "cameras.json")) up_ = up_direction("", file_cameras());  // the axis that the cameras stand around
        options_.up = up_;
    }

    const Views& views() {
        if (!views_.views.empty()) return views_;
        if (!request_.cameras.empty()) {
            ViewsOptions o;
            o.scene = fs::is_directory(request_.input) ? request_.input : fs::path(".");
            o.cameras = fs::absolute(request_.cameras);
            o.images = request_.images;
            o.cameras_only = true;
            views_ = load_views(o, progress_);
        } else {
            if (folder_.empty() || !fs::exists(folder_ / "cameras.json"))
                throw InputError(request_.input.string() + ": has no cameras of its own. Remedy: the result's folder, or --cameras FILE");
            views_ = result_views(folder_, request_.images, progress_);
        }
        return views_;
    }

    const View& view_called_by_user() { return views().views[view_called(views(), request_.view, "--view")]; }

    /// Cameras among the file's coordinates: x_file = scale axes x_scene.
    std::vector<Camera> file_cameras() {
        std::vector<Camera> out = views().cameras();
        for (Camera& c : out) c = in_file(c);
        return out;
    }
    Camera view_camera(const View& v) {
        const auto at = std::find_if(views_.views.begin(), views_.views.end(), [&](const View& o) { return &o == &v; });
        return in_file(views_.cameras()[static_cast<size_t>(at - views_.views.begin())]);
    }
    Camera in_file(Camera c) const {
        Mat3d axes;
        for (int r = 0; r < 3; ++r)
            for (int k = 0; k < 3; ++k) axes(r, k) = frame_.axes[static_cast<size_t>(r)][static_cast<size_t>(k)];
        c.camera_from_world.rotation = c.camera_from_world.rotation * axes.transpose();
        c.camera_from_world.translation *= frame_.scale;
        if (c.intrinsics.orthographic) c.intrinsics.fx /= frame_.scale, c.intrinsics.fy /= frame_.scale, c.intrinsics.skew /= frame_.scale;
        return c;
    }

    Image8 picture(const Camera& camera) {
        progress_.check();
        const auto start = std::chrono::steady_clock::now();
        if (device_) device_->clear_times();
        Image8 out = device_ ? device_->render(camera, options_) : volume_ ? render(*volume_, camera, options_) : render(mesh_, camera, options_);
        if (device_) summary_.device_milliseconds = device_->milliseconds("render");
        summary_.seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
        ++summary_.pictures;
        summary_.width_px = out.width;
        summary_.height_px = out.height;
        return out;
    }

    void save(const Image8& image) { io::write_png(request_.output, image); }

    static Image8 without_alpha(const Image8& p) {
        Image8 out(p.width, p.height, 3);
        for (int y = 0; y < p.height; ++y)
            for (int x = 0; x < p.width; ++x)
                for (int c = 0; c < 3; ++c) out.at(x, y, c) = p.at(x, y, c);
        return out;
    }

    void film() {
        progress_.begin("film", static_cast<size_t>(request_.frames));
        const bool plays = write_film(
            static_cast<size_t>(request_.frames),
            [&](size_t i) {
                OrbitView v = request_.orbit;
                v.whole_turn = true;
                v.azimuth_deg -= 360.0 * static_cast<double>(i) / request_.frames;  // the object turns counterclockwise
                Image8 out = without_alpha(picture(orbit_camera(bounds_, up_, v)));
                progress_.step();
                return out;
            },
            request_.rate_hz, request_.output, FilmCodec::Browser);
        if (!plays)
            progress_.warn(request_.output.string() +
                           ": this machine's FFmpeg has no H.264, so the film is MPEG-4 part 2, which browsers do not play. Remedy: -o FILE.webm");
    }

    void sheet() {
        std::vector<size_t> which;
        const size_t n = views().views.size(), shown = std::min<size_t>(n, static_cast<size_t>(request_.sheet));
        for (size_t s = 0; s < shown; ++s) which.push_back(s * n / shown);
        std::vector<Image8> tiles;
        std::vector<std::string> names;
        progress_.begin("sheet", shown);
        for (const size_t i : which) {
            const View& v = views_.views[i];
            const Camera camera = view_camera(v);
            constexpr double kTileHeight = 300;
            const Image8 made = picture(scaled(camera, std::min(1.0, kTileHeight / camera.intrinsics.height_px)));
            Image8 photo;
            if (!v.image_path.empty()) {
                try {
                    photo = load_photo8(v);
                } catch (const InputError& e) {
                    progress_.warn(std::string(e.what()) + "; the sheet shows it black");
                }
            }
            tiles.push_back(beside_photo(photo.view(), made.view()));
            names.push_back(v.name);
            progress_.step();
        }
        save(sheet_of(tiles, names, tiles.size() > 4 ? 3 : 2));
    }

    void slices() {
        const size_t axis = static_cast<size_t>(request_.slice_axis[0] - 'x');
        const Vec3d along = Vec3d::Unit(static_cast<Eigen::Index>(axis));
        const double lo = bounds_.min()[static_cast<Eigen::Index>(axis)], hi = bounds_.max()[static_cast<Eigen::Index>(axis)];
        const int n = std::max(1, request_.slices);
        const int columns = static_cast<int>(std::ceil(std::sqrt(n)));
        // Many are smaller, so that the sheet is about as large as one.
        const Camera camera = slice_camera(bounds_, along, up_, std::max(64, std::max(request_.orbit.width_px, request_.orbit.height_px) / columns));
        std::vector<Image8> tiles;
        std::vector<std::string> names;
        for (int i = 0; i < n; ++i) {
            const double at = n == 1 ? lo + request_.slice_at * (hi - lo) : lo + (i + 0.5) / n * (hi - lo);
            options_.slice = {along, at};
            tiles.push_back(picture(camera));
            names.push_back(text_of("%s = %.4g", request_.slice_axis.c_str(), at));
        }
        save(n == 1 ? tiles.front() : sheet_of(tiles, names, columns));
    }

    const PictureRequest& request_;
    Progress& progress_;
    RenderOptions options_;
    PictureSummary summary_;
    std::optional<Device> device_;        ///< where it is used: holds the volume
    std::optional<RenderVolume> volume_;  ///< of a volume, on the CPU
    Mesh mesh_;
    Box3d bounds_;
    Vec3d up_ = Vec3d::UnitZ();
    Views views_;
    FileFrame frame_;
    fs::path folder_;  ///< of the result; empty: none
};

}  // namespace

PictureSummary draw_pictures(const PictureRequest& request, Progress& progress) {
    openvdb::initialize();
    return PictureRun(request, progress).run();
}

}  // namespace vdbcarve
