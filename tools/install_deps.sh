#!/usr/bin/env bash
# Installs what vdbcarve and its tests need, from Debian 12's packages.
#   tools/install_deps.sh          what builds and tests need
#   tools/install_deps.sh --dev    also what developers check results with (other people's readers, analysis tools)
set -euo pipefail

packages=(g++ cmake ninja-build ccache git ca-certificates
  libopenvdb-dev libnanovdb-dev libtbb-dev libopencv-dev libopencv-contrib-dev libeigen3-dev libopenmesh-dev
  libcli11-dev libspdlog-dev nlohmann-json3-dev libtinygltf-dev libgtest-dev libbenchmark-dev libnanoflann-dev
  libimath-dev libboost-iostreams-dev libblosc-dev zlib1g-dev libvalijson-dev
  libavutil-dev libexif-dev libheif-dev libjpeg-dev liblcms2-dev libmatio-dev libpugixml-dev libssl-dev libtiff-dev pkg-config)
dev=no
if [ "${1:-}" = "--dev" ]; then
  dev=yes
  command -v npm >/dev/null || packages+=(nodejs npm)
  packages+=(clang-format-14 clang-tidy-14 libopenvdb-tools python3-openvdb python3-numpy python3-open3d blender chromium f3d xvfb hyperfine)
elif [ $# -gt 0 ]; then
  echo "usage: tools/install_deps.sh [--dev]" >&2
  exit 2
fi

# npm's packages go into the build tree: they need no place of their own on the machine. model-viewer shows models in reports, Khronos' validator checks .glb files.
install_node_packages() {
  cd "$(dirname "$0")/.."
  command -v npm >/dev/null || { echo "install_deps: there is no npm: reports will show a picture instead of the model in 3-D (apt install npm, then this again)"; return 0; }
  local wanted=()
  [ -d build/node/node_modules/@google/model-viewer ] || wanted+=(@google/model-viewer@4.1.0)
  [ "$dev" = no ] || [ -d build/node/node_modules/gltf-validator ] || wanted+=(gltf-validator@2.0.0-dev.3.10)
  [ ${#wanted[@]} -gt 0 ] || return 0
  timeout 180 npm install --silent --no-fund --no-audit --prefix build/node "${wanted[@]}" ||
    echo "install_deps: npm could not fetch ${wanted[*]}; what needs them is left out, or skipped"
}

missing=()
for package in "${packages[@]}"; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then
  install_node_packages
  echo "install_deps: everything is there"
  exit 0
fi

# Root installs directly; anybody else needs sudo, and only now.
as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || { echo "install_deps: run as root, or install sudo; missing: ${missing[*]}" >&2; exit 1; }
  as_root=(sudo)
fi
echo "install_deps: installing ${missing[*]}"
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
install_node_packages
echo "install_deps: done"
