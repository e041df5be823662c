#include "core/files/atomic_file.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <memory>

#include "core/check.h"
#include "core/stop_signals.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace {

std::vector<std::filesystem::path>& synced_paths() {
  static std::vector<std::filesystem::path> paths;
  return paths;
}

}  // namespace

/// Replaces fsync() of the C library and records the synced files.
extern "C" int fsync(int file) {
  std::error_code error;
  synced_paths().push_back(std::filesystem::read_symlink("/proc/self/fd/" + std::to_string(file), error));
  return static_cast<int>(::syscall(SYS_fsync, file));
}

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;

std::size_t count_files(const fs::path& folder) {
  return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

// Limits the size of files that this process writes. A write beyond it fails as on a full disk, but with EFBIG.
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

TEST(AtomicFile, ExistsOnlyAfterCommit) {
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

TEST(AtomicFile, WithoutCommitTheOldFileIsUnchanged) {
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

TEST(AtomicFile, RespectsTheUmask) {
  TempDir folder;
  const mode_t before = ::umask(0027);
  write_file(folder / "a", "x");
  ::umask(before);
  struct stat status {};
  ASSERT_EQ(::stat((folder / "a").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, mode_t{0640});
}

TEST(AtomicFile, AFailedWriteReportsTheReasonAndKeepsTheOldFile) {
  TempDir folder;
  const fs::path target = folder / "big.ply";
  write_file(target, "old");
  const std::string content(100000, 'x');
  {
    FileSizeLimit limit(4096);
    EXPECT_TRUE(fails_with<IoError>(
        {target.string(), "100000 bytes", "File too large", "ulimit", "the existing file is unchanged"},
        [&] { write_file(target, content); }));
  }
  EXPECT_EQ(read_bytes(target), "old");
  EXPECT_EQ(count_files(folder.path()), 1u);
}

TEST(AtomicFile, NamesTheTargetIfItsFolderCannotBeCreated) {
  TempDir folder;
  write_file(folder / "plain", "a file, not a folder");
  const fs::path target = folder / "plain" / "b.txt";
  EXPECT_TRUE(fails_with<IoError>({target.string(), "Not a directory"}, [&] { AtomicFile file(target); }));
}

TEST(AtomicFile, NamesTheTargetIfItIsAFolder) {
  TempDir folder;
  fs::create_directories(folder / "taken" / "inside");
  EXPECT_TRUE(fails_with<IoError>({(folder / "taken").string()}, [&] { write_file(folder / "taken", "x"); }));
  EXPECT_EQ(count_files(folder.path()), 1u);
}

TEST(AtomicFile, SyncsNewFoldersAndTheirParents) {
  TempDir folder;
  const fs::path root = fs::canonical(folder.path());
  synced_paths().clear();
  write_file(root / "new" / "deep" / "a", "x");
  const auto is_synced = [&](const fs::path& path) {
    return std::count(synced_paths().begin(), synced_paths().end(), path) > 0;
  };
  EXPECT_TRUE(is_synced(root)) << "else new/ could be lost";
  EXPECT_TRUE(is_synced(root / "new"));
  EXPECT_TRUE(is_synced(root / "new" / "deep"));
  synced_paths().clear();
  write_file(root / "new" / "deep" / "a", "y");
  EXPECT_FALSE(is_synced(root)) << "its content did not change";
}

TEST(AtomicFile, RewriteReplacesEarlierBytes) {
  TempDir folder;
  AtomicFile file(folder / "a");
  file.write("0123456789");
  file.rewrite(3, "abc", 3);
  file.write("more");
  file.commit();
  EXPECT_EQ(read_bytes(folder / "a"), "012abc6789more");
}

TEST(RequireWritable, RefusesWhatCannotBeWrittenAndLeavesNothing) {
  TempDir folder;
  require_writable(folder / "new/deep/file.txt", "remedy");
  EXPECT_EQ(count_files(folder.path()), 0u);
  test::write_bytes(folder / "a", "old");
  require_writable(folder / "a", "remedy");
  EXPECT_EQ(read_bytes(folder / "a"), "old");
  EXPECT_TRUE(fails_with<InputError>({"cannot write", "a/b", "Not a directory); use another"},
                                     [&] { require_writable(folder / "a/b", "use another"); }));
  EXPECT_TRUE(fails_with<InputError>({"expected a file, found a folder); use another"},
                                     [&] { require_writable(folder.path(), "use another"); }));
  EXPECT_EQ(count_files(folder.path()), 1u);
}

/// Sends `signal` to a process that has called `write` and has its result open.
template <class Write>
void end_while_writing(int signal, const Write& write) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::pipe(ends.data()), 0);
  const pid_t child = ::fork();
  if (child == 0) {
    std::signal(signal, SIG_DFL);  // it may be ignored, and would stay so
    end_by_stop_signals();
    const auto open = write();
    if (::write(ends[1], "x", 1) != 1) ::_exit(1);
    for (;;) ::pause();
  }
  char ready = 0;
  ASSERT_EQ(::read(ends[0], &ready, 1), 1);
  ::kill(child, signal);
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFSIGNALED(status) && WTERMSIG(status) == signal) << status;
  ::close(ends[0]), ::close(ends[1]);
}

TEST(UnfinishedFiles, AreRemovedByASignal) {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    TempDir folder;
    test::write_bytes(folder / "a.ply", "old");
    end_while_writing(signal, [&] {
      auto file = std::make_unique<AtomicFile>(folder / "a.ply");
      file->write("new");
      return file;
    });
    end_while_writing(signal, [&] {
      auto work = std::make_unique<WorkFolder>(folder.path());
      test::write_bytes(work->path() / "deep/er/b", "x"), test::write_bytes(work->path() / "c", "x");
      fs::create_directory_symlink(folder.path(), work->path() / "link");
      return work;
    });
    EXPECT_EQ(read_bytes(folder / "a.ply"), "old");
    EXPECT_EQ(count_files(folder.path()), 1u);
  }
}

TEST(UnfinishedFiles, OfAKilledProcessAreRemovedByTheNextFile) {
  TempDir folder;
  end_while_writing(SIGKILL, [&] { return std::make_unique<AtomicFile>(folder / "a.ply"); });
  EXPECT_EQ(count_files(folder.path()), 1u);
  AtomicFile open(folder / "b.ply");
  EXPECT_EQ(count_files(folder.path()), 1u);
  write_file(folder / "c.ply", "new");
  EXPECT_TRUE(fs::exists(open.temporary()));
  EXPECT_EQ(count_files(folder.path()), 2u);
}

TEST(UnfinishedFiles, WorkFoldersOfAKilledProcessAreRemovedByTheNextFile) {
  for (const bool is_next_file : {true, false}) {
    TempDir folder;
    const pid_t child = ::fork();
    if (child == 0) {
      const WorkFolder work(folder.path());
      test::write_bytes(work.path() / "frames/0.png", "x");
      ::raise(SIGKILL);
    }
    ASSERT_EQ(::waitpid(child, nullptr, 0), child);
    EXPECT_EQ(count_files(folder.path()), 1u);
    const WorkFolder own(folder.path());
    is_next_file ? write_file(folder / "a", "x") : remove_unfinished_files(folder.path());
    EXPECT_TRUE(fs::exists(own.path()));
    EXPECT_EQ(count_files(folder.path()), is_next_file ? 2u : 1u);
  }
}

/// Returns the name of a temporary file up to the process ID.
std::string temporary_prefix() {
  TempDir folder;
  const std::string name = AtomicFile(folder / "a").temporary().filename().string();
  return name.substr(0, name.find("-" + std::to_string(::getpid()) + "-") + 1);
}

TEST(UnfinishedFiles, OnlyThoseOfDeadProcessesAreRemoved) {
  TempDir folder;
  const std::string prefix = temporary_prefix();
  const pid_t dead = ::fork();
  if (dead == 0) ::_exit(0);
  ASSERT_EQ(::waitpid(dead, nullptr, 0), dead);
  const std::string of_dead = prefix + std::to_string(dead) + "-7.tmp";
  const std::string of_living = prefix + std::to_string(::getppid()) + "-7.tmp";
  const std::string of_earlier = prefix + std::to_string(::getpid()) + "-7.tmp";  // process IDs are reused
  for (const fs::path& where : {folder.path(), folder / "point_cloud/iteration_7"}) {
    for (const std::string& name : {of_dead, of_living, of_earlier, of_dead + "x", std::string(".b3dgs-notes.tmp")}) {
      test::write_bytes(where / name, "x");
    }
  }
  remove_unfinished_files(folder.path());
  for (const fs::path& where : {folder.path(), folder / "point_cloud/iteration_7"}) {
    EXPECT_FALSE(fs::exists(where / of_dead));
    EXPECT_FALSE(fs::exists(where / of_earlier));
    EXPECT_TRUE(fs::exists(where / of_living));
    EXPECT_TRUE(fs::exists(where / (of_dead + "x")));
    EXPECT_TRUE(fs::exists(where / ".b3dgs-notes.tmp"));
  }
  remove_unfinished_files(folder / "none");
}

TEST(UnfinishedFiles, ThoseOfOtherMachinesAndContainersAreKeptForADay) {
  TempDir folder;
  const std::string prefix = temporary_prefix();
  const std::string other = prefix == ".b3dgs-1-" ? ".b3dgs-2-" : ".b3dgs-1-";
  const fs::path fresh = folder / (other + "1-7.tmp"),
                 same_id = folder / (other + std::to_string(::getpid()) + "-7.tmp"), old = folder / (other + "1-8.tmp");
  for (const fs::path& file : {fresh, same_id, old}) test::write_bytes(file, "x");
  fs::last_write_time(old, fs::last_write_time(old) - std::chrono::hours(25));
  remove_unfinished_files(folder.path());
  EXPECT_TRUE(fs::exists(fresh));
  EXPECT_TRUE(fs::exists(same_id));
  EXPECT_FALSE(fs::exists(old));
}

}  // namespace
}  // namespace b3dgs
