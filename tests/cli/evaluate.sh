#!/usr/bin/env bash
# Colour, and results compared with the truth and with photographs.
source "${0%/*}/common.sh"
use scene out

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
expect 0 'F-score' evaluate out --truth scene/truth.ply --samples 2000
expect 0 '"chamfer"' --json - evaluate out --truth scene/truth.ply --samples 2000 --align cameras --cameras out/cameras.json --truth-cameras scene
expect 3 'no such|cannot' evaluate out --truth nowhere.ply
expect 2 'wants --cameras' evaluate out --truth scene/truth.ply --align cameras

finish
