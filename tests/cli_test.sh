#!/usr/bin/env bash
# The command line as a user meets it: results, exit codes, messages.
#   cli_test.sh PROGRAM SOURCE_DIR
set -uo pipefail
program=$1 source=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
failures=0

# expect CODE 'PATTERN' ARGS…: the program must end with CODE and say PATTERN (stdout or stderr).
expect() {
  local code=$1 pattern=$2
  shift 2
  "$program" "$@" >stdout 2>stderr
  local got=$?
  # Not through a pipe: grep -q ends at the first match, and who writes into it then fails, now and then.
  if [ $got -ne "$code" ] || ! grep -Eq -- "$pattern" stdout stderr; then
    failures=$((failures + 1))
    echo "FAILED: vdbcarve $* -> exit $got (expected $code), wanted '$pattern', said:"
    sed 's/^/    /' stdout stderr
  fi
}
check() {
  if ! "${@:2}"; then
    failures=$((failures + 1))
    echo "FAILED: $1"
  fi
}

expect 0 'vdbcarve 0\.' --version
expect 0 'Examples:' --help
expect 0 '--max-misses' reconstruct --help
expect 2 'subcommand' 
expect 2 'frobnicate' frobnicate

expect 0 '6 views' synth ellipsoids -o scene --views 6 --width 120 --height 90
expect 6 'not empty' synth ellipsoids -o scene
expect 2 "no built-in object 'teapot'" synth teapot -o elsewhere
expect 0 'closed manifold' reconstruct scene -o out --resolution 40 --mesh-formats ply,obj,stl
check 'stdout stays empty unless data is asked for' test ! -s stdout
for file in volume.vdb mesh.ply mesh.obj mesh.stl cameras.json preview.png report.json config.toml masks/0000.png; do
  check "out/$file is there" test -s "out/$file"
done
check 'nothing temporary is left' test -z "$(find out -name '*.part*')"

# The written configuration repeats the run.
expect 0 'closed manifold' --config out/config.toml reconstruct scene -o out2
check 'the same mesh from the same configuration' cmp -s out/mesh.ply out2/mesh.ply
check 'the same volume from the same configuration' cmp -s out/volume.vdb out2/volume.vdb
expect 0 'closed manifold' --threads 1 reconstruct scene -o out1 --resolution 40
check 'one thread gives the same mesh' cmp -s out/mesh.ply out1/mesh.ply
check 'one thread gives the same volume' cmp -s out/volume.vdb out1/volume.vdb
# Our cameras.json is a camera file like any other.
expect 0 'closed manifold' reconstruct scene --cameras ../"$(basename "$work")"/out/cameras.json -o out3 --resolution 40

expect 0 '"event":"stage"' --json - reconstruct scene -o out4 --resolution 24
check 'every line of --json - is a JSON object' test -z "$(grep -v '^{.*}$' stdout)"
check 'the last line is the report' grep -q '"mesh"' <(tail -n 1 stdout)
check 'progress is told' grep -q '"event":"progress","stage":"carve","share":1' stdout
check 'warnings are told' grep -q '"event":"warning"' stdout
expect 2 '"event":"error","exit_code":2,"text":"the bounds' --json - reconstruct scene -o failed --bounds 50,50,50,51,51,51
mkdir shuffled && cp -r scene/* shuffled/ && mv shuffled/masks/0001.png m && mv shuffled/masks/0004.png shuffled/masks/0001.png && mv m shuffled/masks/0004.png
mv shuffled/masks/0002.png m && mv shuffled/masks/0005.png shuffled/masks/0002.png && mv m shuffled/masks/0005.png
expect 4 '"event":"error","exit_code":4' --json - reconstruct shuffled -o shuffled_out --resolution 24 --max-misses 4
check 'also of a result that is contradicted the report is last' grep -q '"mesh"' <(tail -n 1 stdout)
expect 0 'failed.tar.gz: [0-9.]+ MB, no photographs' bundle failed
check 'a bundle says what a run failed with' grep -q '"stage": "carve"' <(tar xzOf failed.tar.gz vdbcarve-bundle/failure/failure.json)
expect 0 'b.tar.gz' bundle out -o b.tar.gz --width 60
check 'a bundle is a scene' test -n "$(tar tzf b.tar.gz | grep scene/masks/0003.png)"
tar xzf b.tar.gz
expect 0 'closed manifold' reconstruct vdbcarve-bundle/scene -o replayed --resolution 24
check 'reconstruct writes the page' grep -q 'worst first' out/report.html
expect 3 'not made by vdbcarve' bundle scene
expect 3 'no such folder' bundle nowhere
# Photographs that arrive.
mkdir -p arriving/images arriving/masks && cp scene/transforms.json arriving/
for view in 0001 0003 0004 0005; do cp scene/masks/$view.png arriving/masks/; cp scene/images/$view.* arriving/images/; done
expect 0 '4 views: result' watch arriving -o live --resolution 40 --idle 1 --settle 0.2
for view in 0000 0002; do cp scene/masks/$view.png arriving/masks/; cp scene/images/$view.* arriving/images/; done
expect 0 'the hull of [45] views is extended by [12] view' watch arriving -o live --resolution 40 --until 6 --settle 0.2
expect 0 'closed manifold' reconstruct arriving --add arriving -o live --resolution 40
expect 2 'voxels of .* lie otherwise' reconstruct arriving --add arriving -o live --resolution 41
expect 0 'already there' filter live --filter median:1
expect 3 'no such folder' watch nowhere -o live
expect 3 'no such folder' reconstruct scene --add nowhere -o out
mkdir waits
expect 3 'neither cameras nor photographs' watch waits -o nothing --idle 0.3
# The pages are what the options say.
check 'pages are written' "$program" --write-pages pages
check 'tools/commands is up to date (vdbcarve --write-pages DIR, then its .md)' diff -r --exclude '*.1' pages "$source/tools/commands"
check 'there is a man page for every command' test "$(ls pages/*.1 | wc -l)" -eq "$(ls pages/*.md | wc -l)"
if command -v groff >/dev/null; then check 'man pages have no mistakes' test -z "$(groff -man -ww -Tutf8 pages/*.1 2>&1 >/dev/null)"; fi
# Cameras from silhouettes.
expect 0 '16 views' synth ellipsoids -o turn --views 16 --width 320 --height 240
expect 0 'cameras found: turntable' align turn --cameras none -o aligned --known-distance 300 --units mm
check 'cameras and a picture of the orbit' test -s aligned/cameras.json -a -s aligned/orbit.svg -a -s aligned/preview.png
expect 0 'median IoU 0.99' check turn --cameras ../"$(basename "$work")"/aligned/cameras.json
expect 2 '2 angles for 16 views' align turn --cameras none --angles 0,10 -o elsewhere
expect 2 'improves cameras' align turn --cameras none --method refine -o elsewhere
expect 2 'none of coherence, refine' align turn --method magic -o elsewhere
expect 2 '--known-distance: the cameras of .*transforms.json are used as they are.*Remedy: --method refine' reconstruct turn --known-distance 300 -o elsewhere
expect 2 '--direction, --arc auto: the cameras' reconstruct turn --direction cw --arc auto -o elsewhere
expect 2 '--units furlong: is none of m, cm, mm' align turn --cameras none --known-distance 3 --units furlong -o elsewhere
expect 2 '--orbit circle: is none of auto, turntable, fixed-camera, hand-held' align turn --cameras none --orbit circle -o elsewhere
expect 2 '--restarts is of --method coherence or refine, not of paper' align turn --cameras none --method paper --restarts 5 -o elsewhere
expect 2 '--mesher voxels: is none of dual, marching-cubes' reconstruct scene --mesher voxels -o elsewhere
expect 2 'no view is called 99' align turn --cameras none --known-length 99:1,2,3,4:5 -o elsewhere
expect 3 'is background in its mask' align turn --cameras none --known-length 0003:1,2,160,120:5 -o elsewhere
expect 0 'focal lengths, principal points and lenses are taken' align turn --restarts 0 -o again
expect 0 'method refine' align --help
expect 0 'cameras found' align turn --cameras none --no-features --orbit turntable --restarts 0 -o plain
check 'the configuration keeps what was switched off' grep -q 'no-features=true' plain/config.toml
check 'and words as they were said' grep -q 'orbit="turntable"' plain/config.toml
expect 2 '--units mm: cameras found from silhouettes know no scale.*Remedy: --known-height' reconstruct turn --cameras none --units mm -o elsewhere
expect 2 '--principal-point 9999,120: far outside' align turn --cameras none --principal-point 9999,120 -o elsewhere
expect 2 'no number above 0' align turn --cameras none --known-height -5 -o elsewhere
expect 0 'warning the focal length given, .* is not what the silhouettes say' align turn --cameras none --fov 100 -o fov
expect 5 'it turned the other way than --direction ccw says' align turn --cameras none --direction ccw --restarts 0 --known-height 12 --units mm -o wrong_height
expect 2 'whole numbers of views' align turn --cameras none --rings 8.5,7.5 -o elsewhere
expect 5 'UNVERIFIED' align turn --cameras none --direction ccw --fov 30 --restarts 0 -o wrong
check 'what is not verified is shown, apart' test -s wrong/unverified/preview.png -a ! -e wrong/cameras.json
expect 5 'UNVERIFIED' reconstruct turn --cameras ../"$(basename "$work")"/wrong/unverified/cameras.json -o elsewhere
expect 2 'neither a file nor|there is no such file' align turn --cameras none --angles nowhere.txt -o elsewhere
expect 2 '--up y: cameras that are found have z up' align turn --cameras none --up y -o elsewhere
expect 2 'are of --mask threshold' align turn --cameras none --threshold 20 -o elsewhere
expect 0 'says mm; its numbers are taken for m' reconstruct turn --cameras ../"$(basename "$work")"/aligned/cameras.json --units m --dry-run -o elsewhere
expect 0 'at 100 %.*175.0 mm wide' board -o mat.pdf
check 'the mat and its layout' test -s mat.pdf -a -s mat.pdf.json
expect 3 'Remedy: --mat mat.pdf.json' align turn --cameras none --method mat --mat mat.pdf -o elsewhere
expect 2 'incomplete .2 fields' align turn --cameras none --method mat --mat grid:5x7 -o elsewhere
expect 0 'mm wide' board --mat grid:5x7:0.03:0.005:DICT_6X6_250 -o spelt.png
expect 2 'lengths are in metres, 35 mm are 0.035' board --mat grid:5x7:35:5:6X6_250 -o mm.png
expect 2 'odd' board --mat charuco:7x8:0.03:0.02 -o mat.png
# Whatever vectors the machine has.
for set in generic avx2 avx512; do
  if VDBCARVE_SIMD=$set "$program" --quiet reconstruct scene -o "out_$set" --resolution 40 2>stderr; then
    check "$set gives the same mesh" cmp -s out/mesh.ply "out_$set/mesh.ply"
    check "$set gives the same volume" cmp -s out/volume.vdb "out_$set/volume.vdb"
  else
    check "$set is refused by name where it is not there" grep -q "this machine has" stderr
  fi
done
expect 0 'elevations' check scene
expect 0 '"median_iou"' check scene --json -
expect 0 '"findings"' check scene --only images --json -
expect 3 'no such folder' check nowhere
expect 0 'scene -> set' export scene --undistort -o set
check 'COLMAP gets cameras and pictures' test -s set/sparse/0/cameras.txt -a -s set/images/0000.png
expect 0 '' export out -o nerf/transforms.json
check 'and nerfstudio its file' grep -q fl_x nerf/transforms.json
expect 2 'undistort is of cameras' export out --undistort -o other.stl
expect 2 'video-range' mask scene -o nothing --video-range 3,1
expect 2 'must be auto or a height' reconstruct scene -o nothing --floor high
expect 0 'F-score' evaluate out --truth scene/truth.ply --samples 2000
expect 0 '"chamfer"' --json - evaluate out --truth scene/truth.ply --samples 2000 --align cameras --cameras out/cameras.json --truth-cameras scene
expect 3 'no such|cannot' evaluate out --truth nowhere.ply
expect 2 'wants --cameras' evaluate out --truth scene/truth.ply --align cameras
expect 0 'dense method' bench --grid 64x32x64 --views 4 --runs 1
expect 0 '6 views' synth cup -o hard --views 6 --width 96 --height 72 --motion turntable --table --gloss 0.5 --jpeg 90 --exif --noise 2 --blur 0.5 --mask-noise 0.5 --mask-blobs 1 --sittings 2
check 'damaged masks have their exact ones beside them' test -s hard/masks_true/0005.png
expect 0 'peak memory' reconstruct scene -o planned --resolution 64 --dry-run
expect 2 'memory-limit' reconstruct scene -o planned --resolution 64 --memory-limit 1M
expect 2 'must be > 0|finite' reconstruct scene -o planned --memory-limit lots
expect 0 'surface' info out
expect 0 '"grids"' info out/volume.vdb --json -
expect 0 'genus' info out/mesh.obj
expect 0 'focal_px' info scene
expect 0 'focal_px' info out/cameras.json
expect 0 'expected_bytes' reconstruct scene -o nothing --dry-run
check 'a dry run writes nothing' test ! -e nothing
expect 0 'closed manifold' reconstruct scene -o cubes --resolution 40 --mesher marching-cubes --normals
check 'normals are in the mesh' grep -aq 'property float nz' cubes/mesh.ply
check 'the mesher changes the mesh' test "$(cmp -s out/mesh.ply cubes/mesh.ply; echo $?)" -eq 1
check 'and nothing of the volume' cmp -s out/volume.vdb cubes/volume.vdb
expect 2 'marching-cubes' reconstruct scene -o cubes --resolution 40 --normals
expect 2 'adaptivity' reconstruct scene -o cubes --resolution 40 --mesher marching-cubes --adaptivity 0.5
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
expect 2 '--paper' bench --paper --grid 64x32x64
check 'the mesh has colours' grep -aq 'property uchar red' out/mesh.ply
expect 0 'CIEDE2000' evaluate out --truth scene/truth.ply --samples 2000
expect 0 'PSNR' evaluate out --photos scene --save pictures
check 'photograph and rendering lie side by side' test -s pictures/0005.png
expect 0 '"psnr_db"' --json - evaluate out --photos scene
expect 2 '--truth, --photos' evaluate out
expect 0 'closed manifold' reconstruct scene -o plain --resolution 40 --color none
check 'no colour where none is wanted' test "$(grep -ac 'property uchar red' plain/mesh.ply)" -eq 0
expect 3 'no vertex colours' evaluate plain --photos scene
expect 0 'closed manifold' reconstruct scene -o best --resolution 40 --color best --paper --color-occlusion off --exposure none --color-source images --color-depth 5 --color-leave-out 3 --color-grids views,confidence --dcc houdini
expect 0 'Cd' info best/volume.vdb
expect 0 'confidence' info best
expect 0 'left out of colour' evaluate best --photos scene
expect 2 '--color best' reconstruct scene -o bad --resolution 40 --paper
expect 2 'color' reconstruct scene -o bad --color rainbow
expect 2 'at least 2' reconstruct scene -o bad --resolution 40 --color-leave-out 1
expect 0 '6 views' synth pair -o pair --views 6 --width 96 --height 72 --exposure-jitter 0.2 --flat
expect 0 'color' reconstruct pair -o paired --resolution 40 --exposure channels
expect 0 '\| 6 \|' bench scene --grid 32x32x32 --runs 1 --backend cpu
expect 0 'MB freed' clean out
expect 3 'not made by vdbcarve' clean scene
expect 0 'carve .* s' carve scene -o carved --resolution 24
check 'carve leaves the raw hull' test -s carved/hull.vdb
expect 0 'hull' info carved
expect 0 'mask' mask scene -o masked
check 'mask leaves masks' test -s masked/masks/0005.png

# Mistakes: message and exit code.
expect 2 'resolution' reconstruct scene -o bad --resolution -5
expect 2 'one of --resolution' reconstruct scene -o bad --resolution 5 --voxel-size 1
expect 2 '6 numbers' reconstruct scene -o bad --bounds 1,2,3
expect 2 "'x' is not a finite number" reconstruct scene -o bad --bounds 1,2,3,4,5,x
expect 2 'where the cameras look' reconstruct scene -o bad --resolution 20 --bounds 100,100,100,101,101,101
expect 3 'no such folder' reconstruct nowhere -o bad
if "$program" bench --no-cpu --grid 32x32x32 --views 4 --runs 1 >/dev/null 2>&1; then
  # A GPU is here: the same files.
  expect 0 'closed manifold' reconstruct scene -o gpu --resolution 40 --backend cuda
  check 'the GPU gives the same mesh' cmp -s out/mesh.ply gpu/mesh.ply
  check 'the GPU gives the same volume' cmp -s out/volume.vdb gpu/volume.vdb
  check 'the report names the backend' grep -q '"backend": "cuda"' gpu/report.json
  check 'colour was made on the GPU' grep -q '"color"' <(grep -B4 '"backend": "cuda"' gpu/report.json; grep -A4 '"backend": "cuda"' gpu/report.json)
  expect 7 '--device 99' reconstruct scene -o bad --backend cuda --device 99
else
  expect 7 'without CUDA|no CUDA device.*Remedy: --backend cpu' reconstruct scene -o bad --backend cuda
  check 'without a GPU auto means the CPU' grep -q '"backend": "cpu"' out/report.json
fi

# Filters, smoothing, files for programs.
check 'a .glb comes by itself' test -s out1/mesh.glb
expect 0 'colors: true' info out1/mesh.glb
expect 0 'filter gaussian:1x1: volume' filter out1 --filter gaussian:1
check 'the filter changes the mesh' test "$(cmp -s out/mesh.ply out1/mesh.ply; echo $?)" -eq 1
expect 0 'carve .*already there' filter out1 --filter auto
check 'and back again' cmp -s out/mesh.ply out1/mesh.ply
expect 0 'closed manifold' filter out1 --filter gaussian:2 --no-volume-repair --keep-thin 0
expect 0 'filter takes [0-9.]+ % of the volume \([^)]*\)\. Remedy' mesh out1 --adaptivity 0.1
check 'a refused option leaves the configuration alone' grep -q 'gaussian:2' out1/config.toml
expect 2 'smooth-mu' smooth out1 --smooth 3 --smooth-lambda 0.9
check 'so the result and its configuration still fit' grep -q 'gaussian:2' out1/config.toml
expect 0 'closed manifold' filter out1 --filter auto --adaptivity 0
expect 0 'closed manifold' smooth out1 --smooth 5 --faces 1000 --mesh-formats ply,obj --quads
check 'no .glb where none is wanted' test ! -e out1/mesh.glb
expect 0 'faces: (9[0-9][0-9]|1000)$' info out1/mesh.ply
expect 0 'closed manifold' mesh out1 --mesher marching-cubes --min-piece 0.2 --quads=false
expect 0 'closed manifold' color out1 --color best
expect 0 'reconstruct' filter --help
expect 3 'config.toml: is not there' filter scene
expect 2 'Is --resolution meant' reconstruct scene -o bad --resolutoin 64
expect 2 'only one can count' reconstruct scene -o bad --mask threshold --clean-plate scene/images/0000.png
expect 2 'are of films' reconstruct scene -o bad --video-frames 30
expect 2 'R,G,B within' mask scene -o bad --mask chroma --chroma-key green
expect 3 'no such folder or film' reconstruct film.mp4 -o bad
expect 2 "'blur' is no filter" reconstruct scene -o bad --filter blur
expect 2 '1..2 voxels' reconstruct scene -o bad --filter median:7
expect 2 'keep-thin' reconstruct scene -o bad --resolution 40 --keep-thin -1
expect 2 'smooth-mu' reconstruct scene -o bad --resolution 40 --smooth 3 --smooth-mu -0.1
expect 0 'closed manifold' reconstruct scene -o wide --resolution 40 --smooth 3 --smooth-lambda 0.5 --smooth-pass-band 0.1
expect 2 '--units' reconstruct scene -o bad --resolution 40 --stl-mm
expect 2 'none of ply' reconstruct scene -o bad --resolution 40 --mesh-formats fbx
expect 0 'closed manifold' reconstruct scene -o maya --resolution 40 --units m --dcc maya --base flat --vdb-half --mesh-formats ply,glb,stl --stl-mm --cap-tolerance 0.05
expect 0 'units: cm' info maya/volume.vdb
expect 0 'half_on_disk: true' info maya/volume.vdb
expect 0 'CIEDE2000' evaluate maya --truth scene/truth.ply --samples 2000
check 'a mesh for another program is compared in the scene' grep -Eq 'volume.*[+-]?[0-9.]' stdout
expect 0 '80 x 60 pixels' render out -o picture.png --size 80x60
check 'a picture is a PNG' test "$(head -c 4 picture.png | tail -c 3)" = PNG
expect 0 '2[0-9][0-9] x|1[0-9][0-9] x' render out -o view.png --view 0001 --background none --samples 1
expect 0 'each, 3 of them' render out -o sheet.png --sheet 3
expect 0 'each, 4 of them' render out -o slices.png --style slices --slices 4 --size 200x200
expect 0 '64 x 64' render out/volume.vdb -o voxels.png --style voxels --size 64x64 --no-color
expect 0 '64 x 64' render out/mesh.ply -o mesh.png --size 64x64
expect 0 'each, 6 of them' render out -o turn.mp4 --frames 6 --size 64x64 --samples 1
check 'a film is written' test -s turn.mp4
expect 2 'must be even' render out -o odd.mp4 --size 65x64
expect 2 'no view is called 99' render out -o view.png --view 99
expect 0 'report.html: [0-9.]+ MB' report out
check 'the page is there' grep -q 'worst first' out/report.html
expect 3 'report.json: is not there' report scene
expect 2 'the extension says' render out -o picture.jpg
expect 2 'no voxels' render out/mesh.ply -o bad.png --style voxels
expect 3 'no such file' render nowhere -o bad.png
expect 0 'model.glb' export maya -o model.glb colors.nvdb m.vdb --dcc houdini
expect 0 'Vec3f|vec3s' info colors.nvdb
expect 0 'Cd' info m.vdb
expect 0 'closed: true' info model.glb
expect 2 'small letters' export out -o MODEL.GLB
mkdir foreign && touch foreign/file
expect 6 'not made by vdbcarve' reconstruct scene -o foreign
expect 6 'cannot be made|is a file' reconstruct scene -o foreign/file/out
cp -r scene broken && rm broken/images/0002.png
expect 3 '0002.png: image not found' reconstruct broken -o bad
expect 0 'left out' reconstruct broken -o partial --allow-missing --resolution 24
cp -r scene broken2 && sed -i 's/"fl_x": [0-9.]*/"fl_x": -1.0/' broken2/transforms.json
expect 3 'fx is -1' reconstruct broken2 -o bad
cp -r scene broken3 && cp broken3/images/0001.png broken3/masks/0001.png
expect 3 'masks/0001.png: is coloured' reconstruct broken3 -o bad
mkdir empty
expect 3 'neither cameras nor photographs' reconstruct empty -o bad
check 'no failed run left a result' test ! -e bad/mesh.ply

# Interrupted, then resumed.
expect 0 'views' synth cup -o long --views 12 --width 200 --height 150 --masks-only
"$program" reconstruct long -o resumed --resolution 700 >stdout 2>stderr & pid=$!
sleep 1.5
kill -INT $pid
wait $pid
code=$?
check "an interrupted run ends with 130 (or had finished), not $code" test $code -eq 130 -o $code -eq 0
expect 0 'closed manifold' reconstruct long -o resumed --resolution 700
check 'nothing temporary is left after resuming' test -z "$(find resumed -name '*.part*')"

[ $failures -eq 0 ] && echo "all command-line checks passed" || echo "$failures command-line checks failed"
exit $((failures > 0))
