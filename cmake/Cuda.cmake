# -DVDBCARVE_CUDA=AUTO|ON|OFF and -DVDBCARVE_CUDA_ARCHITECTURES=LIST. Sets VDBCARVE_HAS_CUDA and makes vdbcarve_cuda, which src/device puts into the library.
set(VDBCARVE_CUDA_ARCHITECTURES "75-real;80-real;86-real;89-real;90-real;120" CACHE STRING
  "GPUs to compile for: the generations in use, and code that later ones translate")
set(VDBCARVE_HAS_CUDA OFF)
if(NOT VDBCARVE_CUDA STREQUAL "OFF")
  include(CheckLanguage)
  check_language(CUDA)
  if(CMAKE_CUDA_COMPILER)
    set(CMAKE_CUDA_ARCHITECTURES ${VDBCARVE_CUDA_ARCHITECTURES})
    enable_language(CUDA)
    # CMake 3.25 does not know that newer compilers speak C++20.
    if(NOT DEFINED CMAKE_CUDA20_STANDARD_COMPILE_OPTION)
      set(CMAKE_CUDA20_STANDARD_COMPILE_OPTION "-std=c++20")
      set(CMAKE_CUDA20_EXTENSION_COMPILE_OPTION "-std=c++20")
    endif()
    find_package(CUDAToolkit REQUIRED)
    set(VDBCARVE_HAS_CUDA ON)
  elseif(VDBCARVE_CUDA STREQUAL "ON")
    message(FATAL_ERROR "VDBCARVE_CUDA=ON, but no CUDA compiler was found (is nvcc on PATH?)")
  endif()
endif()
if(VDBCARVE_HAS_CUDA)
  add_library(vdbcarve_cuda OBJECT cuda/carve_cuda.cu cuda/color_cuda.cu cuda/dense_cuda.cu cuda/distance_cuda.cu cuda/fair_depths_cuda.cu cuda/fair_level_cuda.cu cuda/fair_motion_cuda.cu cuda/fair_pieces_cuda.cu cuda/fair_sight_cuda.cu cuda/filter_cuda.cu cuda/grid_cuda.cu cuda/level_set_cuda.cu cuda/mesh_cuda.cu cuda/render_cuda.cu cuda/stereo_cuda.cu)
  set_target_properties(vdbcarve_cuda PROPERTIES POSITION_INDEPENDENT_CODE ON CUDA_STANDARD 20)
  target_link_libraries(vdbcarve_cuda PRIVATE vdbcarve_kernel)
  target_include_directories(vdbcarve_cuda PRIVATE ${PROJECT_BINARY_DIR}/modules/base/shared)  # for error.h
  # A fused multiply-add rounds once where the CPU's separate operations round twice: the bits would differ.
  target_compile_options(vdbcarve_cuda PRIVATE --fmad=false)
  # What the bridge to them includes: "cuda/x.h".
  add_library(vdbcarve_cuda_headers INTERFACE)
  target_include_directories(vdbcarve_cuda_headers INTERFACE ${PROJECT_BINARY_DIR}/modules/cuda)
  target_link_libraries(vdbcarve_cuda_headers INTERFACE vdbcarve_kernel CUDA::cudart_static)
endif()
message(STATUS "vdbcarve: CUDA ${VDBCARVE_HAS_CUDA}")
