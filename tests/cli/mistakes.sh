#!/usr/bin/env bash
# Mistakes: message and exit code.
source "${0%/*}/common.sh"
use scene out

expect 2 '--mesher voxels: must be one of dual, marching-cubes' reconstruct scene --mesher voxels -o elsewhere
expect 2 'output is empty' reconstruct scene -o ''
expect 2 'output is empty' synth cup -o ''
expect 2 'output is empty' export out -o ''
check 'nothing was written beside' test ! -e stages -a ! -e masks -a ! -e sparse
expect 0 'elevations' check scene
expect 0 '"median_iou"' check scene --json -
expect 0 '"findings"' check scene --only images --json -
expect 3 'no such folder' check nowhere
expect 2 'video-range' mask scene -o nothing --video-range 3,1
expect 2 'must be auto or a height' reconstruct scene -o nothing --floor high
expect 0 'peak memory' reconstruct scene -o planned --resolution 64 --dry-run
expect 2 'memory-limit' reconstruct scene -o planned --resolution 64 --memory-limit 1M
expect 2 'must be > 0|finite' reconstruct scene -o planned --memory-limit lots
expect 0 'expected_bytes' reconstruct scene -o nothing --dry-run
check 'a dry run writes nothing' test ! -e nothing
expect 2 'marching-cubes' reconstruct scene -o cubes --resolution 40 --normals
expect 2 'adaptivity' reconstruct scene -o cubes --resolution 40 --mesher marching-cubes --adaptivity 0.5
expect 2 'resolution' reconstruct scene -o bad --resolution -5
expect 2 'one of --resolution' reconstruct scene -o bad --resolution 5 --voxel-size 1
expect 2 '6 numbers' reconstruct scene -o bad --bounds 1,2,3
expect 2 "'x' is not a finite number" reconstruct scene -o bad --bounds 1,2,3,4,5,x
expect 2 'where the cameras look' reconstruct scene -o bad --resolution 20 --bounds 100,100,100,101,101,101
expect 3 'no such folder' reconstruct nowhere -o bad
expect 2 'Is --resolution meant' reconstruct scene -o bad --resolutoin 64
expect 2 'only one can count' reconstruct scene -o bad --mask threshold --clean-plate scene/images/0000.png
expect 2 'are of videos' reconstruct scene -o bad --video-frames 30
expect 2 'R,G,B within' mask scene -o bad --mask chroma --chroma-key green
expect 3 'no such folder or film' reconstruct film.mp4 -o bad
expect 2 "'blur' is no filter" reconstruct scene -o bad --filter blur
expect 2 '1..2 voxels' reconstruct scene -o bad --filter median:7
expect 2 'keep-thin' reconstruct scene -o bad --resolution 40 --keep-thin -1
expect 2 'smooth-mu' reconstruct scene -o bad --resolution 40 --smooth 3 --smooth-mu -0.1
expect 2 '--units' reconstruct scene -o bad --resolution 40 --stl-mm
expect 2 'must be one of ply' reconstruct scene -o bad --resolution 40 --mesh-formats fbx
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

finish
