#!/usr/bin/env bash
# The shoots and results that the other scripts start from: fixture.sh PROGRAM SOURCE FOLDER
source "${0%/*}/common.sh"

expect 0 '6 views' synth ellipsoids -o scene --views 6 --width 120 --height 90
expect 0 'closed manifold' reconstruct scene -o out --resolution 40 --mesh-formats ply,obj,stl
check 'stdout stays empty unless data is asked for' test ! -s stdout
for file in volume.vdb mesh.ply mesh.obj mesh.stl cameras.json preview.png report.json config.toml masks/0000.png; do
  check "out/$file is there" test -s "out/$file"
done
check 'nothing temporary is left' test -z "$(find out -name '*.part*')"
expect 0 '16 views' synth ellipsoids -o turn --views 16 --width 320 --height 240
expect 0 'cameras found: turntable' align turn --cameras none -o aligned --known-distance 300 --units mm
check 'cameras and a picture of the orbit' test -s aligned/cameras.json -a -s aligned/orbit.svg -a -s aligned/preview.png

if [ $failures -eq 0 ]; then
  rm -rf "$fixture" && mkdir -p "$fixture" && mv scene out turn aligned "$fixture"
fi
finish
