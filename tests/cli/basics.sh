#!/usr/bin/env bash
# Help, what a run tells programs and people, the small commands.
source "${0%/*}/common.sh"
use scene out

expect 0 'vdbcarve 0\.' --version
expect 0 'Examples:' --help
expect 0 '--max-misses' reconstruct --help
expect 2 'subcommand' 
expect 2 'frobnicate' frobnicate
expect 6 'not empty' synth ellipsoids -o scene
expect 2 "no built-in object 'teapot'" synth teapot -o elsewhere
expect 0 '"event":"stage"' --json - reconstruct scene -o out4 --resolution 24
check 'every line of --json - is a JSON object' test -z "$(grep -v '^{.*}$' stdout)"
check 'the last line is the report' grep -q '"mesh"' <(tail -n 1 stdout)
check 'progress is told' grep -q '"event":"progress","stage":"carve","share":1' stdout
check 'warnings are told' grep -q '"event":"warning"' stdout
mkdir shuffled && cp -r scene/* shuffled/ && mv shuffled/masks/0001.png m && mv shuffled/masks/0004.png shuffled/masks/0001.png && mv m shuffled/masks/0004.png
mv shuffled/masks/0002.png m && mv shuffled/masks/0005.png shuffled/masks/0002.png && mv m shuffled/masks/0005.png
expect 4 '"event":"error","exit_code":4' --json - reconstruct shuffled -o shuffled_out --resolution 24 --max-misses 4
check 'also of a result that is contradicted the report is last' grep -q '"mesh"' <(tail -n 1 stdout)
expect 0 'dense method' bench --grid 64x32x64 --views 4 --runs 1
expect 0 '6 views' synth cup -o hard --views 6 --width 96 --height 72 --motion turntable --table --gloss 0.5 --jpeg 90 --exif --noise 2 --blur 0.5 --mask-noise 0.5 --mask-blobs 1 --sittings 2
check 'damaged masks have their exact ones beside them' test -s hard/masks_true/0005.png
expect 2 '--paper' bench --paper --grid 64x32x64
expect 0 '\| 6 \|' bench scene --grid 32x32x32 --runs 1 --backend cpu
expect 0 'MB freed' clean out
expect 3 'not made by vdbcarve' clean scene
expect 0 'carve .* s' carve scene -o carved --resolution 24
check 'carve leaves the raw hull' test -s carved/hull.vdb
expect 0 'hull' info carved
expect 0 'mask' mask scene -o masked
check 'mask leaves masks' test -s masked/masks/0005.png
# The pages are what the options say.
check 'pages are written' "$program" --write-pages pages
check 'tools/commands is up to date (vdbcarve --write-pages DIR, then its .md)' diff -r --exclude '*.1' pages "$source/tools/commands"
check 'there is a man page for every command' test "$(ls pages/*.1 | wc -l)" -eq "$(ls pages/*.md | wc -l)"
if command -v groff >/dev/null; then check 'man pages have no mistakes' test -z "$(groff -man -ww -Tutf8 pages/*.1 2>&1 >/dev/null)"; fi

finish
