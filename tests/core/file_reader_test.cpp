// Tests which files can be read, and which are refused without waiting.
#include "core/files/file_reader.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstring>
#include <string>

#include "core/files/json_file.h"
#include "core/json_text.h"
#include "core/options/command_line.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::TempDir;
using test::write_bytes;

TEST(ReadableFiles, AreRegularOnes) {
  TempDir folder;
  write_bytes(folder / "plain", "content");
  fs::create_symlink("plain", folder / "link");
  EXPECT_EQ(read_whole_file(folder / "plain"), "content");
  EXPECT_EQ(read_whole_file(folder / "link"), "content");
  EXPECT_EQ(read_file_if_there(folder / "plain"), "content");
  EXPECT_EQ(read_file_if_there(folder / "none"), std::nullopt);
  EXPECT_EQ(read_file_if_there(folder / "plain/none"), std::nullopt);
  EXPECT_TRUE(fails_with<InputError>({"none", "No such file"}, [&] { read_whole_file(folder / "none"); }));
}

TEST(ReadableFiles, DoNotIncludeFifosFoldersSocketsAndDevices) {
  TempDir folder;
  ASSERT_EQ(::mkfifo((folder / "fifo").c_str(), 0600), 0);
  fs::create_directory(folder / "folder");
  const Descriptor socket(::socket(AF_UNIX, SOCK_STREAM, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, (folder / "socket").c_str(), sizeof(address.sun_path) - 1);
  ASSERT_EQ(::bind(socket.fd(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  const std::pair<fs::path, const char*> kinds[] = {{folder / "fifo", "found a FIFO"},
                                                    {folder / "folder", "found a folder"},
                                                    {folder / "socket", "found a socket"},
                                                    {"/dev/zero", "found a device"}};
  for (const auto& [path, found] : kinds) {
    const fs::path file = path;
    EXPECT_TRUE(fails_with<InputError>({file.string(), found}, [&] { FileReader reader(file); }));
    EXPECT_TRUE(fails_with<InputError>({file.string(), found}, [&] { read_whole_file(file); }));
    EXPECT_TRUE(fails_with<InputError>({file.string(), found}, [&] { read_file_if_there(file); }));
    EXPECT_TRUE(fails_with<InputError>({file.string(), found}, [&] { read_json(file); }));
    EXPECT_TRUE(fails_with<InputError>({file.string(), found}, [&] { read_json_file(file, "options"); }));
  }
}

TEST(ReadableFiles, IncludeAPipeThatTheShellHasOpened) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::pipe(ends.data()), 0);
  const Descriptor read_end(ends[0]);
  {
    const Descriptor write_end(ends[1]);
    ASSERT_EQ(::write(write_end.fd(), "{\"a\": 1}", 8), 8);
  }
  const std::string path = "/dev/fd/" + std::to_string(read_end.fd());
  EXPECT_EQ(read_json_file(path, "options").at("a"), 1);
}

TEST(ReadableFiles, IncludeAPipeAtStandardInput) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::pipe(ends.data()), 0);
  const Descriptor read_end(ends[0]), before(::dup(STDIN_FILENO));
  {
    const Descriptor write_end(ends[1]);
    ASSERT_EQ(::write(write_end.fd(), "{\"a\": 1}", 8), 8);
  }
  ASSERT_EQ(::dup2(read_end.fd(), STDIN_FILENO), STDIN_FILENO);
  EXPECT_EQ(read_json_file("/dev/stdin", "options").at("a"), 1);
  ::dup2(before.fd(), STDIN_FILENO);
}

TEST(ReadableFiles, AreReadToTheirEndAlthoughASignalInterrupts) {
  std::array<int, 2> ends{};
  ASSERT_EQ(::pipe(ends.data()), 0);
  const Descriptor read_end(ends[0]);
  static int write_end = -1;
  write_end = ends[1];
  struct sigaction action {
  }, before{};
  action.sa_handler = [](int) {  // interrupts the read() that waits, which then finds the content
    if (::write(write_end, "whole", 5) == 5) ::close(write_end);
  };
  ASSERT_EQ(::sigaction(SIGALRM, &action, &before), 0);
  ::ualarm(1000, 0);
  EXPECT_EQ(read_whole_file("/dev/fd/" + std::to_string(read_end.fd())), "whole");
  ::sigaction(SIGALRM, &before, nullptr);
}

TEST(JsonFiles, AreExpectedBeforeTheRemedy) {
  TempDir folder;
  ASSERT_EQ(::mkfifo((folder / "fifo").c_str(), 0600), 0);
  EXPECT_TRUE(
      fails_with<InputError>({"expected options: file cannot be read: ", "found a FIFO); copy its content into"},
                             [&] { read_json_file(folder / "fifo", "options"); }));
}

TEST(JsonFiles, WithTheSameKeyTwiceAreRefused) {
  TempDir folder;
  const fs::path file = folder / "a.json";
  for (const char* text : {R"({"iterations": 10, "iterations": 15})", R"({"a": [{"b": 1}, {"iterations": {}, "c": 2,
       "iterations": 3}]})",
                           R"({"iterations": 1, "\u0069terations": 2})"}) {
    write_bytes(file, text);
    EXPECT_TRUE(parse_json(std::string(text)).is_discarded());
    EXPECT_TRUE(fails_with<InputError>({file.string(), "\"iterations\" twice"}, [&] { read_json(file); }));
    EXPECT_TRUE(
        fails_with<InputError>({file.string(), "\"iterations\" twice"}, [&] { read_json_file(file, "options"); }));
  }
  const std::string good = R"({"a": {"b": 1}, "b": [{"a": 1}, {"a": 2}]})";
  write_bytes(file, good);
  EXPECT_EQ(read_json(file), nlohmann::ordered_json::parse(good));
  EXPECT_TRUE(read_json(folder / "none").is_null());
}

TEST(JsonFiles, NameOnlyFilesOfTheirFolder) {
  TempDir folder;
  write_bytes(folder / "private.png", "private");
  write_bytes(folder / "report/a.png", "public");
  fs::create_symlink(folder / "private.png", folder / "report/link.png");
  fs::create_directory_symlink(folder.path(), folder / "report/up");
  const fs::path report = folder / "report";
  EXPECT_EQ(file_in(report, "a.png", "place"), report / "a.png");
  EXPECT_EQ(file_in(report, "later.png", "place"), report / "later.png");
  for (const std::string& name : {(folder / "private.png").string(), std::string("../private.png"), std::string(".."),
                                  std::string("."), std::string(), std::string("./a.png"), std::string("a.png/"),
                                  std::string("up/private.png"), std::string("link.png"), std::string("a.png\0", 6)}) {
    EXPECT_TRUE(fails_with<InputError>({"place: expected the name of a file in", report.string()}, [&] {
      file_in(report, name, "place");
    })) << name;
  }
}

}  // namespace
}  // namespace b3dgs
