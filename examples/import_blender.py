# SPDX-License-Identifier: Apache-2.0
# Opens a result in Blender 3.x or later: blender --python import_blender.py -- OUT
# The mesh and the volume share one world box; the volume's grid `density` is picked up by itself.
import os
import sys

import bpy

out = sys.argv[sys.argv.index("--") + 1]
bpy.ops.object.select_all(action="SELECT")
bpy.ops.object.delete()
bpy.ops.import_mesh.ply(filepath=os.path.join(out, "mesh.ply"))
bpy.ops.object.volume_import(filepath=os.path.join(out, "volume.vdb"))
