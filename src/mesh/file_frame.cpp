// SPDX-License-Identifier: Apache-2.0
// Axes and units of files.
#include <openvdb/tools/Prune.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "volume/inside_tiles.h"
#include "vdbcarve/error.h"
#include "vdbcarve/file_frame.h"

namespace vdbcarve {
namespace {

using Axes = std::array<std::array<int, 3>, 3>;
constexpr Axes kSame{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

/// The rotation that turns `up` to y; rows are images of x, y, z.
Axes to_y_up(const std::string& up) {
    if (up == "z") return {{{1, 0, 0}, {0, 0, 1}, {0, -1, 0}}};
    if (up == "-z") return {{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}}};
    if (up == "x") return {{{0, -1, 0}, {1, 0, 0}, {0, 0, 1}}};
    if (up == "-x") return {{{0, 1, 0}, {-1, 0, 0}, {0, 0, 1}}};
    if (up == "-y") return {{{1, 0, 0}, {0, -1, 0}, {0, 0, -1}}};
    if (up == "y") return kSame;
    throw UsageError("--up " + up + " is none of x, y, z, -x, -y, -z");
}

Axes product(const Axes& a, const Axes& b) {
    Axes out{};
    for (size_t i = 0; i < 3; ++i)
        for (size_t j = 0; j < 3; ++j)
            for (size_t k = 0; k < 3; ++k) out[i][j] += a[i][k] * b[k][j];
    return out;
}

/// Where an index along an axis goes: the centre of voxel i is at (i + 1/2) voxel + origin, and a mirrored axis counts from the other end.
struct IndexMap {
    size_t from[3];
    bool mirrored[3];
    explicit IndexMap(const Axes& axes) {
        for (size_t a = 0; a < 3; ++a)
            for (size_t b = 0; b < 3; ++b)
                if (axes[a][b]) {
                    from[a] = b;
                    mirrored[a] = axes[a][b] < 0;
                }
    }
    /// The least corner of a box of `side` voxels whose least corner is at `c`; of a voxel with side 1.
    openvdb::Coord operator()(const openvdb::Coord& c, int side) const {
        openvdb::Coord out;
        for (size_t a = 0; a < 3; ++a) {
            const int x = c[static_cast<openvdb::Index>(from[a])];
            out[static_cast<openvdb::Index>(a)] = mirrored[a] ? -side - x : x;
        }
        return out;
    }
};

template <class Grid>
openvdb::GridBase::Ptr turn(const Grid& grid, const FileFrame& frame) {
    using Tree = typename Grid::TreeType;
    using Leaf = typename Tree::LeafNodeType;
    using Value = typename Grid::ValueType;
    const openvdb::math::Transform& transform = grid.transform();
    const openvdb::Vec3d voxel = transform.voxelSize(), first = transform.indexToWorld(openvdb::Vec3d(-0.5));
    const auto matrix = transform.baseMap()->getAffineMap()->getMat4();
    bool plain = std::fabs(voxel.x() - voxel.y()) < 1e-9 * voxel.x() && std::fabs(voxel.x() - voxel.z()) < 1e-9 * voxel.x();
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) plain = plain && std::fabs(matrix(i, j) - (i == j ? voxel.x() : 0)) < 1e-9 * voxel.x();
    if (!plain) throw InputError("grid '" + grid.getName() + "': its transform turns or shears, and cannot be turned to other axes");

    // Values that are lengths.
    const bool scales = std::is_same_v<Value, float> && (grid.getGridClass() == openvdb::GRID_LEVEL_SET || grid.getName() == "slack") && frame.scale != 1;
    const auto convert = [&](const Value& v) -> Value {
        if constexpr (std::is_same_v<Value, float>) return scales ? static_cast<float>(v * frame.scale) : v;
        else return v;
    };
    typename Grid::Ptr out = Grid::create(convert(grid.background()));
    out->openvdb::MetaMap::operator=(grid);
    const IndexMap map(frame.axes);
    openvdb::Vec3d origin;
    for (size_t a = 0; a < 3; ++a) {
        const double o = first[static_cast<int>(map.from[a])];
        origin[static_cast<int>(a)] = frame.scale * (map.mirrored[a] ? -o : o);
    }
    if (const double side = voxel.x() * frame.scale; side < kLeastVoxel)
        throw OutputError("grid '" + grid.getName() + "': voxels of " + std::to_string(1e6 * side) + "e-6 " + frame.units +
                          " are too small for OpenVDB. Remedy: another --dcc, or none");
    auto placed = openvdb::math::Transform::createLinearTransform(voxel.x() * frame.scale);
    placed->postTranslate(origin + openvdb::Vec3d(0.5 * voxel.x() * frame.scale));
    out->setTransform(placed);
    std::array<openvdb::Index, Leaf::SIZE> place{};
    for (openvdb::Index at = 0; at < Leaf::SIZE; ++at) place[at] = Leaf::coordToOffset(map(Leaf::offsetToLocalCoord(at), 1));
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        auto moved = std::make_unique<Leaf>(map(leaf->origin(), 8), out->background(), false);
        for (openvdb::Index at = 0; at < Leaf::SIZE; ++at) {
            if constexpr (!std::is_same_v<Value, bool>) moved->setValueOnly(place[at], convert(leaf->getValue(at)));
            moved->setActiveState(place[at], leaf->isValueOn(at));
        }
        out->tree().addLeaf(moved.release());
    }
    using Tiles = typename Tree::ValueAllCIter;
    Tiles tile = grid.tree().cbeginValueAll();
    tile.setMaxDepth(Tiles::LEAF_DEPTH - 1);
    for (; tile; ++tile) {
        if (*tile == grid.background() && !tile.isValueOn()) continue;
        const openvdb::CoordBBox box = tile.getBoundingBox();
        const openvdb::Coord c = map(box.min(), box.dim().x());
        out->tree().addTile(tile_level(box.dim().x()), c, convert(*tile), tile.isValueOn());
    }
    return out;
}

}  // namespace

const char* color_grid_name(Dcc dcc) { return dcc == Dcc::Houdini ? "Cd" : "color"; }

std::optional<double> metres_per(const std::string& unit) {
    static const std::map<std::string, double> units{
        {"m", 1},         {"meter", 1},          {"metre", 1},          {"meters", 1},          {"metres", 1},
        {"cm", 0.01},     {"centimeter", 0.01},  {"centimetre", 0.01},  {"centimeters", 0.01},  {"centimetres", 0.01},
        {"mm", 0.001},    {"millimeter", 0.001}, {"millimetre", 0.001}, {"millimeters", 0.001}, {"millimetres", 0.001},
        {"km", 1000},     {"inch", 0.0254},      {"inches", 0.0254},    {"in", 0.0254},         {"ft", 0.3048},
        {"foot", 0.3048}, {"feet", 0.3048}};
    std::string small = unit;
    std::transform(small.begin(), small.end(), small.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    const auto found = units.find(small);
    return found == units.end() ? std::nullopt : std::optional<double>(found->second);
}

FileFrame file_frame(const std::string& extension, const FrameRequest& request) {
    FileFrame out;
    out.up = request.up;
    out.units = request.units;
    const bool dcc = request.dcc != Dcc::None;
    const std::optional<double> metres = metres_per(request.units);
    const auto in_units = [&](const char* unit) {
        if (!metres) return;
        out.scale = *metres / *metres_per(unit);
        out.units = unit;
    };
    const bool always_y = extension == ".obj" || extension == ".glb";
    if (!request.up.empty()) {
        const Axes y_up = to_y_up(request.up);
        if (always_y || request.dcc == Dcc::Houdini || request.dcc == Dcc::Maya) {
            out.axes = y_up;
            out.up = "y";
        } else if (request.dcc == Dcc::Blender) {
            out.axes = request.up == "z" ? kSame : product({{{1, 0, 0}, {0, 0, -1}, {0, 1, 0}}}, y_up);
            out.up = "z";
        }
    }
    if (extension == ".stl" && request.stl_mm) {
        if (!metres)
            throw UsageError("millimetres were asked for, but the scene's unit is " +
                             (request.units.empty() ? std::string("not known") : "'" + request.units + "'") + ". Remedy: --units");
        in_units("mm");
    } else if (extension == ".glb") {
        in_units("m");
    } else if (dcc) {
        in_units(request.dcc == Dcc::Maya ? "cm" : "m");
    }
    return out;
}

FileFrame inverse(const FileFrame& frame) {
    FileFrame out;
    for (size_t i = 0; i < 3; ++i)
        for (size_t j = 0; j < 3; ++j) out.axes[i][j] = frame.axes[j][i];
    out.scale = 1 / frame.scale;
    return out;
}

bool FileFrame::moves() const { return axes != kSame || scale != 1; }

std::string unknown_frame(const std::string& extension, const FrameRequest& request) {
    std::string out;
    const bool glb = extension == ".glb", dcc = request.dcc != Dcc::None;
    if (!metres_per(request.units) && (glb || dcc))
        out = (request.units.empty() ? std::string("the unit of length is unknown") : "the unit '" + request.units + "' has no length") +
              ": numbers stay as they are" + (glb ? ", and readers of .glb take 1 unit for 1 m" : "") +
              ". Remedy: --units, where it is known (of cameras found from silhouettes: with --known-height, --known-distance or --known-length)";
    if (request.up.empty() && (glb || extension == ".obj" || dcc))
        out += std::string(out.empty() ? "" : "; ") + "the up axis is unknown: nothing is turned, and readers of .obj and .glb take y for up. Remedy: --up";
    return out;
}

Mesh in_frame(Mesh mesh, const FileFrame& frame) {
    if (!frame.moves()) return mesh;
    const auto turned = [&](const std::array<float, 3>& p, double scale) {
        std::array<float, 3> q{};
        for (size_t i = 0; i < 3; ++i)
            for (size_t j = 0; j < 3; ++j)
                if (frame.axes[i][j]) q[i] = static_cast<float>(frame.axes[i][j] * scale * p[j]);
        return q;
    };
    for (auto& p : mesh.vertices) p = turned(p, frame.scale);
    for (auto& n : mesh.normals) n = turned(n, 1);
    for (float& s : mesh.slack) s = static_cast<float>(frame.scale * static_cast<double>(s));
    return mesh;
}

openvdb::GridBase::ConstPtr in_frame(const openvdb::GridBase::ConstPtr& grid, const FileFrame& frame) {
    if (!frame.moves()) return grid;
    if (const auto g = openvdb::gridConstPtrCast<openvdb::FloatGrid>(grid)) return turn(*g, frame);
    if (const auto g = openvdb::gridConstPtrCast<openvdb::Vec3SGrid>(grid)) return turn(*g, frame);
    if (const auto g = openvdb::gridConstPtrCast<openvdb::Int32Grid>(grid)) return turn(*g, frame);
    if (const auto g = openvdb::gridConstPtrCast<openvdb::MaskGrid>(grid)) return turn(*g, frame);
    throw InputError("grid '" + grid->getName() + "' (" + grid->valueType() + "): grids of this type are not turned to other axes or units");
}

}  // namespace vdbcarve
