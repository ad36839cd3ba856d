#!/usr/bin/env bash
# Packages, build, all tests.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/install_deps.sh
tools/build.sh release
ctest --test-dir build/release --output-on-failure -j "$(nproc)" "$@"
