# One set of flags for all targets of the project, through b3dgs_options. Warnings are errors in the presets
# (CMAKE_COMPILE_WARNING_AS_ERROR), but not for users, whose compiler may have more of them.

add_library(b3dgs_options INTERFACE)
target_include_directories(b3dgs_options INTERFACE
  $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/src> $<INSTALL_INTERFACE:include/balanced3dgs>)
target_compile_features(b3dgs_options INTERFACE cxx_std_17)
# No contraction on the host, so that results do not depend on the instructions that the compiler chooses. The CPU
# kernels request fused multiply-add explicitly where they need it.
target_compile_options(b3dgs_options INTERFACE
  $<BUILD_INTERFACE:$<$<COMPILE_LANGUAGE:CXX>:-Wall -Wextra -Wpedantic -ffp-contract=off>>)
if(CMAKE_UNITY_BUILD)  # GCC warns about classes in included files that have members of unnamed namespaces
  target_compile_options(b3dgs_options INTERFACE
    $<BUILD_INTERFACE:$<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-subobject-linkage>>)
endif()

target_compile_options(b3dgs_options INTERFACE
  $<BUILD_INTERFACE:$<$<COMPILE_LANGUAGE:CUDA>:--extended-lambda -lineinfo -Xcompiler=-Wall,-Wextra,-ffp-contract=off>>)

if(B3DGS_PTXAS_REPORTS)
  target_compile_options(b3dgs_options INTERFACE $<$<COMPILE_LANGUAGE:CUDA>:-Xptxas=-v>)
  set_property(GLOBAL PROPERTY RULE_LAUNCH_COMPILE ${PROJECT_SOURCE_DIR}/scripts/keep_ptxas_report.sh)
endif()

if(B3DGS_FUZZ)
  set(_sanitizers -fsanitize=fuzzer-no-link,address,undefined,float-cast-overflow)
  target_compile_options(b3dgs_options INTERFACE ${_sanitizers} -fno-sanitize-recover=all -fno-omit-frame-pointer)
  target_link_options(b3dgs_options INTERFACE ${_sanitizers})
endif()

if(B3DGS_SANITIZE)  # with sanitizers, GCC 12 considers parts of std::regex uninitialized
  target_compile_options(b3dgs_options INTERFACE $<$<COMPILE_LANGUAGE:CXX>:-fsanitize=address,undefined
    -fno-sanitize-recover=all -fno-omit-frame-pointer>
    $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-maybe-uninitialized>)
  target_link_options(b3dgs_options INTERFACE -fsanitize=address,undefined)
endif()
