# Headers that take long to parse are precompiled once, for every target that requests it: LibTorch's (ten seconds) with
# b3dgs_use_torch_headers(TARGET), nlohmann-json's (two) with b3dgs_use_json_headers(TARGET).

file(WRITE ${CMAKE_BINARY_DIR}/only_headers.cpp "// A target needs a source file; this one has only headers.\n")

function(b3dgs_precompile name)
  add_library(${name} STATIC ${CMAKE_BINARY_DIR}/only_headers.cpp)
  target_link_libraries(${name} PRIVATE b3dgs_options OpenMP::OpenMP_CXX nlohmann_json::nlohmann_json)
  foreach(header ${ARGN})
    target_precompile_headers(${name} PRIVATE "$<$<COMPILE_LANGUAGE:CXX>:<${header}$<ANGLE-R>>")
  endforeach()
endfunction()

b3dgs_precompile(b3dgs_json_headers nlohmann/json.hpp)
b3dgs_precompile(b3dgs_torch_headers torch/types.h nlohmann/json.hpp)
target_link_libraries(b3dgs_torch_headers PRIVATE b3dgs_torch)

# A precompiled header is used only with the flags it was compiled with, including OpenMP's and those of libraries.
function(b3dgs_use_headers target headers)
  get_target_property(type ${target} TYPE)
  if(type STREQUAL EXECUTABLE)  # by default it would be compiled with -fPIE
    set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE OFF)
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANGUAGE:CXX>:-fPIC>)
  endif()
  target_link_libraries(${target} PRIVATE OpenMP::OpenMP_CXX)
  target_precompile_headers(${target} REUSE_FROM ${headers})
endfunction()

function(b3dgs_use_torch_headers target)
  b3dgs_use_headers(${target} b3dgs_torch_headers)
endfunction()

function(b3dgs_use_json_headers target)
  b3dgs_use_headers(${target} b3dgs_json_headers)
endfunction()
