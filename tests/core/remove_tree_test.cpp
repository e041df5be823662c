#include "core/files/folders.h"

#include <gtest/gtest.h>

#include <fstream>

#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

TEST(RemoveTree, RemovesAFolderAndFollowsNoLink) {
  const test::TempDir temp;
  fs::create_directories(temp / "kept");
  std::ofstream(temp / "kept" / "file") << "x";
  fs::create_directories(temp / "gone" / "a" / "b");
  std::ofstream(temp / "gone" / "a" / "file") << "x";
  fs::create_directory_symlink(temp / "kept", temp / "gone" / "link");
  EXPECT_TRUE(remove_tree(temp / "gone"));
  EXPECT_FALSE(fs::exists(temp / "gone"));
  EXPECT_TRUE(fs::exists(temp / "kept" / "file"));
}

TEST(RemoveTree, AcceptsAFileAndAMissingPath) {
  const test::TempDir temp;
  std::ofstream(temp / "file") << "x";
  EXPECT_TRUE(remove_tree(temp / "file"));
  EXPECT_FALSE(fs::exists(temp / "file"));
  EXPECT_TRUE(remove_tree(temp / "file"));
}

}  // namespace
}  // namespace b3dgs
