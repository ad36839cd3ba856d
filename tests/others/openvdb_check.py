# SPDX-License-Identifier: Apache-2.0
"""OpenVDB's own Python module on a result: openvdb_check.py OUT HALF.vdb."""
import json
import sys

import pyopenvdb as vdb

out, half = sys.argv[1:3]
report = json.load(open(f"{out}/report.json"))
voxel = report["grid"]["voxel_size"]
grids, metadata = vdb.readAll(f"{out}/volume.vdb")
by_name = {g.name: g for g in grids}
print({n: (g.gridClass, type(g).__name__, g.background, g.activeVoxelCount()) for n, g in by_name.items()}, metadata)
assert set(by_name) == {"surface", "density", "slack", "color"}
surface, density, color = by_name["surface"], by_name["density"], by_name["color"]
assert surface.gridClass == vdb.GridClass.LEVEL_SET and abs(surface.background - 3 * voxel) < 1e-6 * voxel
assert density.gridClass == vdb.GridClass.FOG_VOLUME and density.background == 0
assert metadata["units"] == "mm" and metadata["up_axis"] == "z" and metadata["creator"].startswith("vdbcarve")
assert metadata["views"] == 12 and abs(metadata["voxel_size"] - voxel) < 1e-12 and len(metadata["inputs_sha256"]) == 64
for grid in grids:
    assert abs(grid.transform.voxelSize()[0] - voxel) < 1e-9
    assert not grid.saveFloatAsHalf
# Density is one half where the level set is zero.
at = surface.getConstAccessor()
other = density.getConstAccessor()
checked = 0
for item in surface.citerOnValues():
    if item.count == 1:
        expected = min(1, max(0, 0.5 - item.value / (3 * voxel)))
        assert abs(other.getValue(item.min) - expected) < 1e-6
        checked += 1
        if checked > 20000:
            break
halves, _ = vdb.readAll(half)
for grid in halves:
    assert grid.saveFloatAsHalf, grid.name
    if grid.name == "surface":
        a, worst = grid.getConstAccessor(), 0
        for n, item in enumerate(surface.citerOnValues()):
            if item.count == 1:
                worst = max(worst, abs(a.getValue(item.min) - item.value))
            if n > 20000:
                break
        print("half: largest difference", worst / voxel, "voxel")
        assert worst < 2e-3 * voxel
