# The command line as a user meets it: results, exit codes, messages. Sourced by every script here:
#   NAME.sh PROGRAM SOURCE_DIR FIXTURE       FIXTURE: the folder that fixture.sh has filled
set -uo pipefail
program=$1 source=$2 fixture=$3
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
failures=0

# use NAME…: shoots and results of the fixture, as copies.
use() { for name in "$@"; do cp -r "$fixture/$name" . || exit 1; done; }

# expect CODE 'PATTERN' ARGS…: the program must end with CODE and say PATTERN (stdout or stderr).
expect() {
  local code=$1 pattern=$2
  shift 2
  "$program" "$@" >stdout 2>stderr
  local got=$?
  # Not through a pipe: grep -q ends at the first match, and who writes into it then fails, now and then.
  if [ $got -ne "$code" ] || ! grep -Eq -- "$pattern" stdout stderr; then
    failures=$((failures + 1))
    echo "FAILED: vdbcarve $* -> exit $got (expected $code), wanted '$pattern', said:"
    sed 's/^/    /' stdout stderr
  fi
}
check() {
  if ! "${@:2}"; then
    failures=$((failures + 1))
    echo "FAILED: $1"
  fi
}
finish() {
  [ $failures -eq 0 ] && echo "all checks passed" || echo "$failures checks failed"
  exit $((failures > 0))
}
