# Files that find_package(Balanced3DGS) finds after installation: the libraries below Trainer, their headers, and
# Balanced3DGSConfig.cmake. Component "development", which is not part of the .deb.

include(CMakePackageConfigHelpers)
set(_b3dgs_package ${CMAKE_INSTALL_LIBDIR}/cmake/Balanced3DGS)

set(_b3dgs_libraries b3dgs_options b3dgs_core b3dgs_config b3dgs_scene b3dgs_raster_math b3dgs_raster_cpu b3dgs_raster
  b3dgs_model b3dgs_adaptive b3dgs_ranks b3dgs_dist b3dgs_train b3dgs_multi)
foreach(library b3dgs_raster_cuda b3dgs_train_cuda b3dgs_multi_cuda)
  if(TARGET ${library})
    list(APPEND _b3dgs_libraries ${library})
  endif()
endforeach()

install(TARGETS ${_b3dgs_libraries} EXPORT Balanced3DGSTargets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}/balanced3dgs COMPONENT development)
install(EXPORT Balanced3DGSTargets NAMESPACE Balanced3DGS:: DESTINATION ${_b3dgs_package} COMPONENT development)
install(DIRECTORY ${PROJECT_SOURCE_DIR}/src/ DESTINATION include/balanced3dgs COMPONENT development
  FILES_MATCHING PATTERN "*.h")

configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/Balanced3DGSConfig.cmake.in
  ${CMAKE_BINARY_DIR}/Balanced3DGSConfig.cmake INSTALL_DESTINATION ${_b3dgs_package})
write_basic_package_version_file(${CMAKE_BINARY_DIR}/Balanced3DGSConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/Balanced3DGSConfig.cmake ${CMAKE_BINARY_DIR}/Balanced3DGSConfigVersion.cmake
  ${CMAKE_CURRENT_LIST_DIR}/LinkedPackages.cmake DESTINATION ${_b3dgs_package} COMPONENT development)
