#!/usr/bin/env bash
# A run that is killed at a random moment, gone on with as often as it takes, ends with the bytes of a run that nobody disturbed: kill_test.sh PROGRAM [KILLS] [RECONSTRUCT'S OPTIONS…]
# Without options, a small shoot of its own. report.json, report.html and config.toml are compared without times and paths.
set -euo pipefail
program=$1 kills=${2:-20}
shift $(($# > 1 ? 2 : 1))
RANDOM=${SEED:-7}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
if [ $# -eq 0 ]; then
  "$program" --quiet synth cup -o "$work/shoot" --views 12 --width 320 --height 240
  set -- "$work/shoot" --resolution 112 --filter edge-preserving:1 --smooth 2 --mesh-formats ply,obj,glb,stl
fi
run() { "$program" --quiet reconstruct "$@" 2>>"$work/said"; }

now() { date +%s%N; }
start=$(now)
run "$@" -o "$work/whole"
length=$(($(now) - start))

# What may differ: seconds and memory, what was found done, where it lies, and of the page the same.
known() {  # FOLDER FILE
  case $2 in
    report.json) sed -E '/"milliseconds": \{/,/\}/d; /"(seconds|bounds_seconds|peak_rss_bytes|reused|backend)":/d' "$1/$2" ;;
    report.html) sed -E 's#<small>(time|memory)</small><b[^>]*>[^<]*</b>##g; /^<tr><td>[a-z_]+<td class=n>/d; /<td>bounds seconds</d; s#<title>[^<]*##' "$1/$2" | sed "s#$(basename "$1")#OUT#g" ;;
    config.toml) grep -v '^reconstruct.output=' "$1/$2" ;;
    *) cat "$1/$2" ;;
  esac
}
files() { (cd "$1" && find . -type f -not -path './stages/*' | sort); }
same() {  # as the whole
  diff <(files "$work/whole") <(files "$1") || return 1
  for file in $(files "$1"); do
    cmp -s <(known "$work/whole" "${file#./}" | sed "s#$work/whole#OUT#g") <(known "$1" "${file#./}" | sed "s#$1#OUT#g") || { echo "$file differs"; diff <(known "$work/whole" "${file#./}") <(known "$1" "${file#./}") | head -5; return 1; }
  done
}

echo "undisturbed: $((length / 1000000)) ms"
done_first=0 partly=0
for ((n = 1; n <= kills; ++n)); do
  out=$work/killed
  rm -rf "$out"
  at=$(((RANDOM * 32768 + RANDOM) % 1000))
  "$program" --quiet reconstruct "$@" -o "$out" 2>/dev/null & pid=$!
  sleep "$(awk -v n=$length -v s=$at 'BEGIN { printf "%.3f", n * s / 1e12 }')"
  if kill -KILL "$pid" 2>/dev/null; then partly=$((partly + 1)); else done_first=$((done_first + 1)); fi
  wait "$pid" 2>/dev/null || true
  stages=$({ find "$out/stages" -maxdepth 1 -mindepth 1 2>/dev/null || true; } | wc -l)
  run "$@" -o "$out" || { echo "kill $n, at $at of 1000: going on failed"; tail -3 "$work/said"; exit 1; }
  left=$(find "$out" -name '*.part*' | { grep -cv '/stages/' || true; })
  [ "$left" -eq 0 ] || { echo "kill $n: left in the result: $(find "$out" -name '*.part*')"; exit 1; }
  same "$out" || { echo "kill $n, at $at of 1000: another result"; exit 1; }
  echo "kill $n at $((length * at / 1000000000)) ms, $stages entries in stages: gone on with, the same"
done
echo "$partly runs killed and $done_first done before: all end the same"
