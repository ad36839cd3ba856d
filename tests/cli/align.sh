#!/usr/bin/env bash
# Cameras from silhouettes, and the marker mat.
source "${0%/*}/common.sh"
use scene turn aligned

expect 0 'median IoU 0.99' check turn --cameras ../"$(basename "$work")"/aligned/cameras.json
expect 2 '2 angles for 16 views' align turn --cameras none --angles 0,10 -o elsewhere
expect 2 'improves cameras' align turn --cameras none --method refine -o elsewhere
expect 2 'must be one of coherence, refine' align turn --method magic -o elsewhere
expect 2 '--known-distance: the cameras of .*transforms.json are used as they are.*Remedy: --method refine' reconstruct turn --known-distance 300 -o elsewhere
expect 2 '--direction, --arc auto: the cameras' reconstruct turn --direction cw --arc auto -o elsewhere
expect 2 '--units furlong: must be one of m, cm, mm' align turn --cameras none --known-distance 3 --units furlong -o elsewhere
expect 2 '--orbit circle: must be one of auto, turntable, fixed-camera, hand-held' align turn --cameras none --orbit circle -o elsewhere
expect 2 '--restarts is of --method coherence or refine, not of paper' align turn --cameras none --method paper --restarts 5 -o elsewhere
expect 2 'no view is called 99' align turn --cameras none --known-length 99:1,2,3,4:5 -o elsewhere
expect 3 'is background in its mask' align turn --cameras none --known-length 0003:1,2,160,120:5 -o elsewhere
expect 0 'focal lengths, principal points and lenses are taken' align turn --restarts 0 -o again
expect 0 'method refine' align --help
expect 0 'cameras found' align turn --cameras none --no-features --orbit turntable --restarts 0 -o plain
check 'the configuration keeps what was switched off' grep -q 'no-features=true' plain/config.toml
check 'and words as they were said' grep -q 'orbit="turntable"' plain/config.toml
expect 2 '--units mm: cameras found from silhouettes know no scale.*Remedy: --known-height' reconstruct turn --cameras none --units mm -o elsewhere
expect 2 '--principal-point 9999,120: far outside' align turn --cameras none --principal-point 9999,120 -o elsewhere
expect 2 '--known-height is -5, must be > 0' align turn --cameras none --known-height -5 -o elsewhere
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

finish
