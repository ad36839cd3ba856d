#!/usr/bin/env bash
# Interrupted, then resumed.
source "${0%/*}/common.sh"

expect 0 'views' synth cup -o long --views 12 --width 200 --height 150 --masks-only
"$program" reconstruct long -o resumed --resolution 700 >stdout 2>stderr & pid=$!
sleep 1.5
kill -INT $pid
wait $pid
code=$?
check "an interrupted run ends with 130 (or had finished), not $code" test $code -eq 130 -o $code -eq 0
expect 0 'closed manifold' reconstruct long -o resumed --resolution 700
check 'nothing temporary is left after resuming' test -z "$(find resumed -name '*.part*')"

finish
