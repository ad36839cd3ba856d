#!/usr/bin/env bash
# Configures and builds one preset: tools/build.sh [PRESET] (release).
set -euo pipefail
cd "$(dirname "$0")/.."
preset=${1:-release}
# VDBCARVE_CUDA_ARCHITECTURES in the environment, like 90: fewer GPUs to compile for, which is quicker.
cmake --preset "$preset" --log-level=NOTICE ${VDBCARVE_CUDA_ARCHITECTURES:+"-DVDBCARVE_CUDA_ARCHITECTURES=$VDBCARVE_CUDA_ARCHITECTURES"}
cmake --build --preset "$preset"
