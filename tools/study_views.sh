#!/usr/bin/env bash
# How much too large the hull is, by number and place of the views: the tables of BENCHMARKS.md.
#   tools/study_views.sh PROGRAM WORK_FOLDER [MESH…]     meshes: closed, z up; each becomes a row like the built-in objects
set -euo pipefail
program=$(realpath "$1") work=$2
shift 2
meshes=()
for m in "$@"; do meshes+=("$(realpath "$m")"); done
mkdir -p "$work"
cd "$work"
cat >ellipsoid.json <<'SPEC'
{"name": "ellipsoid", "solids": [{"type": "ellipsoid", "size": [0.5, 0.35, 0.6], "turn_deg": [20, 10, 0]}]}
SPEC
cat >cube.json <<'SPEC'
{"name": "cube", "solids": [{"type": "box", "size": [0.5, 0.5, 0.5], "turn_deg": [0, 0, 22.5]}]}
SPEC

# excess NAME SYNTH_ARGUMENTS…: percent by which the hull's volume exceeds the truth's
excess() {
  local name=$1
  shift
  rm -rf scene "out_$name"
  "$program" --quiet synth "$@" --masks-only -o scene
  "$program" --quiet reconstruct scene -o "out_$name" --resolution 256 --surface hull 2>/dev/null
  python3 - "out_$name" "$program" <<'PY'
import json, subprocess, sys
got = json.load(open(sys.argv[1] + "/report.json"))["mesh"]["volume"]
truth = json.loads(subprocess.run([sys.argv[2], "--quiet", "--json", "-", "info", "scene/truth.ply"], capture_output=True, text=True).stdout)["mesh"]["volume"]
print(f"{100 * (got / truth - 1):.1f}")
PY
}

size=(--width 640 --height 480)
echo "| object, level ring (elevation 0) | 4 | 8 | 12 | 16 | 24 | 36 | 72 | 18 + 18 at 35 degrees |"
echo "|---|---|---|---|---|---|---|---|---|"
for object in ellipsoid.json cup "${meshes[@]}"; do
  row="| $(basename "${object%.*}")"
  for n in 4 8 12 16 24 36 72; do row="$row | $(excess ring "$object" --views $n --elevation 0 "${size[@]}") %"; done
  echo "$row | $(excess rings "$object" --rig rings --views 36 "${size[@]}") % |"
done
echo
echo "| cube, 36 views, field of view | 12 | 25 | 40 | 60 | 80 | 100 | parallel |"
echo "|---|---|---|---|---|---|---|---|"
row="| volume excess"
for fov in 12 25 40 60 80 100; do row="$row | $(excess "fov$fov" cube.json --views 36 --elevation 0 --fov $fov "${size[@]}") %"; done
echo "$row | $(excess parallel cube.json --views 36 --elevation 0 --orthographic "${size[@]}") % |"
