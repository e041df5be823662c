# LibTorch's headers take ten seconds to parse. They are precompiled once, for every target that asks with
# b3dgs_use_torch_headers(TARGET).

file(WRITE ${CMAKE_BINARY_DIR}/torch_headers.cpp "// A target needs a source file; this one has only headers.\n")
add_library(b3dgs_torch_headers STATIC ${CMAKE_BINARY_DIR}/torch_headers.cpp)
target_link_libraries(b3dgs_torch_headers PRIVATE b3dgs_options b3dgs_torch OpenMP::OpenMP_CXX
  nlohmann_json::nlohmann_json)
target_precompile_headers(b3dgs_torch_headers PRIVATE
  "$<$<COMPILE_LANGUAGE:CXX>:<torch/types.h$<ANGLE-R>>" "$<$<COMPILE_LANGUAGE:CXX>:<nlohmann/json.hpp$<ANGLE-R>>")

# A precompiled header is used only with the flags it was compiled with: OpenMP's too.
function(b3dgs_use_torch_headers target)
  target_link_libraries(${target} PRIVATE OpenMP::OpenMP_CXX)
  target_precompile_headers(${target} REUSE_FROM b3dgs_torch_headers)
endfunction()
