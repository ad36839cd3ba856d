#!/usr/bin/env bash
# The main job from nothing: packages, build, a synthetic shoot of a cup, its reconstruction.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/install_deps.sh
tools/build.sh release
program=build/release/vdbcarve
rm -rf out/demo_scene
"$program" synth data/cup.json -o out/demo_scene
"$program" reconstruct out/demo_scene -o out/demo --mesh-formats ply,obj,stl --resolution 384
"$program" info out/demo/mesh.ply
cat <<MESSAGE

Photographs, masks and cameras:  $PWD/out/demo_scene
Volume (Blender, Houdini, Maya): $PWD/out/demo/volume.vdb
Mesh:                            $PWD/out/demo/mesh.ply (.obj, .stl)
How well it fits the photos:     $PWD/out/demo/preview.png, report.json
MESSAGE
