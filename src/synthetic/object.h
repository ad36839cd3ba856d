// SPDX-License-Identifier: Apache-2.0
// The object of a synthetic scene, solids or mesh, as the renderer asks it.
#pragma once

#include <optional>
#include <vector>

#include "mesh/triangle_tree.h"
#include "vdbcarve/synthetic.h"

namespace vdbcarve::synth {

/// Linear albedo on the object, as a function of place in units of the object's radius.
Vec3d albedo(const Vec3d& p, Pattern pattern);

struct SurfacePoint {
    Vec3d position, normal;
    int part;  ///< number of the solid or face
};

/// The object, solids or mesh, as the renderer asks it.
class Object {
  public:
    explicit Object(const SyntheticSpec& spec);
    const Vec3d& centre() const { return centre_; }
    double radius() const { return radius_; }
    const Mesh& truth() const { return spec_.solids.empty() ? spec_.mesh : truth_; }

    using Surface = std::vector<std::optional<SurfacePoint>>;

    /// Share of each pixel that the object covers. `surface` is what surface() says of the same camera.
    Image8 coverage(const Camera& camera, const Surface& surface) const;

    /// What each pixel centre sees; nothing where it sees past the object.
    /// Normals are left out unless asked for: they cost six more evaluations.
    Surface surface(const Camera& camera, bool with_normals) const;

    /// Distance along a ray to the first surface point. Meshes: by a bounding volume hierarchy.
    std::optional<double> hit(const Camera::Ray& ray) const;
    /// The surface point nearest to a place, and its distance. Solids: by steps along the gradient. Meshes: after prepare_nearest().
    SurfacePoint nearest(const Vec3d& p, double& distance) const;
    void prepare_nearest() const;
    Pattern pattern() const { return spec_.pattern; }
    /// Linear colour of the surface itself.
    Vec3d albedo_at(const SurfacePoint& p) const;
    /// Height of the lowest point along an axis.
    double lowest(const Vec3d& up) const;

  private:
    double value(const Vec3d& p) const;
    int nearest_solid(const Vec3d& p) const;
    /// Bilinear in linear light; v upwards, repeated.
    Vec3d texture_at(double u, double v) const;
    Vec3d gradient(const Vec3d& p) const;
    Mesh mesh_of_solids(const Box3d& box) const;

    const SyntheticSpec& spec_;
    Vec3d centre_ = Vec3d::Zero();
    double radius_ = 0;
    Mesh truth_;
    mutable std::optional<TriangleTree> tree_;  ///< of the mesh's faces
};

}  // namespace vdbcarve::synth
