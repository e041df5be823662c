// Tests which files the program may remove and replace.
#include "core/files/own_files.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <climits>
#include <filesystem>
#include <string>
#include <vector>

#include "core/files/atomic_file.h"
#include "core/files/folders.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/processes.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;
using test::write_bytes;
using namespace std::string_literals;

/// Collects the lines that OwnFiles reports during a test.
class OwnFilesTest : public ::testing::Test {
 protected:
  OwnFilesTest() {
    OwnFiles::set_reporter([this](const std::string& line) { lines_.push_back(line); });
  }
  ~OwnFilesTest() override { OwnFiles::set_reporter({}); }

  TempDir folder_;
  std::vector<std::string> lines_;
};

TEST_F(OwnFilesTest, AFileOfTheUsersIsMovedAsideBeforeAnotherTakesItsPlace) {
  write_bytes(folder_ / "config.json", "mine");
  write_bytes(folder_ / "config.json.previous", "mine, too");
  const OwnFiles own(folder_.path());
  write_file(folder_ / "config.json", "first");
  EXPECT_EQ(read_bytes(folder_ / "config.json"), "first");
  EXPECT_EQ(read_bytes(folder_ / "config.json.previous"), "mine, too");
  EXPECT_EQ(read_bytes(folder_ / "config.json.previous.2"), "mine");
  ASSERT_EQ(lines_.size(), 1u);
  EXPECT_NE(lines_[0].find("it is kept as config.json.previous.2"), std::string::npos) << lines_[0];
  write_file(folder_ / "config.json", "second");
  EXPECT_EQ(read_bytes(folder_ / "config.json"), "second");
  EXPECT_EQ(lines_.size(), 1u) << "the program's own file is replaced";
  EXPECT_FALSE(fs::exists(folder_ / "config.json.previous.3"));
}

TEST_F(OwnFilesTest, TheRecordOutlivesTheObjectAndNoticesChanges) {
  {
    const OwnFiles own(folder_.path());
    write_file(folder_ / "a/b.txt", "own"), write_file(folder_ / "c", "own");
  }
  OwnFiles own(folder_.path());
  EXPECT_TRUE(own.is_own(folder_ / "a/b.txt"));
  EXPECT_TRUE(own.is_own(folder_ / "a/../c"));
  write_bytes(folder_ / "a/b.txt", "longer");
  EXPECT_FALSE(own.is_own(folder_ / "a/b.txt"));
  // The same size at another time.
  write_bytes(folder_ / "c", "new");
  fs::last_write_time(folder_ / "c", fs::last_write_time(folder_ / "c") + std::chrono::seconds(1));
  EXPECT_FALSE(own.is_own(folder_ / "c"));
  EXPECT_FALSE(own.is_own(folder_ / "none"));
  EXPECT_FALSE(own.is_own(folder_.path().parent_path() / "elsewhere"));
}

TEST_F(OwnFilesTest, OnlyOwnFilesAreRemoved) {
  OwnFiles own(folder_.path());
  write_file(folder_ / "model/a.ply", "own");
  write_file(folder_ / "model/deep/b.ply", "own");
  write_file(folder_ / "model/edited.ply", "own");
  write_bytes(folder_ / "model/deep/web.spz", "mine");
  write_bytes(folder_ / "model/edited.ply", "edited by the user");
  write_bytes(folder_ / "target", "mine");
  fs::create_symlink(folder_ / "target", folder_ / "model/link");
  own.remove(folder_ / "model");
  EXPECT_FALSE(fs::exists(folder_ / "model/a.ply"));
  EXPECT_FALSE(fs::exists(folder_ / "model/deep/b.ply"));
  EXPECT_EQ(read_bytes(folder_ / "model/deep/web.spz"), "mine");
  EXPECT_EQ(read_bytes(folder_ / "model/edited.ply"), "edited by the user");
  EXPECT_EQ(read_bytes(folder_ / "target"), "mine");
  EXPECT_TRUE(fs::is_symlink(folder_ / "model/link"));
  remove_tree(folder_ / "model");
  write_file(folder_ / "model/a/b/c", "own");
  own.remove(folder_ / "model");
  EXPECT_FALSE(fs::exists(folder_ / "model")) << "empty folders go, too";
}

TEST_F(OwnFilesTest, OwnFilesStayOwnWhenMoved) {
  OwnFiles own(folder_.path());
  write_file(folder_ / "a/b", "own");
  write_bytes(folder_ / "a/c", "mine");
  own.move(folder_ / "a", folder_ / "z");
  EXPECT_TRUE(own.is_own(folder_ / "z/b"));
  EXPECT_FALSE(own.is_own(folder_ / "z/c"));
  write_bytes(folder_ / "taken", "mine");
  own.move(folder_ / "z/b", folder_ / "taken");
  EXPECT_EQ(read_bytes(folder_ / "taken.previous"), "mine");
  EXPECT_TRUE(own.is_own(folder_ / "taken"));
  own.move(folder_ / "taken", folder_ / "z/b");
  own.remove(folder_ / "z");
  EXPECT_FALSE(fs::exists(folder_ / "z/b"));
  EXPECT_EQ(read_bytes(folder_ / "z/c"), "mine");
}

TEST_F(OwnFilesTest, AGrowingFileStaysOwnWhileItGrows) {
  OwnFiles own(folder_.path());
  write_file(folder_ / "log", "one\n");
  own.add(folder_ / "log", /*is_growing=*/true);
  write_bytes(folder_ / "log", "one\ntwo\n");
  EXPECT_TRUE(own.is_own(folder_ / "log"));
  write_bytes(folder_ / "log", "x");
  EXPECT_FALSE(own.is_own(folder_ / "log"));
}

TEST_F(OwnFilesTest, WhatAnotherObjectRecordsIsSeen) {
  OwnFiles one(folder_.path());
  {
    OwnFiles other(folder_.path());
    write_bytes(folder_ / "results.json", "of an evaluation");
    other.add(folder_ / "results.json");
  }
  EXPECT_TRUE(one.is_own(folder_ / "results.json"));
}

TEST_F(OwnFilesTest, AFileThatSeveralProcessesReplaceStaysOwn) {
  test::run_processes(4, [&](int) {
    const OwnFiles own(folder_.path());
    for (int i = 0; i < 50; ++i) write_file(folder_ / "results.json", std::to_string(i));
  });
  EXPECT_FALSE(fs::exists(folder_ / "results.json.previous"));
  EXPECT_TRUE(OwnFiles(folder_.path()).is_own(folder_ / "results.json"));
}

TEST_F(OwnFilesTest, ATurnLosesNoChangeOfAnotherProcess) {
  constexpr int kProcesses = 4, kTurns = 100;
  write_bytes(folder_ / "count", "0");
  test::run_processes(kProcesses, [&](int) {
    for (int i = 0; i < kTurns; ++i) {
      const FolderTurn turn(folder_.path());
      const FolderTurn nested(folder_.path() / ".");
      write_bytes(folder_ / "count", std::to_string(std::stoi(read_bytes(folder_ / "count")) + 1));
    }
  });
  EXPECT_EQ(read_bytes(folder_ / "count"), std::to_string(kProcesses * kTurns));
}

TEST_F(OwnFilesTest, ALockThatIsNotReleasedStopsNoFileFromBeingWritten) {
  OwnFiles own(folder_.path());
  write_file(folder_ / "a", "first");
  const Descriptor other(::open((folder_ / OwnFiles::kRecord).c_str(), O_RDWR | O_CLOEXEC));
  ASSERT_EQ(::flock(other.fd(), LOCK_EX), 0);
  FolderTurn::set_longest_wait({});
  write_file(folder_ / "a", "second");
  write_file(folder_ / "b", "first");
  EXPECT_TRUE(fails_with<IoError>({"folder in use: ", "holds the lock of .b3dgs-files"},
                                  [&] { const FolderTurn turn(folder_.path()); }));
  FolderTurn::set_longest_wait(std::chrono::minutes(1));
  EXPECT_EQ(read_bytes(folder_ / "a"), "second");
  EXPECT_TRUE(own.is_own(folder_ / "b"));
  ASSERT_EQ(lines_.size(), 1u);
  EXPECT_NE(lines_[0].find("holds the lock of .b3dgs-files); going on without it"), std::string::npos) << lines_[0];
}

TEST_F(OwnFilesTest, ACopyByHardLinksLeavesTheRecordOfItsOriginal) {
  {
    const OwnFiles own(folder_ / "model");
    write_file(folder_ / "model/a", "first"), write_file(folder_ / "model/b", "own");
  }
  const std::string before = read_bytes(folder_ / "model" / OwnFiles::kRecord);
  fs::create_directory(folder_ / "copy");
  for (const char* name : {"a", "b", OwnFiles::kRecord}) {
    fs::create_hard_link(folder_ / "model" / name, folder_ / "copy" / name);
  }
  OwnFiles copy(folder_ / "copy");
  write_file(folder_ / "copy/a", "second");
  EXPECT_EQ(read_bytes(folder_ / "model" / OwnFiles::kRecord), before);
  EXPECT_TRUE(OwnFiles(folder_ / "model").is_own(folder_ / "model/a"));
  OwnFiles again(folder_ / "copy");
  EXPECT_TRUE(again.is_own(folder_ / "copy/a"));
  EXPECT_TRUE(again.is_own(folder_ / "copy/b"));
  EXPECT_TRUE(lines_.empty());
}

TEST_F(OwnFilesTest, TheInnermostFolderHasTheRecord) {
  fs::create_directories(folder_ / "runs/a");
  OwnFiles outer(folder_.path()), inner(folder_ / "runs/a");
  EXPECT_EQ(OwnFiles::of(folder_ / "runs/a/train.jsonl"), &inner);
  EXPECT_EQ(OwnFiles::of(folder_ / "report.html"), &outer);
  EXPECT_EQ(OwnFiles::of("/nowhere"), nullptr);
}

TEST_F(OwnFilesTest, FoldersThatAreLinksOutOfTheFolderFollowTheSameRule) {
  write_bytes(folder_ / "elsewhere/a.png", "mine");
  fs::create_directory(folder_ / "out");
  fs::create_directory_symlink(folder_ / "elsewhere", folder_ / "out/images");
  OwnFiles own(folder_ / "out");
  write_file(folder_ / "out/images/a.png", "own");
  EXPECT_EQ(read_bytes(folder_ / "elsewhere/a.png.previous"), "mine");
  write_file(folder_ / "out/images/a.png", "next");
  EXPECT_FALSE(fs::exists(folder_ / "elsewhere/a.png.previous.2"));
  own.remove(folder_ / "out/images");
  EXPECT_TRUE(fs::is_symlink(folder_ / "out/images")) << "the link is the user's";
  EXPECT_EQ(read_bytes(folder_ / "elsewhere/a.png"), "next");
}

TEST_F(OwnFilesTest, NamesMayHoldAnything) {
  const std::string name = "a\\b\nc d \xC3\xBC";
  {
    const OwnFiles own(folder_.path());
    write_file(folder_ / name, "own");
  }
  EXPECT_TRUE(OwnFiles(folder_.path()).is_own(folder_ / name));
}

TEST_F(OwnFilesTest, ADamagedRecordMakesFilesTheUsers) {
  {
    const OwnFiles own(folder_.path());
    write_file(folder_ / "a", "own");
  }
  write_bytes(folder_ / ".b3dgs-files", "\0\1garbage\n99 99 f\n-1 x f a\n3"s);
  EXPECT_FALSE(OwnFiles(folder_.path()).is_own(folder_ / "a"));
}

TEST_F(OwnFilesTest, ARecordThatCannotBeReadMakesFilesTheUsers) {
  write_bytes(folder_ / "a", "mine");
  ASSERT_EQ(::mkfifo((folder_ / OwnFiles::kRecord).c_str(), 0600), 0);
  OwnFiles own(folder_.path());
  EXPECT_FALSE(own.is_own(folder_ / "a"));
  write_file(folder_ / "a", "new");
  EXPECT_EQ(read_bytes(folder_ / "a.previous"), "mine");
}

TEST(FolderLocks, NameTheHolderAndItsHost) {
  TempDir folder;
  const FolderLock lock(folder.path());
  const std::string own = "(by process " + std::to_string(::getpid());
  EXPECT_TRUE(fails_with<InputError>({own + ": ", "core_tests"}, [&] { FolderLock again(folder.path()); }));
  std::array<char, HOST_NAME_MAX + 1> host{};
  ASSERT_EQ(::gethostname(host.data(), HOST_NAME_MAX), 0);
  for (const std::string& other : {"node-7 5"s, "node-7 "s + std::to_string(process_space()), host.data() + " 5"s}) {
    write_bytes(folder / ".b3dgs-lock", std::to_string(::getpid()) + " " + other + "\n");
    const std::string name = other.substr(0, other.find(' '));
    EXPECT_TRUE(fails_with<InputError>({own + " on " + name + "); wait"}, [&] { FolderLock again(folder.path()); }));
  }
}

}  // namespace
}  // namespace b3dgs
