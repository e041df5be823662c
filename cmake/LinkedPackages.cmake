# Finds the packages that the libraries link. Used by the build, and installed for users of the libraries, because
# Balanced3DGSConfig.cmake includes it. They are imported targets, because they belong to the machine, not to the
# installed package.

if(TARGET b3dgs_torch)
  return()
endif()

set(_b3dgs_remedy "run scripts/install_packages.sh, or install the Debian package")

macro(b3dgs_need found what package)
  if(NOT ${found})
    message(FATAL_ERROR "${what} was not found: ${_b3dgs_remedy} ${package}. "
      "Elsewhere, name its place in CMAKE_PREFIX_PATH.")
  endif()
endmacro()

find_package(Threads REQUIRED)
find_package(OpenMP QUIET COMPONENTS CXX)
b3dgs_need(OpenMP_CXX_FOUND "OpenMP" "g++")

find_package(nlohmann_json 3.10 QUIET)
b3dgs_need(nlohmann_json_FOUND "nlohmann-json" "nlohmann-json3-dev")

find_package(ZLIB QUIET)
b3dgs_need(ZLIB_FOUND "zlib" "zlib1g-dev")

find_path(B3DGS_ZSTD_INCLUDE zstd.h)
find_library(B3DGS_ZSTD zstd)
b3dgs_need(B3DGS_ZSTD_INCLUDE "Zstandard" "libzstd-dev")
b3dgs_need(B3DGS_ZSTD "Zstandard" "libzstd-dev")
add_library(b3dgs_zstd INTERFACE IMPORTED)
target_include_directories(b3dgs_zstd SYSTEM INTERFACE ${B3DGS_ZSTD_INCLUDE})
target_link_libraries(b3dgs_zstd INTERFACE ${B3DGS_ZSTD})

find_package(TIFF QUIET)
b3dgs_need(TIFF_FOUND "libtiff" "libtiff-dev")

find_path(B3DGS_UTF8PROC_INCLUDE utf8proc.h)
find_library(B3DGS_UTF8PROC utf8proc)
b3dgs_need(B3DGS_UTF8PROC_INCLUDE "utf8proc" "libutf8proc-dev")
b3dgs_need(B3DGS_UTF8PROC "utf8proc" "libutf8proc-dev")
add_library(b3dgs_utf8proc INTERFACE IMPORTED)
target_include_directories(b3dgs_utf8proc SYSTEM INTERFACE ${B3DGS_UTF8PROC_INCLUDE})
target_link_libraries(b3dgs_utf8proc INTERFACE ${B3DGS_UTF8PROC})

find_package(hwy QUIET CONFIG)
b3dgs_need(hwy_FOUND "Highway" "libhwy-dev")
if(NOT TARGET hwy::hwy)
  message(FATAL_ERROR "Highway was found without its target hwy::hwy: ${_b3dgs_remedy} libhwy-dev.")
endif()

# OpenCV: core, imgproc and imgcodecs. Debian's packages of single modules have no CMake package. Only libopencv-dev has
# one, with about sixty others, so headers and libraries are searched for if there is no package.
find_package(OpenCV QUIET COMPONENTS core imgproc imgcodecs)
if(NOT OpenCV_FOUND)
  find_path(B3DGS_OPENCV_INCLUDE opencv2/imgcodecs.hpp PATH_SUFFIXES opencv4)
  set(OpenCV_LIBS)
  foreach(module core imgproc imgcodecs)
    find_library(B3DGS_OPENCV_${module} opencv_${module})
    b3dgs_need(B3DGS_OPENCV_${module} "OpenCV's ${module}" "libopencv-${module}-dev")
    list(APPEND OpenCV_LIBS ${B3DGS_OPENCV_${module}})
  endforeach()
  b3dgs_need(B3DGS_OPENCV_INCLUDE "OpenCV's headers" "libopencv-imgcodecs-dev")
  set(OpenCV_INCLUDE_DIRS ${B3DGS_OPENCV_INCLUDE})
  file(STRINGS ${B3DGS_OPENCV_INCLUDE}/opencv2/core/version.hpp _parts REGEX "define CV_VERSION_(MAJOR|MINOR|REVISION)")
  string(REGEX REPLACE "[^0-9;]" "" OpenCV_VERSION "${_parts}")
  string(REPLACE ";" "." OpenCV_VERSION "${OpenCV_VERSION}")
endif()
add_library(b3dgs_opencv INTERFACE IMPORTED)
target_include_directories(b3dgs_opencv SYSTEM INTERFACE ${OpenCV_INCLUDE_DIRS})
target_link_libraries(b3dgs_opencv INTERFACE ${OpenCV_LIBS})

# A LibTorch with CUDA changes flags and architectures of the whole project for its own extensions, so ours are
# restored.
set(_b3dgs_cuda_architectures ${CMAKE_CUDA_ARCHITECTURES})
set(_b3dgs_cuda_flags "${CMAKE_CUDA_FLAGS}")
find_package(Torch QUIET)
b3dgs_need(Torch_FOUND "LibTorch" "libtorch-dev")
unset(CMAKE_CUDA_ARCHITECTURES)
unset(CMAKE_CUDA_ARCHITECTURES CACHE)
if(_b3dgs_cuda_architectures)
  set(CMAKE_CUDA_ARCHITECTURES ${_b3dgs_cuda_architectures})
endif()
set(CMAKE_CUDA_FLAGS "${_b3dgs_cuda_flags}")
add_library(b3dgs_torch INTERFACE IMPORTED)
target_include_directories(b3dgs_torch SYSTEM INTERFACE ${TORCH_INCLUDE_DIRS})
target_link_libraries(b3dgs_torch INTERFACE ${TORCH_LIBRARIES})
separate_arguments(_torch_flags UNIX_COMMAND "${TORCH_CXX_FLAGS}")
target_compile_options(b3dgs_torch INTERFACE $<$<COMPILE_LANGUAGE:CXX>:${_torch_flags}>)
