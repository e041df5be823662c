// b3dgs: prints the general help and the version by itself, since LibTorch takes 0.4 s to load. For everything else it
// executes b3dgs-engine from its own folder, after setting how OpenMP threads wait: LibTorch's OpenMP runtime reads
// that setting while it is loaded.
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "app/commands.h"
#include "core/version.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

enum ExitCode { kDone = 0, kFailed = 1, kBadInput = 2 };

std::string general_help() {
  std::string text = std::string("Balanced3DGS ") + version() +
                     ": 3D Gaussian Splatting from COLMAP scenes\n\n"
                     "Usage: b3dgs COMMAND [OPTIONS]\n\nCommands:\n";
  for (const CommandName& command : kCommandNames) {
    text += "  " + std::string(command.name) + std::string(9 - std::strlen(command.name), ' ') + command.help + "\n";
  }
  return text + "\nb3dgs COMMAND --help shows how to use a command; b3dgs --version prints the version.\n";
}

ExitCode fail(const std::string& message, ExitCode code) {
  std::cerr << "error: " << message << '\n';
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

ExitCode run_engine(char* const* argv) {
  std::error_code error;
  let_waiting_threads_sleep();
  const fs::path engine = fs::read_symlink("/proc/self/exe", error).parent_path() / "b3dgs-engine";
  execv(engine.c_str(), argv);
  return fail(
      "cannot start " + engine.string() + " (" + std::strerror(errno) + "); build or copy it together with b3dgs",
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
    return run_engine(words.data());
  }
  if (word == "--help" || word == "-h" || word == "help") return answer(general_help());
  if (word == "--version") return answer(std::string("b3dgs ") + version() + "\n");
  return run_engine(argv);
}
