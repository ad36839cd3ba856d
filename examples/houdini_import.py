# SPDX-License-Identifier: Apache-2.0
"""A result of vdbcarve in Houdini: paste into a Python shell, or run with hython; OUT made with --dcc houdini (y up, metres, colour grid Cd)."""
import hou

OUT = "out"

geo = hou.node("/obj").createNode("geo", "vdbcarve")
volume = geo.createNode("file", "volume")  # surface (an SDF), density (a fog volume), Cd (a vector grid)
volume.parm("file").set(f"{OUT}/volume.vdb")
mesh = geo.createNode("file", "mesh")  # .ply: vertex colours come as Cd too
mesh.parm("file").set(f"{OUT}/mesh.ply")

# The level set as polygons again, at zero and in the same place as the mesh.
convert = geo.createNode("convertvdb", "polygons")
convert.setInput(0, volume)
convert.parm("group").set("@name=surface")
convert.parm("conversion").set("poly")
convert.setDisplayFlag(True)
geo.layoutChildren()
