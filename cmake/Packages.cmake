# cpack: a .deb and a .tar.gz with the program and the shared libraries that it needs (cmake/BundleLibraries.cmake).
# Without B3DGS_BUNDLE_TORCH, LibTorch is that of an installed PyTorch, which a script finds and checks.

install(CODE "set(PROGRAM \"$<TARGET_FILE:b3dgs>\")
  set(ENGINE \"$<TARGET_FILE:b3dgs_engine>\")
  set(TORCH \"${TORCH_INSTALL_PREFIX}\")
  set(BUNDLE_TORCH ${B3DGS_BUNDLE_TORCH})" COMPONENT libraries EXCLUDE_FROM_ALL)
install(SCRIPT ${CMAKE_CURRENT_LIST_DIR}/BundleLibraries.cmake COMPONENT libraries EXCLUDE_FROM_ALL)

set(CPACK_GENERATOR DEB TGZ)
set(CPACK_PACKAGE_NAME b3dgs)
set(CPACK_PACKAGE_CONTACT "The Balanced3DGS authors")
set(CPACK_PACKAGE_VENDOR "Balanced3DGS")
set(CPACK_PACKAGE_FILE_NAME b3dgs-${PROJECT_VERSION}-${CMAKE_SYSTEM_NAME}-${CMAKE_SYSTEM_PROCESSOR})
if(NOT B3DGS_BUNDLE_TORCH)
  string(APPEND CPACK_PACKAGE_NAME -pytorch)
  string(APPEND CPACK_PACKAGE_FILE_NAME -pytorch)
endif()
set(CPACK_RESOURCE_FILE_LICENSE ${PROJECT_SOURCE_DIR}/LICENSE)
set(CPACK_STRIP_FILES ON)
set(CPACK_PACKAGE_DIRECTORY ${CMAKE_BINARY_DIR}/packages)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_COMPRESSION_TYPE zstd)
set(CPACK_DEBIAN_PACKAGE_SECTION graphics)
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "colmap, ffmpeg")
# Packages that are not bundled must be at least as new as here.
execute_process(COMMAND dpkg-query -W -f "\${Package} (>= \${source:Upstream-Version})\n" libc6 libstdc++6 libgcc-s1
  OUTPUT_VARIABLE _depends OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
string(REPLACE "\n" ", " CPACK_DEBIAN_PACKAGE_DEPENDS "${_depends}")
# Excludes the component "development" (cmake/Library.cmake).
set(CPACK_INSTALL_CMAKE_PROJECTS ${CMAKE_BINARY_DIR} ${PROJECT_NAME} Unspecified /
  ${CMAKE_BINARY_DIR} ${PROJECT_NAME} libraries /)
include(CPack)
