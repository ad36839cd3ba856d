#!/usr/bin/env bash
# Includes that the modules' links allow compile, others are not found: layers_test.sh BUILD
set -euo pipefail
build=$1
status=0
for case in allowed_shared allowed_below allowed_api; do
  cmake --build "$build" --target "vdbcarve_layer_$case" > /dev/null || { echo "$case: does not compile"; status=1; }
done
for case in refused_private refused_above refused_api_above refused_path; do
  if said=$(cmake --build "$build" --target "vdbcarve_layer_$case" 2>&1); then
    echo "$case: compiles, but must not"
    status=1
  elif ! grep -q 'fatal error: .*: No such file or directory' <<< "$said"; then
    echo "$case: fails for another reason:"
    echo "$said"
    status=1
  fi
done
exit $status
