# Run by cpack, after PROGRAM, ENGINE, TORCH and BUNDLE_TORCH were set. Puts the shared libraries that PROGRAM and ENGINE
# need into lib/b3dgs, where their RPATH finds them, and the licences of these libraries into share/doc/b3dgs/licenses.
# Without BUNDLE_TORCH, leaves out LibTorch and the libraries of NVIDIA beside it.

# No program names the libraries that LibTorch loads with dlopen(). Its wheels have NVIDIA's libraries beside it.
set(nvidia ${TORCH}/lib ${TORCH}/../nvidia/*/lib)
list(TRANSFORM nvidia APPEND /libcudnn_*.so.* OUTPUT_VARIABLE cudnn)
list(TRANSFORM nvidia APPEND /libnvrtc*.so.* OUTPUT_VARIABLE nvrtc)
file(GLOB loaded_later ${TORCH}/lib/libcaffe2_nvrtc.so ${TORCH}/lib/libtorch_cuda_linalg.so ${cudnn} ${nvrtc})

# These come from the machine: glibc, the compiler's runtime, and NVIDIA's driver.
file(GET_RUNTIME_DEPENDENCIES EXECUTABLES ${PROGRAM} LIBRARIES ${ENGINE} ${loaded_later}
  PRE_EXCLUDE_REGEXES "^ld-linux" "^lib(c|m|mvec|dl|rt|pthread|resolv|util|anl)\\.so" "^lib(stdc\\+\\+|gcc_s)\\.so"
    "^lib(cuda|nvidia-.*)\\.so"
  RESOLVED_DEPENDENCIES_VAR libraries CONFLICTING_DEPENDENCIES_PREFIX twice)
foreach(name ${twice_FILENAMES})  # in the CUDA toolkit and in LibTorch
  list(GET twice_${name} 0 library)
  list(APPEND libraries ${library})
endforeach()

list(APPEND libraries ${loaded_later})
if(NOT BUNDLE_TORCH)
  file(REAL_PATH ${TORCH}/.. beside)
  list(FILTER libraries EXCLUDE REGEX "^(${TORCH}|${beside}/nvidia|${TORCH}/\\.\\./nvidia)/")
endif()

foreach(library ${libraries})
  get_filename_component(name ${library} NAME)
  file(REAL_PATH ${library} file)
  file(INSTALL TYPE FILE FILES ${file} DESTINATION ${CMAKE_INSTALL_PREFIX}/lib/b3dgs RENAME ${name})
  string(REGEX REPLACE "^/usr" "" without_usr ${file})  # some packages name files without it
  list(APPEND files ${file} ${without_usr})
endforeach()

set(licenses ${CMAKE_INSTALL_PREFIX}/share/doc/b3dgs/licenses)
execute_process(COMMAND dpkg-query --search ${files} OUTPUT_VARIABLE found ERROR_QUIET)
string(REGEX MATCHALL "[^\n]+" found "${found}")
list(TRANSFORM found REPLACE ":.*" "")
list(REMOVE_DUPLICATES found)
foreach(package ${found})
  file(REAL_PATH /usr/share/doc/${package}/copyright file)
  file(INSTALL TYPE FILE FILES ${file} DESTINATION ${licenses} RENAME ${package})
endforeach()
if(found)
  file(INSTALL /usr/share/common-licenses DESTINATION ${licenses})  # the others refer to these
endif()
file(GLOB wheels ${TORCH}/../torch-*.dist-info ${TORCH}/../nvidia_*.dist-info)
if(wheels AND BUNDLE_TORCH)
  file(INSTALL ${wheels} DESTINATION ${licenses} FILES_MATCHING REGEX "(LICEN[CS]E|License|NOTICE)[^/]*$")
endif()
