#!/usr/bin/env bash
# Configures and builds one preset: tools/build.sh [PRESET] (release).
set -euo pipefail
cd "$(dirname "$0")/.."
preset=${1:-release}
cmake --preset "$preset" --log-level=NOTICE
cmake --build --preset "$preset"
