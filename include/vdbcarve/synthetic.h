// SPDX-License-Identifier: Apache-2.0
// Synthetic shoots: photographs, exact soft masks, cameras and truth of an object whose shape is known.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "vdbcarve/image.h"
#include "vdbcarve/progress.h"
#include "vdbcarve/triangle_mesh.h"
#include "vdbcarve/views.h"

namespace vdbcarve {

/// A solid in closed form, in its own frame.
struct Solid {
    enum class Kind {
        Ellipsoid,  ///< semi-axes size[0..2]
        Box,        ///< half edges size[0..2]
        Torus,      ///< around z: size[0] ring radius, size[1] tube radius
        Cup,        ///< around z, open at the top: size[0] outer radius, size[1] half height, size[2] wall; with a handle along +x
        Bowl        ///< around z: a disc of radius size[0] and half height size[1], a ball's cap hollowed out of its top, size[2] deep and 0.86 of it wide
    };
    Kind kind = Kind::Ellipsoid;
    Vec3d size = Vec3d::Ones();
    Rigid3 world_from_solid;
    /// Linear RGB, with a pattern of light and shade over it; none: clay and glaze.
    std::optional<Vec3d> color;

    /// Negative inside, zero on the surface; its magnitude never exceeds the distance to the surface.
    double value(const Vec3d& point_world) const;
    /// Distance along a unit ray to the first surface point, or nothing.
    std::optional<double> hit(const Camera::Ray& ray_world) const;
    /// Radius of a ball around world_from_solid.translation that holds the solid.
    double reach() const;

  private:
    double value_here(const Vec3d& point_solid) const;
};

/// How the cameras stand. The object's middle is looked at, z is up.
struct Rig {
    enum class Kind { Orbit, Rings, Dome };
    /// Who moves. Camera: it walks around, light and room stay with the object. Turntable: the object turns before a camera
    /// that stands still, so light and room stay with the camera and shading slides over the object. Poses are the same.
    enum class Motion { Camera, Turntable };
    Motion motion = Motion::Camera;
    struct Ring {
        int views;
        double elevation_deg;
    };
    Kind kind = Kind::Orbit;
    int views = 36;
    double elevation_deg = 10;   ///< of an orbit
    double start_deg = 0;        ///< azimuth of the first view
    double arc_deg = 360;        ///< of an orbit: less for a part, more for arcs that overlap; a full turn does not repeat its start
    double speed_variation = 0;  ///< smooth changes of angular speed, share of the mean (0..0.9), one slow and one fast phase a turn
    int sittings = 1;            ///< 2: the second half of the views shows the object laid on its side
    std::vector<Ring> rings;     ///< of rings
    double fov_deg = 30;         ///< vertical
    double distance = 0;         ///< from the object's middle, world units; 0: so that it fills the image
    double fill = 0.8;           ///< share of the image height that the object's ball takes then
    bool orthographic = false;
    int width_px = 640, height_px = 480;
    double pixel_aspect = 1;   ///< fy / fx
    Lens lens;                 ///< photographs and masks are distorted by it
    double breathing = 0;      ///< the focal length wanders smoothly by up to this share (focus breathing)
    double crop_drift_px = 0;  ///< the principal point wanders smoothly by up to this (a stabiliser's crop)
    // An unsteady hand: the true cameras deviate, uniformly within plus or minus these, from the nominal ones.
    double shake_angle_deg = 0, shake_elevation_deg = 0, shake_roll_deg = 0;
    double shake_position = 0, shake_look_at = 0;  ///< share of the distance
};

/// What the room and the photographer's gear do to the photographs. Masks are not touched.
struct PhotoLook {
    double gloss = 0;    ///< strength of a highlight (Blinn-Phong), 0..1
    bool table = false;  ///< the object stands on a table: its shadow, and its reflection where the table is glossy
    double table_reflection = 0.15;
    double blur_px = 0;          ///< defocus, standard deviation of a Gaussian
    double noise = 0;            ///< of the sensor, standard deviation in 8-bit steps
    int jpeg_quality = 0;        ///< 1..100: .jpg files; 0: .png
    double film_rate_hz = 0;     ///< the photographs also as a film of so many frames a second, film.mp4; 0: no
    bool exif = false;           ///< .jpg files say the focal length
    double exposure_jitter = 0;  ///< every photograph's exposure is off by a factor within 1 plus and minus this
    double light_drift =
        0;  ///< lamps wander from photograph to photograph: every channel's light by up to this share, and half of that from one side of the frame to the other
    std::optional<Vec3d> backdrop;  ///< linear RGB of a cloth behind everything, unevenly lit; none: a room
    double spill = 0;               ///< share of the cloth's light that the object's rim sends on
    bool plates = false;            ///< everything again without the object (clean plates), under lamps that do not wander
    bool flat = false;              ///< no lamps: the object's colour is the photographs' wherever it is seen from
};

/// What goes wrong with masks. Exact ones are kept beside them (SyntheticScene::true_masks).
struct MaskDamage {
    double noise_px = 0;        ///< the contour moves in and out, standard deviation
    double correlation_px = 0;  ///< over this length; 0: every pixel by itself
    double dilate_px = 0;       ///< the contour moves out
    int holes = 0, blobs = 0;   ///< round holes in the object and round blobs at its contour, a mask
    double radius_px = 14;      ///< theirs
    double share = 1;           ///< of the views that have holes and blobs, spread evenly
    bool any() const { return noise_px > 0 || dilate_px != 0 || ((holes > 0 || blobs > 0) && share > 0); }
};

/// What an object's colours are where nothing else says so.
enum class Pattern {
    Clay,    ///< veins and blotches of all sizes
    Checks,  ///< repeats itself along x, y and z
    Plain    ///< one colour
};

struct SyntheticSpec {
    std::string name = "object";
    Pattern pattern = Pattern::Clay;
    std::vector<Solid> solids;  ///< their union; empty when `mesh` is given
    Mesh mesh;                  ///< a closed mesh instead
    Image8 texture;             ///< of the mesh, sRGB; needs its texcoords
    Rig rig;
    PhotoLook look;
    MaskDamage damage;
    uint64_t seed = 1;
    bool photos = true;  ///< render photographs, not only masks
};

struct SyntheticScene {
    Views views;    ///< the true cameras
    Views nominal;  ///< what the photographer meant
    std::vector<Mask> masks;
    std::vector<Mask> true_masks;   ///< before MaskDamage; empty without
    std::vector<Image8> photos;     ///< sRGB; empty without SyntheticSpec::photos
    std::vector<Image8> plates;     ///< of PhotoLook::plates
    std::vector<double> exposures;  ///< factors on linear light, of PhotoLook::exposure_jitter
    PhotoLook look;                 ///< for the files' format
    Mesh truth;                     ///< with the colours of surface_colors()
};

/// The built-in objects: "ellipsoids", "boxes", "torus", "cup", "bowl", "pair" (two solids apart, one before the other). Throws UsageError for another name.
SyntheticSpec builtin_spec(const std::string& name);

/// "clay", "checks" or "plain". Throws InputError for another name.
Pattern pattern_called(const std::string& name);

/// A picture for SyntheticSpec::texture. Throws InputError.
Image8 read_texture(const std::filesystem::path& file);

/// Reads a JSON spec (data/ has examples). Throws InputError naming file and field.
SyntheticSpec read_spec(const std::filesystem::path& file);

/// What the photographs show, without highlights and exposure, where the object is nearest to the points: linear RGB, and the distance.
/// Under a turntable's lamp, which does not turn along, the mean over the cameras that look at it most squarely.
struct TrueColor {
    std::array<float, 3> color;
    double distance;
};
std::vector<TrueColor> surface_colors(const SyntheticSpec& spec, const std::vector<Vec3d>& points_world);

/// Same spec and seed, same bytes.
SyntheticScene synthesize(const SyntheticSpec& spec, Progress& progress);

/// Writes images/, masks/ (and masks_true/ where masks were damaged, plates/ where there are clean plates), transforms.json (true cameras),
/// transforms_nominal.json and truth.ply.
void write_scene(const SyntheticScene& scene, const std::filesystem::path& folder);

}  // namespace vdbcarve
