#!/usr/bin/env bash
# Packs binaries with the shared libraries they need, for another Linux (x86-64, glibc 2.36 or newer) where nothing can be installed:
#   tools/pack_portable.sh [--output FILE.tgz] [--preset release] [--tests] [FOLDER …]
# Without --tests the program itself; with it the tests and the benchmark of the GPU, which need no image codecs, and FOLDERs of packed
# scenes (tests/device/pack_scene.cpp). The C library and the loader stay behind: those of the other machine are used. Unpacked:
#   LD_LIBRARY_PATH=vdbcarve-portable/lib vdbcarve-portable/bin/vdbcarve --help      (bin/ has a starter that sets it)
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
output=$root/portable/vdbcarve.tgz
preset=release
tests=no
scenes=()
while [ $# -gt 0 ]; do
  case $1 in
    --output) output=$2; shift 2 ;;
    --preset) preset=$2; shift 2 ;;
    --tests) tests=yes; shift ;;
    -*) echo "usage: tools/pack_portable.sh [--output FILE.tgz] [--preset NAME] [--tests] [FOLDER …]" >&2; exit 2 ;;
    *) scenes+=("$1"); shift ;;
  esac
done
build=$root/build/$preset
if [ "$tests" = yes ]; then
  cmake --build "$build" --target vdbcarve_gpu_tests vdbcarve_device_bench vdbcarve_stereo_study
  binaries=("$build/tests/vdbcarve_gpu_tests" "$build/tests/vdbcarve_device_bench" "$build/tests/vdbcarve_stereo_study")
else
  cmake --build "$build" --target vdbcarve_cli
  binaries=("$build/vdbcarve")
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
pack=$work/vdbcarve-portable
mkdir -p "$pack/bin" "$pack/lib" "$pack/libexec"
for binary in "${binaries[@]}"; do
  name=$(basename "$binary")
  strip -o "$pack/libexec/$name" "$binary"
  cat > "$pack/bin/$name" <<'STARTER'
#!/bin/sh
here=$(dirname "$(dirname "$(readlink -f "$0")")")
LD_LIBRARY_PATH="$here/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" exec "$here/libexec/$(basename "$0")" "$@"
STARTER
  chmod +x "$pack/bin/$name"
  # What belongs to the other machine's own C library must not travel.
  ldd "$binary" | awk '$3 ~ /^\// {print $3}' | while read -r library; do
    case $(basename "$library") in
      libc.so.* | libm.so.* | libdl.so.* | libpthread.so.* | librt.so.* | libresolv.so.* | ld-linux*) ;;
      *) [ -e "$pack/lib/$(basename "$library")" ] || cp -L "$library" "$pack/lib/" ;;
    esac
  done
done
strip --strip-unneeded "$pack"/lib/* 2>/dev/null || true
for scene in ${scenes[@]+"${scenes[@]}"}; do
  mkdir -p "$pack/scenes"
  cp -r "$scene" "$pack/scenes/"
done
mkdir -p "$(dirname "$output")"
tar -C "$work" -cf - vdbcarve-portable | gzip -9 > "$output"
echo "$output: $(du -h "$output" | cut -f1), $(ls "$pack/lib" | wc -l) libraries"
