# Puts the version, PROJECT_VERSION of the top CMakeLists.txt, and the commit into one source file, which is rewritten
# when the commit changes (src/core/version.h).

set(_b3dgs_version_source ${CMAKE_BINARY_DIR}/version.cpp)
set(_b3dgs_write_version ${CMAKE_COMMAND} -DSOURCE_DIR=${PROJECT_SOURCE_DIR} -DVERSION=${PROJECT_VERSION}
  -DOUTPUT=${_b3dgs_version_source} -P ${CMAKE_CURRENT_LIST_DIR}/WriteVersion.cmake)
execute_process(COMMAND ${_b3dgs_write_version} COMMAND_ERROR_IS_FATAL ANY)
add_custom_target(b3dgs_version_source COMMAND ${_b3dgs_write_version} BYPRODUCTS ${_b3dgs_version_source} VERBATIM)

add_library(b3dgs_version STATIC ${_b3dgs_version_source})
add_dependencies(b3dgs_version b3dgs_version_source)
target_link_libraries(b3dgs_version PUBLIC b3dgs_options)
