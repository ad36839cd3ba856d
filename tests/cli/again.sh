#!/usr/bin/env bash
# The same result by another route; one stage of a result again.
source "${0%/*}/common.sh"
use scene out

# The written configuration repeats the run.
expect 0 'closed manifold' --config out/config.toml reconstruct scene -o out2
check 'the same mesh from the same configuration' cmp -s out/mesh.ply out2/mesh.ply
check 'the same volume from the same configuration' cmp -s out/volume.vdb out2/volume.vdb
expect 0 'closed manifold' --threads 1 reconstruct scene -o out1 --resolution 40
check 'one thread gives the same mesh' cmp -s out/mesh.ply out1/mesh.ply
check 'one thread gives the same volume' cmp -s out/volume.vdb out1/volume.vdb
# Our cameras.json is a camera file like any other.
expect 0 'closed manifold' reconstruct scene --cameras ../"$(basename "$work")"/out/cameras.json -o out3 --resolution 40
# Whatever vectors the machine has.
for set in generic avx2 avx512; do
  if VDBCARVE_SIMD=$set "$program" --quiet reconstruct scene -o "out_$set" --resolution 40 2>stderr; then
    check "$set gives the same mesh" cmp -s out/mesh.ply "out_$set/mesh.ply"
    check "$set gives the same volume" cmp -s out/volume.vdb "out_$set/volume.vdb"
  else
    check "$set is refused by name where it is not there" grep -q "this machine has" stderr
  fi
done
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
expect 0 'closed manifold' reconstruct scene -o wide --resolution 40 --smooth 3 --smooth-lambda 0.5 --smooth-pass-band 0.1

finish
