#!/usr/bin/env bash
# Packages, build, the tests with the label `quick`: what must pass before anything lands. tools/test_all.sh runs all of them.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/install_deps.sh
tools/build.sh release
ctest --test-dir build/release --output-on-failure -j "$(nproc)" -L quick "$@"
