#!/usr/bin/env bash
# Pictures and the page.
source "${0%/*}/common.sh"
use scene out

expect 0 '80 x 60 pixels' render out -o picture.png --size 80x60
check 'a picture is a PNG' test "$(head -c 4 picture.png | tail -c 3)" = PNG
expect 0 '2[0-9][0-9] x|1[0-9][0-9] x' render out -o view.png --view 0001 --background none --samples 1
expect 0 'each, 3 of them' render out -o sheet.png --sheet 3
expect 0 'each, 4 of them' render out -o slices.png --style slices --slices 4 --size 200x200
expect 0 '64 x 64' render out/volume.vdb -o voxels.png --style voxels --size 64x64 --no-color
expect 0 'slack: grey is none' render out -o slack.png --style slack --size 64x64
expect 2 'no voxels' render out/mesh.ply -o bad.png --style slack
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

finish
