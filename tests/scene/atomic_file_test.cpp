#include "scene/atomic_file.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include "check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;

std::size_t count_files(const fs::path& folder) {
  return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

// Lets no file of this process grow beyond `bytes`: writing further fails as on a full disk, with another reason.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) : handler_(::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limited{bytes, before_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limited);
  }
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    ::signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_{};
  void (*handler_)(int);
};

TEST(AtomicFile, IsNotThereBeforeCommitAndWholeAfter) {
  TempDir folder;
  const fs::path target = folder / "new" / "deep" / "file.txt";
  AtomicFile file(target);
  file.write("first ");
  file.write("second");
  EXPECT_FALSE(fs::exists(target));
  file.commit();
  EXPECT_EQ(read_bytes(target), "first second");
  EXPECT_EQ(count_files(target.parent_path()), 1u);
}

TEST(AtomicFile, WithoutCommitLeavesTheOldFileAndNothingElse) {
  TempDir folder;
  write_file(folder / "a", "old");
  {
    AtomicFile file(folder / "a");
    file.write("new");
  }
  EXPECT_EQ(read_bytes(folder / "a"), "old");
  EXPECT_EQ(count_files(folder.path()), 1u);
}

TEST(AtomicFile, ReplacesTheOldFile) {
  TempDir folder;
  write_file(folder / "a", "a long old content");
  write_file(folder / "a", "new");
  EXPECT_EQ(read_bytes(folder / "a"), "new");
}

TEST(AtomicFile, HasTheModeThatTheUmaskLeaves) {
  TempDir folder;
  const mode_t before = ::umask(0027);
  write_file(folder / "a", "x");
  ::umask(before);
  struct stat status {};
  ASSERT_EQ(::stat((folder / "a").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, mode_t{0640});
}

TEST(AtomicFile, SaysWhyAWriteFailedAndKeepsTheOldFile) {
  TempDir folder;
  const fs::path target = folder / "big.ply";
  write_file(target, "old");
  const std::string content(100000, 'x');
  {
    FileSizeLimit limit(4096);
    EXPECT_TRUE(
        fails_with<IoError>({target.string(), "100000 bytes", "File too large"}, [&] { write_file(target, content); }));
  }
  EXPECT_EQ(read_bytes(target), "old");
  EXPECT_EQ(count_files(folder.path()), 1u);
}

TEST(AtomicFile, NamesTheTargetWhenItsFolderCannotBeMade) {
  TempDir folder;
  write_file(folder / "plain", "a file, no folder");
  const fs::path target = folder / "plain" / "b.txt";
  EXPECT_TRUE(fails_with<IoError>({target.string(), "Not a directory"}, [&] { AtomicFile file(target); }));
}

TEST(AtomicFile, NamesTheTargetWhenItIsAFolder) {
  TempDir folder;
  fs::create_directories(folder / "taken" / "inside");
  EXPECT_TRUE(fails_with<IoError>({(folder / "taken").string()}, [&] { write_file(folder / "taken", "x"); }));
  EXPECT_EQ(count_files(folder.path()), 1u);
}

}  // namespace
}  // namespace b3dgs
