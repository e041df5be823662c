# Finds the dependencies of the project, prints the result, and names the remedy for missing ones. Debian 12 has all of
# them: scripts/install_packages.sh.

include(LinkedPackages)

# libmicrohttpd is the live view's server. Without it, train --view and view print what to install. Versions older than
# Debian 12's have not been tested.
set(B3DGS_HAS_WEB_SERVER OFF)
find_path(B3DGS_MICROHTTPD_INCLUDE microhttpd.h)
find_library(B3DGS_MICROHTTPD microhttpd)
mark_as_advanced(B3DGS_MICROHTTPD_INCLUDE B3DGS_MICROHTTPD)
if(B3DGS_MICROHTTPD_INCLUDE AND B3DGS_MICROHTTPD)
  file(STRINGS ${B3DGS_MICROHTTPD_INCLUDE}/microhttpd.h _version REGEX "^#define MHD_VERSION 0x")
  string(REGEX REPLACE ".*0x" "0x" _version "${_version}")
  if(_version GREATER_EQUAL 0x00097500)
    set(B3DGS_HAS_WEB_SERVER ON)
    add_library(b3dgs_microhttpd INTERFACE)
    target_include_directories(b3dgs_microhttpd SYSTEM INTERFACE ${B3DGS_MICROHTTPD_INCLUDE})
    target_link_libraries(b3dgs_microhttpd INTERFACE ${B3DGS_MICROHTTPD} Threads::Threads)
  endif()
endif()

if(B3DGS_TESTS)
  find_package(GTest QUIET)
  b3dgs_need(GTest_FOUND "GoogleTest" "libgtest-dev")
endif()

# CUDA is optional. Kernels need nvcc, and training on a GPU also needs a LibTorch that was built with CUDA.
set(B3DGS_HAS_CUDA OFF)
if(NOT B3DGS_CUDA STREQUAL "OFF")
  include(CheckLanguage)
  check_language(CUDA)
  if(CMAKE_CUDA_COMPILER)
    if(NOT DEFINED CMAKE_CUDA_ARCHITECTURES)
      set(CMAKE_CUDA_ARCHITECTURES 80 90)
    endif()
    enable_language(CUDA)
    set(CMAKE_CUDA_STANDARD 17)
    set(CMAKE_CUDA_STANDARD_REQUIRED ON)
    find_package(CUDAToolkit REQUIRED)
    set(B3DGS_HAS_CUDA ON)
  elseif(B3DGS_CUDA STREQUAL "ON")
    message(FATAL_ERROR "nvcc was not found: install the CUDA toolkit and put nvcc on the PATH, "
      "or build without it (-DB3DGS_CUDA=OFF).")
  endif()
endif()

# Training on the GPU needs both.
set(B3DGS_TORCH_CUDA OFF)
if(B3DGS_HAS_CUDA AND TARGET torch_cuda)
  set(B3DGS_TORCH_CUDA ON)
endif()

if(NOT OpenCV_VERSION)
  set(OpenCV_VERSION "of unknown version")
endif()
message(STATUS "LibTorch ${Torch_VERSION} (${TORCH_INSTALL_PREFIX})")
message(STATUS "OpenCV ${OpenCV_VERSION}")
if(NOT B3DGS_HAS_WEB_SERVER)
  message(STATUS "Live view: left out, libmicrohttpd 0.9.75 or later was not found; ${_b3dgs_remedy} libmicrohttpd-dev")
endif()
if(B3DGS_HAS_CUDA)
  message(STATUS "CUDA ${CMAKE_CUDA_COMPILER_VERSION} (${CMAKE_CUDA_COMPILER}), for sm_${CMAKE_CUDA_ARCHITECTURES}")
else()
  message(STATUS "CUDA: not used (no nvcc, or B3DGS_CUDA=OFF)")
endif()
if(B3DGS_HAS_CUDA AND NOT B3DGS_TORCH_CUDA)
  message(STATUS "LibTorch has no CUDA: kernels are compiled, training runs on the CPU. "
    "For the GPU put a LibTorch with CUDA first in CMAKE_PREFIX_PATH.")
endif()
