# Finds what the project needs, says what was found, and names the remedy for what was not.
# Debian 12 has all of it: scripts/install_packages.sh.

include(LinkedPackages)

# cpp-httplib: the header alone or, on Debian, a header for a shared library, which must see the library's own macros.
find_path(B3DGS_HTTPLIB_INCLUDE httplib.h)
b3dgs_need(B3DGS_HTTPLIB_INCLUDE "cpp-httplib" "libcpp-httplib-dev")
add_library(b3dgs_httplib INTERFACE)
target_include_directories(b3dgs_httplib SYSTEM INTERFACE ${B3DGS_HTTPLIB_INCLUDE})
target_link_libraries(b3dgs_httplib INTERFACE Threads::Threads)
file(STRINGS ${B3DGS_HTTPLIB_INCLUDE}/httplib.h _is_whole REGEX "^inline .*Server::listen_after_bind" LIMIT_COUNT 1)
if(NOT _is_whole)
  find_library(B3DGS_HTTPLIB cpp-httplib)
  b3dgs_need(B3DGS_HTTPLIB "cpp-httplib's library" "libcpp-httplib-dev")
  target_link_libraries(b3dgs_httplib INTERFACE ${B3DGS_HTTPLIB})
  target_compile_definitions(b3dgs_httplib INTERFACE
    CPPHTTPLIB_OPENSSL_SUPPORT CPPHTTPLIB_ZLIB_SUPPORT CPPHTTPLIB_BROTLI_SUPPORT)
endif()

if(B3DGS_TESTS)
  find_package(GTest QUIET)
  b3dgs_need(GTest_FOUND "GoogleTest" "libgtest-dev")
endif()

# CUDA is optional: kernels need nvcc, training on a GPU also a LibTorch that was built with CUDA.
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

# Training on the GPU takes both.
set(B3DGS_TORCH_CUDA OFF)
if(B3DGS_HAS_CUDA AND TARGET torch_cuda)
  set(B3DGS_TORCH_CUDA ON)
endif()

if(NOT OpenCV_VERSION)
  set(OpenCV_VERSION "of unknown version")
endif()
message(STATUS "LibTorch ${Torch_VERSION} (${TORCH_INSTALL_PREFIX})")
message(STATUS "OpenCV ${OpenCV_VERSION}")
if(B3DGS_HAS_CUDA)
  message(STATUS "CUDA ${CMAKE_CUDA_COMPILER_VERSION} (${CMAKE_CUDA_COMPILER}), for sm_${CMAKE_CUDA_ARCHITECTURES}")
else()
  message(STATUS "CUDA: not used (no nvcc, or B3DGS_CUDA=OFF)")
endif()
if(B3DGS_HAS_CUDA AND NOT B3DGS_TORCH_CUDA)
  message(STATUS "LibTorch has no CUDA: kernels are compiled, training runs on the CPU. "
    "For the GPU put a LibTorch with CUDA first in CMAKE_PREFIX_PATH.")
endif()
