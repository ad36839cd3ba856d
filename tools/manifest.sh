#!/usr/bin/env bash
# Compares the final files of two builds of vdbcarve over small synthetic shoots:
#   tools/manifest.sh OLD NEW [--backend cpu|cuda] [--keep FOLDER] [--only NAME]… [--list]
# OLD and NEW are programs. OLD makes the shoots, then both run every case in folders of the same shape. Final files are all files of a result except stages/
# (an internal cache), config.toml and report.html (times and paths); report.json is compared key by key without times, memory and paths.
# One line a case; exit 1 when anything differs. Needs bash and python3, so it also runs on a bare machine with a GPU (tools/pack_portable.sh packs the programs).
# --keep FOLDER: shoots and results stay there, and what OLD made is used again by the next call with the same OLD. --only may be given several times.
set -uo pipefail
usage() { sed -n '2,3p' "$0" | cut -c3- >&2; exit 2; }

programs=() backend=cpu keep='' only=() list=no
while [ $# -gt 0 ]; do
  case $1 in
    --backend) backend=${2:?--backend wants cpu or cuda}; shift 2 ;;
    --keep) keep=${2:?--keep wants a folder}; shift 2 ;;
    --only) only+=("${2:?--only wants the name of a case}"); shift 2 ;;
    --list) list=yes; shift ;;
    -*) usage ;;
    *) programs+=("$1"); shift ;;
  esac
done

# --- shoots: scene_NAME writes into the folder NAME of the working folder ---
scene_orbit() { v synth ellipsoids -o orbit --views 12 --width 240 --height 180; }
scene_high() {  # a second ring of the same object, its photographs under other names
  v synth ellipsoids -o high --views 6 --width 240 --height 180 --elevation 45 && (
    cd high && for file in images/*.png masks/*.png; do mv "$file" "${file%/*}/high_${file##*/}"; done
    sed -i 's#images/#images/high_#; s#masks/#masks/high_#' transforms.json)
}
scene_turn() { v synth ellipsoids -o turn --views 24 --width 320 --height 240 --shake 0.2; }
scene_checks() { v synth bowl -o checks --views 16 --width 320 --height 240 --rig rings --pattern checks; }
scene_table() { v synth ellipsoids -o table --rig rings --views 12 --width 320 --height 240 --table --plates; }
scene_wrong() {  # a hole in one mask, and another view's in the place of a second
  v synth cup -o wrong --views 12 --width 240 --height 180 && cp wrong/masks/0007.png wrong/masks/0002.png
}
scene_film() { v synth ellipsoids -o film --views 48 --width 200 --height 150 --film 24 --backdrop 0.05,0.45,0.1; }
scene_cup() { v synth cup -o cup --views 10 --width 320 --height 240 --lens=-0.15,0.03,0.001,-0.001 --jpeg 92 --exif --exposure-jitter 0.2; }
scene_mat() {  # a slab with the mat printed on it, and a box on the slab
  mkdir -p mat_parts && v board --mat grid:5x7:0.03:0.008:6X6_250 -o mat_parts/mat.png && python3 - mat_parts/slab.obj <<'PY' &&
import sys
half_x, half_y = 0.101, 0.139  # five and seven markers, their gaps and the margin
vertices, texture, faces = [], ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "vt 0.01 0.01"], []
def box(low, high, printed):
    first = len(vertices) + 1
    vertices.extend(f"v {x} {y} {z}" for z in (low[2], high[2]) for x, y in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])))
    for quad in ((3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)):
        place = (1, 2, 3, 4) if printed and quad[0] == 4 else (5, 5, 5, 5)
        for corners in ((0, 1, 2), (0, 2, 3)):
            faces.append("f " + " ".join(f"{first + quad[c]}/{place[c]}" for c in corners))
box((-half_x, -half_y, -0.03), (half_x, half_y, 0), True)
box((-0.03, -0.02, 0.0001), (0.03, 0.02, 0.05), False)
open(sys.argv[1], "w").write("\n".join(vertices + texture + faces) + "\n")
PY
  v synth mat_parts/slab.obj --texture mat_parts/mat.png -o mat --rig dome --views 12 --width 512 --height 384 --flat
}

# --- cases: case_NAME writes into folders of the folder NAME; `scenes` before it names its shoots ---
declare -A scenes=()
scenes[orbit]=orbit
case_orbit() { r $s/orbit -o orbit/out --resolution 64 --mesh-formats ply,obj,glb,stl; }

scenes[found]=turn
case_found() { r $s/turn --cameras none -o found/out --resolution 56 --known-height 120 --units mm; }

scenes[refused]=turn  # cameras that are found and must not be trusted: exit 5, unverified/
case_refused() { expect 5 reconstruct $s/turn --cameras none --direction ccw --fov 30 --restarts 0 -o refused/out --resolution 48; }

scenes[mat]=mat  # the slab below the mat's plane is cut away, so the result is written but contradicts its masks: exit 4
case_mat() { expect 4 reconstruct $s/mat --method mat --mat $s/mat_parts/mat.png.json -o mat/out --resolution 56 --backend "$backend"; }

scenes[video]=film  # the cameras get the frames' names
case_video() {
  ok mask $s/film/film.mp4 --mask chroma --video-frames 12 -o video/out && python3 - $s/film/transforms.json video/out/report.json video/cameras.json <<'PY' &&
import json, os, sys
cameras, report = (json.load(open(p)) for p in sys.argv[1:3])
views = {f["file_path"]: f for f in cameras["frames"]}
names = sorted(views)
cameras["frames"] = [dict({k: v for k, v in views[names[f["index"]]].items() if k != "mask_path"}, file_path=f["name"]) for f in report["video"]["frames"]]
json.dump(cameras, open(sys.argv[3], "w"))
PY
  r $s/film/film.mp4 --mask chroma --video-frames 12 --cameras video/cameras.json -o video/out --resolution 56
}

scenes[add]='orbit high'
case_add() {  # views of a second folder, then photographs that come later
  r $s/orbit -o add/out --resolution 56 && r $s/orbit --add $s/high -o add/out --resolution 56 &&
    mkdir -p add/shoot/images add/shoot/masks && cp $s/orbit/transforms.json add/shoot && cp $s/orbit/images/000[0-6].png add/shoot/images && cp $s/orbit/masks/000[0-6].png add/shoot/masks &&
    r add/shoot --allow-missing -o add/late --max-misses 1 --resolution 56 && cp $s/orbit/images/*.png add/shoot/images && cp $s/orbit/masks/*.png add/shoot/masks &&
    r add/shoot --allow-missing --add add/shoot -o add/late --max-misses 1 --resolution 56
}

scenes[bricks]=orbit
case_bricks() { ok carve $s/orbit -o bricks/out --resolution 200 --memory-limit 1M --backend "$backend"; }

scenes[occupancy]=orbit
case_occupancy() { r $s/orbit -o occupancy/out --occupancy --resolution 64 --color-source images; }

scenes[stereo]=checks
case_stereo() { r $s/checks -o stereo/out --stereo on --stereo-scale 1 --stereo-maps --resolution 48 --mesh-formats ply; }

scenes[repair]=wrong
case_repair() { r $s/wrong -o repair/out --repair-masks --resolution 64 && r $s/wrong -o repair/forgiven --max-misses 1 --resolution 48; }

scenes[floor]=table
case_floor() {
  r $s/table --clean-plate $s/table/plates --floor auto --up z -o floor/found --resolution 64 && r $s/table --floor 0.02 --up z --base flat -o floor/given --resolution 64
}

scenes[formats]=orbit
case_formats() {
  r $s/orbit -o formats/all --resolution 64 --mesher marching-cubes --normals --filter median:1 --smooth 5 --mesh-formats ply,obj,glb,stl &&
    r $s/orbit -o formats/houdini --resolution 64 --dcc houdini --vdb-half --units cm --up z --color best --color-grids views,confidence --color-leave-out 3 --quads
}

scenes[again]=cup  # a lens and JPEG photographs; then one stage after the other again
case_again() {
  r $s/cup -o again/out --resolution 72 && ok filter again/out --filter gaussian:1 && ok color again/out --color best && ok smooth again/out --smooth 5 --faces 1500 &&
    ok mesh again/out --adaptivity 0.2 --faces 0 && r $s/cup -o again/edited --resolution 72 &&
    cp again/edited/masks/"$(ls again/edited/masks | sed -n 2p)" again/edited/masks/"$(ls again/edited/masks | sed -n 3p)" && r $s/cup -o again/edited --resolution 72
}

scenes[masks]='film cup'  # masks made from photographs
case_masks() {
  ok mask $s/cup -o masks/threshold --mask threshold --mask-close 1 && ok mask $s/film -o masks/grabcut --mask grabcut && ok mask $s/film -o masks/chroma --mask chroma &&
    r $s/film -o masks/model --mask chroma --resolution 48 --color none
}

scenes[align]=turn  # cameras improved, and cameras of the paper's method
case_align() { ok align $s/turn --cameras $s/turn/transforms_nominal.json --method refine -o align/refined && ok align $s/turn --cameras none --rings 24 --no-features --restarts 0 -o align/plain; }

scenes[other]=orbit  # what the other commands write
case_other() {
  r $s/orbit -o other/out --resolution 56 --bounds=-1,-1,-1,1,1,0.3 --silhouette-offset 0.5 --outside background --min-piece 0.01 &&
    ok export other/out -o other/volume.nvdb other/model.stl && ok export other/out --undistort -o other/set && ok render other/out -o other/picture.png --size 160x120 &&
    ok render other/out -o other/xray.png --style xray --size 160x120
}
cases=(orbit found refused mat video add bricks occupancy stereo repair floor formats again masks align other)

if [ $list = yes ]; then printf '%s\n' "${cases[@]}"; exit 0; fi
[ ${#programs[@]} -eq 2 ] && { [ "$backend" = cpu ] || [ "$backend" = cuda ]; } || usage
for name in ${only[@]+"${only[@]}"}; do
  [ -n "${scenes[$name]:-}" ] || { echo "manifest: no case is called '$name'; --list names them" >&2; exit 2; }
done
for program in "${programs[@]}"; do [ -x "$program" ] || { echo "manifest: $program is not a program" >&2; exit 2; }; done
old=$(realpath "${programs[0]}") new=$(realpath "${programs[1]}")
if [ -n "$keep" ]; then mkdir -p "$keep"; work=$(realpath "$keep"); else work=$(mktemp -d); trap 'rm -rf "$work"' EXIT; fi

# v ARGS…: runs $program quietly.  expect CODE ARGS…: it must end with CODE.  ok, r: with 0; r reconstructs with the backend.
v() { "$program" --quiet "$@"; }
expect() {
  local code=$1 got=0
  shift
  v "$@" >"$name.said" 2>&1 || got=$?
  [ $got -eq "$code" ] || { echo "vdbcarve $* ended with $got, not $code: $(tail -n 1 "$name.said")"; return 1; }
}
ok() { expect 0 "$@"; }
r() { ok reconstruct "$@" --backend "$backend"; }

# A case runs in $work/SIDE, so that shoots and results have the same relative paths on both sides.
s=../shoots
make_shoot() {
  [ -e "$work/shoots/$1.made" ] && return
  (cd "$work/shoots" && program=$old && "scene_$1" && touch "$1.made") 2>"$work/said" || { echo "the shoot $1 cannot be made: $(tail -n 1 "$work/said")"; return 1; }
}
run_case() {  # SIDE PROGRAM CASE
  mkdir -p "$work/$1" && rm -rf "${work:?}/$1/$3" "$work/$1/$3".* && mkdir "$work/$1/$3"
  (cd "$work/$1" && program=$2 name=$3 && "case_$3")
}
compare() {  # CASE: prints what differs
  python3 - "$work/old/$1" "$work/new/$1" <<'PY'
import json, os, re, sys
VOLATILE = re.compile(r"(.*_)?(seconds|milliseconds)$|peak_rss_bytes$|expected_peak_bytes$")  # the last holds what the process has already
def files(root):
    found = {}
    for folder, below, names in os.walk(root):
        below[:] = sorted(n for n in below if n != "stages")
        for n in names:
            path = os.path.join(folder, n)
            found[os.path.relpath(path, root)] = path
    return found
def place_free(value):  # where a result lies, and the keys of stages/
    if not isinstance(value, str):
        return value
    for side in sys.argv[1:3]:
        value = value.replace(os.path.dirname(side), "SIDE")
    return re.sub(r"(stages/[a-z_]+)-[0-9a-f]{8,}", r"\1", value)
def differences(a, b, where=""):
    if isinstance(a, dict) and isinstance(b, dict):
        a, b = ({place_free(k): v for k, v in side.items()} for side in (a, b))
        for key in sorted(a.keys() | b.keys()):
            if VOLATILE.match(key):
                continue
            at = f"{where}.{key}" if where else key
            if key not in a or key not in b:
                yield f"{at} is {'new' if key in b else 'gone'}"
            else:
                yield from differences(a[key], b[key], at)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for n, (x, y) in enumerate(zip(a, b)):
            yield from differences(x, y, f"{where}[{n}]")
    elif type(a) != type(b) or place_free(a) != place_free(b):
        short = lambda v: (lambda t: t if len(t) < 60 else t[:57] + "...")(json.dumps(v))
        yield f"{where}: {short(a)} -> {short(b)}"
old, new = files(sys.argv[1]), files(sys.argv[2])
said = [f"{name} is {'new' if name in new else 'gone'}" for name in sorted(old.keys() ^ new.keys())]
for name in sorted(old.keys() & new.keys()):
    base = os.path.basename(name)
    if base in ("report.html", "config.toml"):
        continue
    a, b = (open(side[name], "rb").read() for side in (old, new))
    if a == b:
        continue
    if base == "report.json":
        said += [f"{name}: {d}" for d in differences(json.loads(a), json.loads(b))]
    else:
        said.append(f"{name} ({len(a)} -> {len(b)} bytes)")
print("\n".join(said))
PY
}

mkdir -p "$work/shoots"
differ=() start=$SECONDS
for name in "${cases[@]}"; do
  [ ${#only[@]} -eq 0 ] || [[ " ${only[*]} " == *" $name "* ]] || continue
  begun=$SECONDS trouble=''
  for shoot in ${scenes[$name]}; do trouble+=$(make_shoot "$shoot"); done
  # What OLD made is used again where it is the same program.
  stamp="$old $(stat -c '%s %Y' "$old") $backend"
  if [ -z "$trouble" ] && [ "$(cat "$work/old/$name.stamp" 2>/dev/null)" != "$stamp" ]; then
    trouble=$(run_case old "$old" "$name") && echo "$stamp" >"$work/old/$name.stamp"
  fi
  [ -n "$trouble" ] || trouble=$(run_case new "$new" "$name")
  [ -n "$trouble" ] || trouble=$(compare "$name")
  if [ -z "$trouble" ]; then
    printf '%-10s same     %4d files, %3d s\n' "$name" "$(find "$work/new/$name" -type f -not -path '*/stages/*' | wc -l)" $((SECONDS - begun))
  else
    differ+=("$name")
    printf '%-10s DIFFERS: %s\n' "$name" "$(head -n 1 <<<"$trouble")"
    tail -n +2 <<<"$trouble" | head -n 11 | sed 's/^/           /'
    [ "$(wc -l <<<"$trouble")" -le 12 ] || echo "           and $(($(wc -l <<<"$trouble") - 12)) more"
  fi
done
if [ ${#differ[@]} -eq 0 ]; then
  echo "all cases are the same ($((SECONDS - start)) s)"
else
  echo "${#differ[@]} cases differ: ${differ[*]} ($((SECONDS - start)) s)"
  exit 1
fi
