#!/usr/bin/env bash
# What is sent to somebody else when a run went wrong.
source "${0%/*}/common.sh"
use scene out

expect 2 '"event":"error","exit_code":2,"text":"the bounds' --json - reconstruct scene -o failed --bounds 50,50,50,51,51,51
expect 0 'failed.tar.gz: [0-9.]+ MB, no photographs' bundle failed
check 'a bundle says what a run failed with' grep -q '"stage": "carve"' <(tar xzOf failed.tar.gz vdbcarve-bundle/failure/failure.json)
expect 0 'b.tar.gz' bundle out -o b.tar.gz --width 60
check 'a bundle is a scene' test -n "$(tar tzf b.tar.gz | grep scene/masks/0003.png)"
tar xzf b.tar.gz
expect 0 'closed manifold' reconstruct vdbcarve-bundle/scene -o replayed --resolution 24
check 'reconstruct writes the page' grep -q 'worst first' out/report.html
expect 3 'not made by vdbcarve' bundle scene
expect 3 'no such folder' bundle nowhere

finish
