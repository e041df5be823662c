# cpack: a .deb, whose dependencies follow from the libraries that are linked, and a .tar.gz.

set(CPACK_GENERATOR DEB TGZ)
set(CPACK_PACKAGE_NAME b3dgs)
set(CPACK_PACKAGE_CONTACT "The Balanced3DGS authors")
set(CPACK_PACKAGE_VENDOR "Balanced3DGS")
set(CPACK_RESOURCE_FILE_LICENSE ${PROJECT_SOURCE_DIR}/LICENSE)
set(CPACK_STRIP_FILES ON)
set(CPACK_PACKAGE_DIRECTORY ${CMAKE_BINARY_DIR}/packages)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION graphics)
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "colmap, ffmpeg")
# A LibTorch from elsewhere belongs to no package, so its libraries can't be looked up.
if(TORCH_INSTALL_PREFIX STREQUAL "/usr")
  set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
endif()
# The program, without the component "development" (cmake/Library.cmake).
set(CPACK_INSTALL_CMAKE_PROJECTS "${CMAKE_BINARY_DIR};${PROJECT_NAME};Unspecified;/")
include(CPack)
