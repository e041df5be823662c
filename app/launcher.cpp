// b3dgs: prints the general help and the version by itself. For everything else it executes another program from its
// own folder: b3dgs-engine, which loads LibTorch for 0.4 s or more, or b3dgs-tools for the commands that do not need
// it. First, it sets how OpenMP threads wait, because OpenMP's runtime reads that setting while it is loaded.
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "app/tools/commands.h"
#include "core/version.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

enum ExitCode { kDone = 0, kFailed = 1, kBadInput = 2 };

std::string general_help() {
  std::string text = std::string("Balanced3DGS ") + version() +
                     ": 3D Gaussian Splatting\n\n"
                     "Usage: b3dgs COMMAND [OPTIONS]\n\nCommands:\n";
  for (const CommandName& command : kCommandNames) {
    text += "  " + std::string(command.name) + std::string(13 - std::strlen(command.name), ' ') + command.help + "\n";
  }
  return text + "\nb3dgs COMMAND --help shows how to use a command; b3dgs --version prints the version.\n";
}

ExitCode fail(const std::string& message, ExitCode code) {
  std::cerr << "error: " + message + '\n';  // one write, so that lines of several ranks on one terminal do not mix
  return code;
}

ExitCode answer(const std::string& text) {
  std::cout << text << std::flush;
  return std::cout ? kDone : fail("cannot write to standard output", kBadInput);
}

/// By default OpenMP threads that wait for work keep a core busy, which slows down other trainings on the machine.
void let_waiting_threads_sleep() {
  if (std::getenv("GOMP_SPINCOUNT") == nullptr) setenv("OMP_WAIT_POLICY", "passive", /*overwrite=*/0);
}

/// Returns the program that has the command. b3dgs-tools also rejects unknown commands.
const char* program_of(const std::string& command) {
  if (command == "help-markdown") return "b3dgs-engine";  // for scripts/update_options.sh: options of all commands
  for (const CommandName& row : kCommandNames) {
    if (command == row.name) return row.needs_torch ? "b3dgs-engine" : "b3dgs-tools";
  }
  return "b3dgs-tools";
}

ExitCode run_command(char* const* argv) {
  std::error_code error;
  let_waiting_threads_sleep();
  const fs::path program = fs::read_symlink("/proc/self/exe", error).parent_path() / program_of(argv[1]);
  execv(program.c_str(), argv);
  return fail(
      "cannot start " + program.string() + " (" + std::strerror(errno) + "); build or copy it together with b3dgs",
      kFailed);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  using namespace b3dgs;
  if (argc < 2) {
    std::cerr << general_help();
    return kBadInput;
  }
  const std::string word = argv[1];
  if (word == "help" && argc > 2) {  // b3dgs help train -> b3dgs train --help
    std::vector<char*> words(argv + 2, argv + argc);
    words.insert(words.begin(), argv[0]);
    char option[] = "--help";
    words.push_back(option);
    words.push_back(nullptr);
    return run_command(words.data());
  }
  if (word == "--help" || word == "-h" || word == "help") return answer(general_help());
  if (word == "--version") return answer(std::string("b3dgs ") + version() + "\n");
  return run_command(argv);
}
