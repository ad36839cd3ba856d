#!/usr/bin/env bash
# Photographs that arrive.
source "${0%/*}/common.sh"
use scene out

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

finish
