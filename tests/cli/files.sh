#!/usr/bin/env bash
# Files for other programs, and what is in them.
source "${0%/*}/common.sh"
use scene out

expect 0 'scene -> set' export scene --undistort -o set
check 'COLMAP gets cameras and pictures' test -s set/sparse/0/cameras.txt -a -s set/images/0000.png
expect 0 '' export out -o nerf/transforms.json
check 'and nerfstudio its file' grep -q fl_x nerf/transforms.json
expect 2 'undistort is of cameras' export out --undistort -o other.stl
expect 0 'surface' info out
expect 0 '"grids"' info out/volume.vdb --json -
expect 0 'genus' info out/mesh.obj
expect 0 'focal_px' info scene
expect 0 'focal_px' info out/cameras.json
expect 0 'closed manifold' reconstruct scene -o cubes --resolution 40 --mesher marching-cubes --normals
check 'normals are in the mesh' grep -aq 'property float nz' cubes/mesh.ply
check 'the mesher changes the mesh' test "$(cmp -s out/mesh.ply cubes/mesh.ply; echo $?)" -eq 1
check 'and nothing of the volume' cmp -s out/volume.vdb cubes/volume.vdb
expect 0 'volume.nvdb' export out -o volume.nvdb back.obj
expect 0 'surface' info volume.nvdb
expect 0 'again.vdb' export volume.nvdb -o again.vdb
expect 0 'active_voxels' info again.vdb
expect 2 'volumes become' export out/mesh.ply -o mesh.vdb
expect 3 'no such file' export nowhere.vdb -o there.nvdb
expect 2 'known' export out -o first.vdb second.xyz
check 'nothing is written before everything is checked' test ! -e first.vdb
expect 2 'input itself' export volume.nvdb -o volume.nvdb
expect 3 'holds no volume' export scene -o there.nvdb
expect 0 'closed manifold' reconstruct scene -o maya --resolution 40 --units m --dcc maya --base flat --vdb-half --mesh-formats ply,glb,stl --stl-mm --cap-tolerance 0.05
expect 0 'units: cm' info maya/volume.vdb
expect 0 'half_on_disk: true' info maya/volume.vdb
expect 0 'CIEDE2000' evaluate maya --truth scene/truth.ply --samples 2000
check 'a mesh for another program is compared in the scene' grep -Eq 'volume.*[+-]?[0-9.]' stdout
expect 0 'model.glb' export maya -o model.glb colors.nvdb m.vdb --dcc houdini
expect 0 'Vec3f|vec3s' info colors.nvdb
expect 0 'Cd' info m.vdb
expect 0 'closed: true' info model.glb
expect 2 'small letters' export out -o MODEL.GLB

finish
