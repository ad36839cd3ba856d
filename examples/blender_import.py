# SPDX-License-Identifier: Apache-2.0
"""A result of vdbcarve in Blender: its volume, coloured, and its mesh beside it; and a picture of both, without a window:

    blender -b --factory-startup --python examples/blender_import.py -- OUT picture.png

OUT made with --dcc blender is upright and in metres. Without `picture.png` the scene is only set up."""
import sys

import bpy
from mathutils import Vector

out, *picture = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.object.select_all(action="SELECT")
bpy.ops.object.delete()

bpy.ops.import_mesh.ply(filepath=f"{out}/mesh.ply")
mesh = bpy.context.object
bpy.ops.object.volume_import(filepath=f"{out}/volume.vdb")
volume = bpy.context.object
corners = [mesh.matrix_world @ Vector(c) for c in mesh.bound_box]
low, high = (Vector(f(c[a] for c in corners) for a in range(3)) for f in (min, max))
size, middle = high - low, (low + high) / 2
volume.location.x += 1.15 * size.x


def material(name, shader, **inputs):
    m = bpy.data.materials.new(name)
    m.use_nodes = True
    nodes, links = m.node_tree.nodes, m.node_tree.links
    nodes.clear()
    node, end, color = nodes.new(shader), nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeAttribute")
    for key, value in inputs.items():
        node.inputs[key.replace("_", " ")].default_value = value
    return m, node, end, color, links


# Vertex colours of the mesh.
m, shader, end, color, links = material("object", "ShaderNodeBsdfPrincipled", Roughness=0.8, Specular=0.2)
if mesh.data.color_attributes:
    color.attribute_name = mesh.data.color_attributes[0].name
    links.new(color.outputs["Color"], shader.inputs["Base Color"])
links.new(shader.outputs[0], end.inputs["Surface"])
mesh.data.materials.append(m)
mesh.data.use_auto_smooth = True
bpy.context.view_layer.objects.active = mesh
bpy.ops.object.shade_smooth({"selected_editable_objects": [mesh], "object": mesh, "active_object": mesh})

# The grid `density` is found by itself; `color` has to be named. Thirty units of optical depth across the object make it solid.
m, shader, end, color, links = material("volume", "ShaderNodeVolumePrincipled", Density=300 / max(size), Anisotropy=0.0)
volume.data.grids.load()
if "color" in [g.name for g in volume.data.grids]:
    color.attribute_name = "color"
    links.new(color.outputs["Color"], shader.inputs["Color"])
links.new(shader.outputs[0], end.inputs["Volume"])
volume.data.materials.append(m)

# A camera that sees both, a lamp over its shoulder, a bright sky.
centre = middle + Vector((0.575 * size.x, 0, 0))
reach = max(2.2 * size.x, size.z)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.location = centre + Vector((0.15, -1.9, 0.45)) * reach
camera.rotation_euler = (centre - camera.location).to_track_quat("-Z", "Y").to_euler()
camera.data.lens, camera.data.clip_start, camera.data.clip_end = 50, 0.01 * reach, 100 * reach
lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
lamp.data.energy, lamp.data.angle = 3, 0.2
lamp.rotation_euler = (0.8, 0.1, -0.5)
for o in (camera, lamp):
    bpy.context.collection.objects.link(o)
scene = bpy.context.scene
scene.camera = camera
scene.world = scene.world or bpy.data.worlds.new("world")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.7, 0.75, 0.8, 1)
scene.view_settings.view_transform = "Standard"

if picture:
    scene.render.engine, scene.cycles.samples = "CYCLES", 64
    scene.cycles.use_denoising = False  # not every Blender is built with a denoiser
    scene.cycles.volume_bounces, scene.cycles.volume_step_rate = 8, 1
    scene.render.resolution_x, scene.render.resolution_y = 1280, 720
    scene.render.filepath = picture[0]
    bpy.ops.render.render(write_still=True)
