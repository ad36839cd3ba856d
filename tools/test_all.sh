#!/usr/bin/env bash
# Packages, build, all tests: those of tools/test.sh, and the long ones that tests/quick.cmake names.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/install_deps.sh
tools/build.sh release
ctest --test-dir build/release --output-on-failure -j "$(nproc)" "$@"
