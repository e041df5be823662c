#include "core/process/child_process.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <thread>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;
using test::write_bytes;

struct Output {
  ChildResult result;
  std::vector<std::string> lines;
};

Output run_shell(const std::string& script, const std::atomic<int>* stop = nullptr) {
  Output output;
  output.result = run_program_lines(
      {"sh", "-c", script}, [&](const std::string& line) { output.lines.push_back(line); }, stop);
  return output;
}

using Lines = std::vector<std::string>;

TEST(ChildProcess, TellsTheExitCodeOrTheSignal) {
  EXPECT_TRUE(run_shell("true").result.succeeded());
  const ChildResult failed = run_shell("exit 3").result;
  EXPECT_EQ(failed.exit_code, 3);
  EXPECT_EQ(failed.signal, 0);
  EXPECT_EQ(describe(failed), "exit code 3");
  const ChildResult killed = run_shell("kill -SEGV $$").result;
  EXPECT_FALSE(killed.succeeded());
  EXPECT_EQ(killed.signal, SIGSEGV);
  EXPECT_EQ(describe(killed), "ended by signal 11 (Segmentation fault)");
}

TEST(ChildProcess, PassesOnBothOutputsInTheirOrderLineByLine) {
  const Output output = run_shell(R"(echo one; echo two >&2; printf '\n1%%\r2%%\r\nthree\n\nlast')");
  EXPECT_EQ(output.lines, (Lines{"one", "two", "", "1%", "2%", "three", "", "last"}));
}

TEST(ChildProcess, ReadsLargeOutputToItsEnd) {
  const Output output = run_shell("seq 200000; printf '%0100000d' 0");
  ASSERT_EQ(output.lines.size(), 200002u);
  EXPECT_EQ(output.lines[199999], "200000");
  EXPECT_EQ(output.lines[200000].size() + output.lines[200001].size(), 100000u);
}

TEST(ChildProcess, ReadsBytesBesideTheLinesOfStandardError) {
  std::string bytes;
  Lines lines;
  const ChildResult result = run_program_lines(
      {"sh", "-c", "echo one >&2; head -c 300000 /dev/zero; echo two >&2; exit 6"},
      [&](const std::string& line) { lines.push_back(line); }, nullptr,
      [&](const char* data, std::size_t size) { bytes.append(data, size); });
  EXPECT_EQ(result.exit_code, 6);
  EXPECT_EQ(bytes, std::string(300000, '\0'));
  EXPECT_EQ(lines, (Lines{"one", "two"}));
}

TEST(ChildProcess, PassesWordsOnWithoutAShell) {
  Lines lines;
  run_program_lines({"printf", "%s\n", "a b", "$HOME", "'\"*"},
                    [&](const std::string& line) { lines.push_back(line); });
  EXPECT_EQ(lines, (Lines{"a b", "$HOME", "'\"*"}));
}

TEST(ChildProcess, GivesEmptyInputAndNoOtherOpenFiles) {
  const int leaked = open("/dev/null", O_RDONLY);  // without O_CLOEXEC
  const Output output = run_shell("cat; ls /proc/self/fd | tr '\\n' ' '");
  close(leaked);
  // 3 is the folder that ls lists.
  EXPECT_EQ(output.lines, (Lines{"0 1 2 3 "}));
}

TEST(ChildProcess, NamesAMissingProgram) {
  const auto run = [](const std::string& program) { run_program_lines({program}, {}); };
  EXPECT_TRUE(fails_with<InputError>({"program not found: b3dgs-no-such-program", "PATH"},
                                     [&] { run("b3dgs-no-such-program"); }));
  const TempDir folder;
  EXPECT_TRUE(fails_with<InputError>({"not found", "absent"}, [&] { run((folder / "absent").string()); }));
  write_bytes(folder / "damaged", "not a program");
  ASSERT_EQ(chmod((folder / "damaged").c_str(), 0755), 0);
  EXPECT_TRUE(fails_with<IoError>({"cannot start", "damaged"}, [&] { run((folder / "damaged").string()); }));
}

TEST(ChildProcess, FindsProgramsInPath) {
  EXPECT_EQ(find_program("/bin/sh"), "/bin/sh");
  EXPECT_NE(find_program("sh"), "");
  EXPECT_EQ(find_program(""), "");
  EXPECT_EQ(find_program("/"), "") << "a folder is no program";
}

TEST(ChildProcess, DoesNotWaitForProcessesThatAProgramLeavesBehind) {
  const TempDir folder;
  const std::string pid_file = (folder / "pid").string();
  const Output output = run_shell("sleep 600 & echo $! > " + pid_file + "; echo done");
  EXPECT_TRUE(output.result.succeeded());
  EXPECT_EQ(output.lines, Lines{"done"});
  kill(std::stoi(read_bytes(pid_file)), SIGKILL);
}

/// Returns whether the process has ended, even if nobody has waited for it.
bool has_ended(pid_t pid) {
  const std::string status = read_bytes("/proc/" + std::to_string(pid) + "/status");
  return status.empty() || status.find("State:\tZ") != std::string::npos;
}

TEST(ChildProcess, StopEndsTheProgramAndItsChildren) {
  const TempDir folder;
  std::atomic<int> stop{0};
  pid_t grandchild = 0;
  const ChildResult result = run_program_lines(
      {"sh", "-c", "sleep 600 & echo $!; wait"},
      [&](const std::string& line) {
        grandchild = std::stoi(line);
        stop = 1;
      },
      &stop);
  EXPECT_EQ(result.signal, SIGTERM);
  EXPECT_GT(grandchild, 0);
  while (!has_ended(grandchild)) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

TEST(ChildProcess, StopKillsAProgramThatIgnoresIt) {
  std::atomic<int> stop{0};
  const ChildResult result = run_program_lines(
      {"sh", "-c", "trap '' TERM; echo ready; while :; do sleep 0.05; done"},
      [&](const std::string& line) { stop = line == "ready" ? 1 : 0; }, &stop);
  EXPECT_EQ(result.signal, SIGKILL);
}

TEST(ChildProcess, SaysThatAProgramWasToldToEndEvenIfItExits) {
  std::atomic<int> stop{0};
  const ChildResult result = run_program_lines(
      {"sh", "-c", "trap 'exit 0' TERM; echo ready; while :; do sleep 0.05; done"},
      [&](const std::string&) { stop = 1; }, &stop);
  EXPECT_EQ(result.signal, SIGTERM);
}

std::atomic<int> handled{0};

TEST(ChildProcess, ASignalEndsTheProgramAndCallsTheHandler) {
  handled = 0;
  const auto before = signal(SIGINT, [](int number) { handled = number; });
  const ChildResult result =
      run_program_lines({"sh", "-c", "echo ready; sleep 600"}, [](const std::string&) { raise(SIGINT); });
  EXPECT_EQ(result.signal, SIGTERM);
  EXPECT_EQ(handled, SIGINT);
  handled = 0;
  raise(SIGINT);
  EXPECT_EQ(handled, SIGINT) << "the handler was not put back";
  signal(SIGINT, before);
}

TEST(ChildProcess, ASignalWithoutAHandlerEndsThisProcessAfterTheProgram) {
  const TempDir folder;
  const pid_t parent = fork();
  if (parent == 0) {
    signal(SIGTERM, SIG_DFL);
    run_program_lines({"sh", "-c",
                       "echo $$"
                       "; exec sleep 600"},
                      [&](const std::string& line) {
                        std::ofstream(folder / "pid") << line;
                        raise(SIGTERM);
                      });
    _exit(0);
  }
  int status = 0;
  ASSERT_EQ(waitpid(parent, &status, 0), parent);
  ASSERT_TRUE(WIFSIGNALED(status));
  EXPECT_EQ(WTERMSIG(status), SIGTERM);
  EXPECT_TRUE(has_ended(std::stoi(read_bytes(folder / "pid"))));
}

TEST(ChildProcess, AnExceptionKillsTheProgram) {
  pid_t child = 0;
  EXPECT_TRUE(fails_with<IoError>({"full"}, [&] {
    run_program_lines({"sh", "-c", "echo $$; exec sleep 600"}, [&](const std::string& line) {
      child = std::stoi(line);
      io_error("full");
    });
  }));
  EXPECT_EQ(kill(child, 0), -1);
}

constexpr std::size_t kMoreThanAPipeHolds = 4 << 20;

TEST(Child, PassesBytesOnAndReadsWhatTheProgramSays) {
  Lines lines;
  Child child({"sh", "-c", "wc -c; echo end >&2"}, [&](const std::string& line) { lines.push_back(line); });
  const std::string bytes(1000003, 'x');
  EXPECT_TRUE(child.write(bytes.data(), bytes.size()));
  EXPECT_TRUE(child.write("\n", 1));
  EXPECT_TRUE(child.finish().succeeded());
  EXPECT_EQ(lines, (Lines{"1000004", "end"}));
}

TEST(Child, DoesNotBlockIfTheProgramWritesAsMuchAsItReads) {
  std::size_t bytes_read = 0;
  Child child({"cat"}, [&](const std::string& line) { bytes_read += line.size() + 1; });
  const std::string line = std::string(999, 'x') + "\n";
  for (int i = 0; i < 3000; ++i) ASSERT_TRUE(child.write(line.data(), line.size()));
  EXPECT_TRUE(child.finish().succeeded());
  EXPECT_EQ(bytes_read, 3000000u);
}

TEST(Child, AProgramThatEndsEarlyIsToldAndDoesNotEndThisOne) {
  Child child({"sh", "-c", "head -c 10 > /dev/null; echo disk full; exit 4"});
  const std::string bytes(kMoreThanAPipeHolds, 'x');
  bool is_taken = true;
  for (int i = 0; i < 100 && is_taken; ++i) is_taken = child.write(bytes.data(), bytes.size());
  EXPECT_FALSE(is_taken);
  EXPECT_EQ(child.finish().exit_code, 4);
}

TEST(Child, AProgramThatClosesItsInputIsWaitedFor) {
  Child child({"sh", "-c", "exec 0<&-; sleep 0.2; exit 5"});
  const std::string bytes(kMoreThanAPipeHolds, 'x');
  EXPECT_FALSE(child.write(bytes.data(), bytes.size()));
  EXPECT_FALSE(child.write(bytes.data(), bytes.size()));
  EXPECT_EQ(child.finish().exit_code, 5);
}

TEST(Child, StopEndsAWriteThatWaits) {
  std::atomic<int> stop{0};
  Child child(
      {"sh", "-c", "echo ready; exec sleep 600"}, [&](const std::string&) { stop = 1; }, &stop);
  const std::string bytes(kMoreThanAPipeHolds, 'x');
  EXPECT_FALSE(child.write(bytes.data(), bytes.size()));
  EXPECT_EQ(child.finish().signal, SIGTERM);
}

TEST(Child, WithoutFinishTheProgramIsKilled) {
  pid_t pid = 0;
  {
    std::atomic<int> none{0};
    Child child(
        {"sh", "-c", "echo $$; exec sleep 600"}, [&](const std::string& line) { pid = std::stoi(line); }, &none);
    while (pid == 0) child.write("x", 1);
  }
  EXPECT_EQ(kill(pid, 0), -1);
}

TEST(Child, TheProgramEndsIfThisOneIsKilled) {
  const test::TempDir folder;
  const std::string fifo = (folder / "fifo").string();
  ASSERT_EQ(mkfifo(fifo.c_str(), 0600), 0);
  const pid_t killed = fork();
  if (killed == 0) {
    const Child child({"sh", "-c", "exec sleep 600 > " + fifo}, [](const std::string&) {});
    for (;;) pause();
  }
  const int file = open(fifo.c_str(), O_RDONLY);  // returns when the program has opened it
  ASSERT_GE(file, 0);
  kill(killed, SIGKILL);
  EXPECT_EQ(waitpid(killed, nullptr, 0), killed);
  char byte = 0;
  EXPECT_EQ(read(file, &byte, 1), 0) << "at the end of the program";
  close(file);
}

}  // namespace
}  // namespace b3dgs
