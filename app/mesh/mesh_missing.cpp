// Replaces cmd_mesh.cpp in builds without the libraries for meshes.
#include "app/common/commands.h"
#include "core/check.h"

namespace b3dgs {

int run_mesh(const std::vector<std::string>&) {
  input_error(
      "this build has no meshes: install libopenvdb-dev, libmeshoptimizer-dev, libtinygltf-dev and libembree-dev, and "
      "build again");
}

}  // namespace b3dgs
