# SPDX-License-Identifier: Apache-2.0
"""Blender on a result: blender -b --python blender_check.py -- OUT PLY_INFO.json PRESET.

OUT has z up and its files in millimetres; PRESET was made with --dcc blender from the same photographs called y up."""
import json
import os
import struct
import sys

import bpy
import numpy

numpy.bool = bool  # the glTF importer of Blender 3.4 wants it of newer NumPys

out, ply_info, preset = sys.argv[sys.argv.index("--") + 1 :]
info = json.load(open(ply_info))["mesh"]
report = json.load(open(f"{out}/report.json"))
failures = []


def check(what, holds, detail=""):
    print("ok  " if holds else "FAIL", what, detail)
    if not holds:
        failures.append(what)


def imported(path):
    bpy.ops.object.select_all(action="DESELECT")
    before = set(bpy.data.objects)
    extension = os.path.splitext(path)[1]
    if extension == ".ply":
        bpy.ops.import_mesh.ply(filepath=path)
    elif extension == ".stl":
        bpy.ops.import_mesh.stl(filepath=path)
    elif extension == ".obj":
        bpy.ops.wm.obj_import(filepath=path)
    elif extension == ".glb":
        bpy.ops.import_scene.gltf(filepath=path)
    else:
        bpy.ops.object.volume_import(filepath=path)
    bpy.context.view_layer.update()
    return [o for o in set(bpy.data.objects) - before if o.type in ("MESH", "VOLUME")][0]


def world_points(obj):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = obj.evaluated_get(depsgraph).to_mesh()
    points = numpy.empty(3 * len(mesh.vertices), numpy.float32)
    mesh.vertices.foreach_get("co", points)
    m = numpy.array(obj.matrix_world)
    return points.reshape(-1, 3) @ m[:3, :3].T + m[:3, 3]


def box(points):
    return numpy.concatenate([points.min(0), points.max(0)])


def ply_vertices(path):
    """Positions and 8-bit colours as they lie in the file."""
    data = open(path, "rb").read()
    head, body = data.split(b"end_header\n", 1)
    count = int(head.split(b"element vertex ")[1].split()[0])
    names = [line.split()[1:] for line in head.split(b"element face")[0].decode().splitlines() if line.startswith("property")]
    kinds = {"float": "f4", "uchar": "u1"}
    table = numpy.frombuffer(body, numpy.dtype([(n, "<" + kinds[k]) for k, n in names]), count)
    return numpy.stack([table["x"], table["y"], table["z"]], 1), numpy.stack([table["red"], table["green"], table["blue"]], 1)


def linear(srgb):
    return numpy.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def colors_of(obj):
    """Linear RGB by vertex, after Blender's own conversion."""
    mesh = obj.data
    attribute = mesh.color_attributes[0]
    values = numpy.empty(4 * len(attribute.data), numpy.float32)
    attribute.data.foreach_get("color", values)
    values = values.reshape(-1, 4)[:, :3]
    if attribute.domain == "POINT":
        return values
    corners = numpy.empty(len(mesh.loops), numpy.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    result = numpy.zeros((len(mesh.vertices), 3), numpy.float32)
    result[corners] = values
    return result


points, colors = ply_vertices(f"{out}/mesh.ply")
truth_box, size = numpy.array(info["box"]), numpy.ptp(points, axis=0).max()
for name, scale in (("mesh.ply", 1), ("mesh.stl", 1), ("mesh.obj", 1), ("mesh.glb", 1e-3)):
    obj = imported(f"{out}/{name}")
    found = world_points(obj)
    check(f"{name}: vertices", len(found) == report["mesh"]["vertices"], f"{len(found)}")
    worst = numpy.abs(box(found) - scale * truth_box).max() / (scale * size)
    check(f"{name}: upright and in its place", worst < 1e-3, f"box off by {100 * worst:.4f} %")
    if name != "mesh.stl":
        # Vertices keep their order.
        error = numpy.abs(colors_of(obj) - linear(colors / 255.0)).max()
        check(f"{name}: colours", error < 0.01, f"differ by up to {error:.4f} (linear)")
    check(f"{name}: faces", len(obj.data.polygons) == report["mesh"]["faces"])


def volume_mesh(volume, grid, threshold):
    mesh = bpy.data.meshes.new("from_volume")
    obj = bpy.data.objects.new("from_volume", mesh)
    bpy.context.collection.objects.link(obj)
    modifier = obj.modifiers.new("to_mesh", "VOLUME_TO_MESH")
    modifier.object = volume
    modifier.grid_name = grid
    modifier.threshold = threshold
    modifier.resolution_mode = "GRID"
    bpy.context.view_layer.update()
    return world_points(obj)


for folder in (out, preset):
    r = json.load(open(f"{folder}/report.json"))
    voxel = r["grid"]["voxel_size"] * r["files"]["volume.vdb"]["scale"]
    mesh_box = box(world_points(imported(f"{folder}/mesh.ply")))
    volume = imported(f"{folder}/volume.vdb")
    volume.data.grids.load()
    names = [g.name for g in volume.data.grids]
    check(f"{folder}: grids", set(names) == {"surface", "density", "slack", "color"}, str(names))
    for grid, threshold in (("surface", 0.0), ("density", 0.5)):
        found = volume_mesh(volume, grid, threshold)
        # Blender 3.4 puts it half a voxel off along every axis.
        off = (box(found) - mesh_box) / voxel
        check(f"{folder}: mesh of {grid} at {threshold}", len(found) > 100 and numpy.abs(off - 0.5).max() < 1.0, f"{len(found)} vertices, box off by {numpy.round(off, 2)} voxels")

# The preset turned y to z, in metres, for every file.
turned = numpy.stack([points[:, 0], -points[:, 2], points[:, 1]], 1) * 1e-3
for name in ("mesh.ply", "mesh.stl", "mesh.obj", "mesh.glb"):
    found = box(world_points(imported(f"{preset}/{name}")))
    worst = numpy.abs(found - box(turned)).max() / (size * 1e-3)
    check(f"--dcc blender: {name}", worst < 1e-3, f"box off by {100 * worst:.4f} %")

print(f"{len(failures)} failures", failures)
sys.exit(1 if failures else 0)
