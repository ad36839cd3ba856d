# Everything comes from Debian 12 packages (tools/install_deps.sh lists them).
# OpenVDB brings its find modules along, outside of CMake's default search path.
find_path(VDBCARVE_OPENVDB_MODULES FindOpenVDB.cmake
  PATH_SUFFIXES lib/${CMAKE_LIBRARY_ARCHITECTURE}/cmake/OpenVDB lib/cmake/OpenVDB lib64/cmake/OpenVDB
  PATHS /usr /usr/local NO_CACHE)
if(VDBCARVE_OPENVDB_MODULES)
  list(APPEND CMAKE_MODULE_PATH ${VDBCARVE_OPENVDB_MODULES})
endif()
# FindOpenVDB links Boost and TBB through modules that newer CMake calls deprecated; that is theirs to mend.
set(CMAKE_WARN_DEPRECATED OFF CACHE INTERNAL "")
set(OpenVDB_FIND_QUIETLY ON)
find_package(TBB REQUIRED)
find_package(Imath REQUIRED)
find_package(OpenVDB REQUIRED)
find_package(Eigen3 REQUIRED)
find_package(OpenCV REQUIRED COMPONENTS core imgproc imgcodecs calib3d features2d video videoio ximgproc aruco)
set(VDBCARVE_OPENCV_LIBRARIES opencv_core opencv_imgproc opencv_imgcodecs opencv_calib3d opencv_features2d opencv_video opencv_videoio opencv_ximgproc opencv_aruco)
find_package(OpenMesh REQUIRED)
set(VDBCARVE_OPENMESH_LIBRARIES OpenMeshTools OpenMeshCore)
find_package(TinyGLTF REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(ZLIB REQUIRED)
find_package(OpenSSL REQUIRED COMPONENTS Crypto)
find_package(PkgConfig REQUIRED)
pkg_check_modules(exif REQUIRED IMPORTED_TARGET libexif)
find_package(pugixml REQUIRED)
# Photographs: JPEG to the last bit (OpenCV hands out half of a damaged one), HEIC, colour profiles.
find_package(JPEG REQUIRED)
find_package(TIFF REQUIRED)
pkg_check_modules(heif REQUIRED IMPORTED_TARGET libheif)
pkg_check_modules(lcms REQUIRED IMPORTED_TARGET lcms2)
pkg_check_modules(avutil REQUIRED IMPORTED_TARGET libavutil)
pkg_check_modules(matio REQUIRED IMPORTED_TARGET matio)
