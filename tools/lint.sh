#!/usr/bin/env bash
# Links of all pages, format of all sources, and clang-tidy over the sources that changed: tools/lint.sh [BASE]
# BASE: a commit; default: where this branch left origin/main, or the commit before this one. Reads build/release/compile_commands.json (tools/build.sh writes it).
# Of .clang-tidy's checks only those that it calls errors run here, as they are quick: 5 to 20 s a file. After VDBCARVE_LINT_SECONDS (120; 0: no limit) no further
# file is begun, and those not reached are named. All checks: clang-tidy-14 -p build/lint FILE
set -euo pipefail
cd "$(dirname "$0")/.."
for tool in clang-format-14 clang-tidy-14; do
  command -v $tool >/dev/null || { echo "lint: $tool is not installed. Remedy: tools/install_deps.sh --dev" >&2; exit 2; }
done

echo "lint: links"
tools/check_links.py

echo "lint: format"
git ls-files -z -- '*.h' '*.cpp' '*.cu' '*.cuh' | xargs -0 -n 16 -P "$(nproc)" clang-format-14 --dry-run -Werror ||
  { echo "lint: remedy: clang-format-14 -i FILE" >&2; exit 1; }

base=${1:-}
if [ -z "$base" ]; then
  base=$(git merge-base HEAD origin/main 2>/dev/null || true)
  [ -n "$base" ] && [ "$base" != "$(git rev-parse HEAD)" ] || base=$(git rev-parse -q --verify HEAD~1 || true)
  [ -n "$base" ] || { echo "lint: there is no earlier commit here: clang-tidy has nothing to compare with"; exit 0; }
fi
[ -f build/release/compile_commands.json ] || { echo "lint: build/release/compile_commands.json is missing. Remedy: tools/build.sh" >&2; exit 2; }

# A file that only moved is not a changed one. The compiler's flags are read without GCC's precompiled header, which clang cannot read.
git diff --name-only --diff-filter=AM -M50% "$base" -- '*.cpp' >build/changed_sources
mkdir -p build/lint
python3 - build/release/compile_commands.json build/lint/compile_commands.json build/changed_sources >build/lint/sources <<'PY'
import json, os, re, sys
commands, changed = json.load(open(sys.argv[1])), {os.path.realpath(line.strip()) for line in open(sys.argv[3]) if line.strip()}
found = {}
for c in commands:
    path = os.path.realpath(os.path.join(c["directory"], c["file"]))
    if path in changed and path not in found:
        c["command"] = re.sub(r"-Winvalid-pch|-include \S*cmake_pch\.hxx|-fno-math-errno|-fno-trapping-math|-Wno-psabi", "", c["command"])
        found[path] = c
json.dump(list(found.values()), open(sys.argv[2], "w"))
print("\n".join(sorted(found)))
PY
sources=()
while read -r file; do [ -z "$file" ] || sources+=("$file"); done <build/lint/sources
echo "lint: clang-tidy over ${#sources[@]} changed sources (since $(git rev-parse --short "$base"))"
[ ${#sources[@]} -gt 0 ] || exit 0

# One file for each core at a time; those that come too late are only named. What .clang-tidy calls an error ends this with 1; that clang does not understand
# what GCC compiles does not.
export limit=${VDBCARVE_LINT_SECONDS:-120} started checks
started=$(date +%s)
checks=$(sed -n "s/^WarningsAsErrors: '\(.*\)'/\1/p" .clang-tidy)
look() {
  local said=build/lint/${1//\//_}.txt
  if [ "$limit" -gt 0 ] && [ $(($(date +%s) - started)) -ge "$limit" ]; then echo "lint: not reached: ${1#"$PWD"/}"; return 0; fi
  clang-tidy-14 --quiet --checks="-*,$checks" -p build/lint "$1" >"$said" 2>/dev/null || true
  ! grep -A 4 'warnings-as-errors' "$said"
}
export -f look
printf '%s\0' "${sources[@]}" | xargs -0 -n 1 -P "$(nproc)" bash -c 'look "$0"' || {
  # Until all of the tree has been through these checks once, what they find is said and does not fail the run; VDBCARVE_LINT_STRICT=1 makes it.
  echo "lint: clang-tidy found what .clang-tidy calls errors" >&2
  [ "${VDBCARVE_LINT_STRICT:-0}" = 0 ] || exit 1
}
echo "lint: done"
