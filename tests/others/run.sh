#!/usr/bin/env bash
# Other people's readers open what the program writes: run.sh PROGRAM SOURCE TOOL, TOOL one of gltf_validator, blender, chromium, colmap, open3d, python_openvdb, vdb_print. Exit code 77 where the tool is not there.
set -euo pipefail
program=$1 source=$2 tool=$3
here=$source/tests/others
skip() { echo "skipped: $1 is not here (tools/install_deps.sh --dev)"; exit 77; }
python=/usr/bin/python3
case $tool in
  gltf_validator) { command -v node && test -d "$source/build/node/node_modules/gltf-validator"; } >/dev/null || skip 'node with gltf-validator' ;;
  blender) command -v blender >/dev/null || skip Blender ;;
  chromium)
    command -v chromium >/dev/null || skip Chromium
    test -d "$source/build/node/node_modules/@google/model-viewer" || skip 'model-viewer, from npm' ;;
  colmap) command -v colmap >/dev/null || skip COLMAP ;;
  open3d) "$python" -c 'import open3d' 2>/dev/null || skip 'Open3D for Python' ;;
  python_openvdb) "$python" -c 'import pyopenvdb' 2>/dev/null || skip 'OpenVDB for Python' ;;
  vdb_print) command -v vdb_print >/dev/null || skip vdb_print ;;
esac
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
"$program" --quiet synth ellipsoids -o scene --views 12 --width 320 --height 240
"$program" --quiet reconstruct scene -o out --resolution 56 --mesh-formats ply,obj,glb,stl --units mm --up z --stl-mm
"$program" --json - info out/mesh.ply >ply.json
case $tool in
  gltf_validator)
    "$program" --quiet reconstruct scene -o plain --resolution 40 --mesh-formats glb --color none --mesher marching-cubes --normals --units m --up z
    node "$here/validate_gltf.js" "$source/build/node/node_modules/gltf-validator" out/mesh.glb plain/mesh.glb ;;
  blender)
    "$program" --quiet reconstruct scene -o preset --resolution 56 --mesh-formats ply,obj,glb,stl --units mm --up y --dcc blender --vdb-half
    blender -b --factory-startup --python-exit-code 3 --python "$here/blender_check.py" -- out ply.json preset | grep -v '^Blender\|^$' ;;
  chromium)
    "$program" --quiet report out  # written anew, as somebody does who has no reconstruct at hand
    "$python" "$here/report_page.py" chromium out/report.html . ;;
  colmap)  # reads the model, and writes it as binary, which we read again
    "$program" --quiet export out --undistort -o set
    colmap model_analyzer --path set/sparse/0 2>&1 | tee said
    grep -q 'Registered images: 12' said || { echo "COLMAP does not see 12 images"; exit 1; }
    mkdir -p again/sparse/0
    mv set/images set/masks again/
    colmap model_converter --input_path set/sparse/0 --output_path again/sparse/0 --output_type BIN >/dev/null
    "$program" --quiet check again | tee said
    grep -q 'median IoU 0.99' said || { echo "what COLMAP wrote does not fit the masks"; exit 1; } ;;
  open3d) "$python" "$here/open3d_check.py" out ;;
  python_openvdb)
    "$program" --quiet export out -o half.vdb --vdb-half
    "$python" "$here/openvdb_check.py" out half.vdb ;;
  vdb_print)
    vdb_print -l out/volume.vdb | tee list
    for text in 'surface' 'density' 'color' 'level set' 'fog volume' 'creator' 'vdbcarve' 'units: mm' 'up_axis: z'; do
      grep -q -- "$text" list || { echo "vdb_print does not say '$text'"; exit 1; }
    done ;;
esac
