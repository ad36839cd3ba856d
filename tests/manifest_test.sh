#!/usr/bin/env bash
# One build, several routes to the same result: final files must have the same bytes however a run got there.
#   manifest_test.sh PROGRAM
# tools/manifest.sh compares two builds instead. Not compared: stages/, and report.json, report.html and config.toml (times, paths, what was reused).
set -uo pipefail
program=$(realpath "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
failures=0
fail() { failures=$((failures + 1)); echo "FAILED: $1"; }
v() { "$program" --quiet "$@" >said 2>&1 || { fail "vdbcarve $* ended with $?: $(tail -n 1 said)"; return 1; }; }

sums() { (cd "$1" && find . -type f -not -path './stages/*' -not -name 'report.*' -not -name config.toml -print0 | sort -z | xargs -0 sha256sum); }
same() {  # WHAT FOLDER [AS]: FOLDER's final files are those of AS
  local difference
  difference=$(diff <(sums "${3:-whole}") <(sums "$2") | sed -n 's/^[<>] [0-9a-f]*  //p' | sort -u | tr '\n' ' ')
  [ -z "$difference" ] || fail "$1: another $difference"
}
# What is stored, in the order in which it was: one name for the files of a stage, whatever their extensions.
stored_in() { find "$1/stages" -mindepth 1 -maxdepth 1 -not -name '.*' -not -name 'made_by*' -printf '%T@ %f\n' | sort -n | cut -d' ' -f2 | cut -d. -f1 | awk '!seen[$0]++'; }

# Every stage has something to do: cameras are found, masks come from photographs, depth, colour, a filter, smoothing, every format.
v synth ellipsoids -o shoot --views 16 --width 240 --height 180 --backdrop 0.05,0.45,0.1
masked=(shoot --cameras none --mask chroma)
run() {
  v reconstruct "${masked[@]}" --restarts 0 --up z --floor auto --resolution 48 --stereo on --stereo-scale 2 --filter edge-preserving:1 --smooth 2 \
    --mesh-formats 'ply,obj,glb,stl' --color-grids 'views,confidence' "$@"
}
run -o whole
[ -s whole/volume.vdb ] || { echo "there is no result to compare with"; cat said; exit 1; }

run -o whole_again
same 'the same run in another folder' whole_again
run -o one_thread --threads 1
same 'one thread' one_thread

# A run that ended after each stage in turn: what was stored later is gone, and so are the final files.
mapfile -t stored < <(stored_in whole_again)
[ ${#stored[@]} -ge 6 ] || fail "only ${#stored[@]} stages are stored: ${stored[*]}"
for ((n = ${#stored[@]} - 1; n >= 0; --n)); do
  rm -rf resumed
  mkdir -p resumed
  cp -rp whole_again/stages resumed/stages
  for late in "${stored[@]:n}"; do rm -rf "resumed/stages/$late"*; done
  run -o resumed && same "resumed without ${stored[n]} and what follows" resumed
done
# Any one stage lost, all others there.
for name in "${stored[@]}"; do
  rm -rf "resumed/stages/${name:?}"*
  run -o resumed && same "resumed without ${name} alone" resumed
done

# Stopped on purpose, and continued.
v mask "${masked[@]}" -o stopped && v align "${masked[@]}" --restarts 0 -o stopped && v carve "${masked[@]}" --restarts 0 --up z --floor auto --resolution 48 -o stopped &&
  run -o stopped && rm -rf stopped/hull.vdb stopped/overlays &&  # what those commands write for their own sake stays
  same 'mask, align and carve first' stopped

[ $failures -eq 0 ] && echo "all routes give the same files" || echo "$failures routes do not"
exit $((failures > 0))
