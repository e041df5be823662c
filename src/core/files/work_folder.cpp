#include "core/files/work_folder.h"

#include <stdlib.h>

#include <cerrno>
#include <cstring>
#include <string>

#include "core/check.h"
#include "core/files/remove_tree.h"

namespace b3dgs {

WorkFolder::WorkFolder(const std::filesystem::path& parent) {
  std::string name = (parent / ".b3dgs-work-XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) {
    io_error("cannot create a folder in ", parent.string(), ": ", std::strerror(errno));
  }
  path_ = name;
}

WorkFolder::~WorkFolder() {
  remove_tree(path_);
}

}  // namespace b3dgs
