#!/usr/bin/env bash
# Configuration files: what a result leaves repeats its run, whatever its folders are called; what is not understood is refused.
source "${0%/*}/common.sh"
use scene

# Names that a reader could trip over.
nth=0
for name in 'shoot #3' $'two\nlines' '(' "it's" '"quoted"' 'back\slash' '[a,b]' '{x}' 'trailing ' 'a=b' '# all' 'ü€' '123' 'true'; do
  nth=$((nth + 1))
  cp -r scene "$name"
  expect 0 'mask' mask "$name" -o "out $nth $name"
  expect 0 'already there' --config "out $nth $name/config.toml" mask
done
cp -r scene 'shoot "#3"'
expect 0 'closed manifold' reconstruct 'shoot "#3"' -o 'out #3' --resolution 24 --color none --no-report --mesh-formats ply
expect 0 'carve .*already there' --config 'out #3/config.toml' reconstruct
expect 0 'filter median:1x1' filter 'out #3' --filter median:1
expect 0 '"reused":true' smooth 'out #3' --smooth 2 --quiet --threads 1 --json -
check 'what was given before stays' grep -q '^reconstruct.filter="median:1x1"$' 'out #3/config.toml'
check 'and what is new is there' grep -q '^reconstruct.smooth=2$' 'out #3/config.toml'
expect 2 "a result's own config.toml" --config 'out #3/config.toml' filter 'out #3'
expect 2 'Is --filter meant' filter 'out #3' --filtre none
expect 2 'must be one of none, best, blend' color 'out #3' --color rainbow

# As version 0.1 wrote them.
cat >old.toml <<'TOML'
reconstruct.scene="scene"
reconstruct.output="old"
reconstruct.mask-command-jobs=1
reconstruct.mask-fill-holes=0.005
reconstruct.video-frames=72
reconstruct.arc=360
reconstruct.resolution=24
reconstruct.field-scale="auto"
reconstruct.color="none"
reconstruct.exposure="gain"
reconstruct.filter="auto"
reconstruct.smooth="auto"
reconstruct.smooth-mu=-0.6732
reconstruct.mesh-formats=["ply", "obj"]
reconstruct.up='z'
reconstruct.no-report=true
TOML
expect 0 'closed manifold' --config old.toml reconstruct
check 'its formats' test -s old/mesh.obj -a ! -e old/mesh.glb
expect 0 'closed manifold' --config old.toml reconstruct --mesh-formats ply -o newer
check 'the command line wins' test -s newer/mesh.ply -a ! -e newer/mesh.obj

# As people write them.
printf 'quiet = true # no log\n\n[reconstruct]\nscene = "scene"\noutput = "ours"\nresolution = 24\ncolor = "none"\nmesh-formats = [\n  "ply",  # for us\n]\n' >ours.toml
check 'nothing is said with quiet = true' test -z "$("$program" --config ours.toml reconstruct 2>&1 || echo failed)"
check 'the section counts' test -s ours/mesh.ply -a ! -e ours/mesh.glb
for line in 'reconstruct.resolutoin=3|line 1: unknown option reconstruct.resolutoin' 'reconstruct.scene=scene|line 1: .*must be a number, true, false, a list, or text in quotes' \
  'reconstruct.scene="a|closing " is missing' 'reconstruct.max-misses=99|--max-misses is 99, must be 0..15' 'frobnicate.x=1|unknown option frobnicate.x'; do
  printf '%s\n' "${line%%|*}" >bad.toml
  expect 2 "${line#*|}" --config bad.toml reconstruct scene -o bad
done
expect 2 'nowhere.toml' --config nowhere.toml reconstruct scene -o bad
echo 'reconstruct.scene="a' >'out #3/config.toml'
expect 2 'config.toml, line 1' filter 'out #3'

finish
