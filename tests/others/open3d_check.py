# SPDX-License-Identifier: Apache-2.0
"""Open3D on a result: open3d_check.py OUT. Its test for self-intersections is quadratic, so the mesh is a small one."""
import json
import sys

import numpy
import open3d

out = sys.argv[1]
report = json.load(open(f"{out}/report.json"))
failed = False
for name in ("mesh.ply", "mesh.obj", "mesh.stl", "mesh.glb"):
    mesh = open3d.io.read_triangle_mesh(f"{out}/{name}")
    mesh.remove_duplicated_vertices()  # .stl has three a face
    facts = {
        "vertices": len(mesh.vertices) == report["mesh"]["vertices"],
        "faces": len(mesh.triangles) == report["mesh"]["faces"],
        "edge manifold": mesh.is_edge_manifold(allow_boundary_edges=False),
        "vertex manifold": mesh.is_vertex_manifold(),
        "orientable": mesh.is_orientable(),
        "colours": mesh.has_vertex_colors() == (name != "mesh.stl"),
    }
    print(name, {k: bool(v) for k, v in facts.items()}, end="; ")
    if name == "mesh.ply":
        facts["watertight"] = mesh.is_watertight()
        print("self-intersecting:", mesh.is_self_intersecting(), "watertight:", facts["watertight"], end="; ")
        facts["volume"] = abs(mesh.get_volume() / report["mesh"]["volume"] - 1) < 1e-4
        ply_colors = numpy.asarray(mesh.vertex_colors)
        facts["colours vary"] = ply_colors.std() > 0.02
    print()
    for fact, holds in facts.items():
        if not holds:
            print(f"{name}: {fact} does not hold")
            failed = True
sys.exit(failed)
