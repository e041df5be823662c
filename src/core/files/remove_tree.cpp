#include "core/files/remove_tree.h"

#include <ftw.h>

#include <sys/stat.h>

#include <cstdio>

namespace b3dgs {
namespace {

int remove_entry(const char* path, const struct stat*, int, FTW*) {
  return std::remove(path);
}

}  // namespace

bool remove_tree(const std::filesystem::path& path) {
  constexpr int kOpenFolders = 16;
  struct stat status;
  if (::lstat(path.c_str(), &status) != 0) return true;
  return ::nftw(path.c_str(), remove_entry, kOpenFolders, FTW_DEPTH | FTW_PHYS) == 0;
}

}  // namespace b3dgs
