// b3dgs: answers for itself what needs no LibTorch, which takes 0.4 s to load, and else becomes b3dgs-engine, which
// lies beside it. Before that it says how OpenMP's threads wait, for which it is too late once LibTorch is loaded.
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <string>

#include "app/commands.h"
#include "core/version.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

enum ExitCode { kDone = 0, kFailed = 1, kAskedWrongly = 2 };

std::string general_help() {
  std::string text = std::string("Balanced3DGS ") + version() +
                     ": 3D Gaussian Splatting from COLMAP scenes\n\n"
                     "Usage: b3dgs COMMAND [OPTIONS]\n\nCommands:\n";
  for (const CommandName& command : kCommandNames) {
    text += "  " + std::string(command.name) + std::string(9 - std::strlen(command.name), ' ') + command.help + "\n";
  }
  return text + "\nb3dgs COMMAND --help lists the options of a command; b3dgs --version prints the version.\n";
}

ExitCode fail(const std::string& message, ExitCode code) {
  std::cerr << "b3dgs: error: " << message << '\n';
  return code;
}

ExitCode answer(const std::string& text) {
  std::cout << text << std::flush;
  return std::cout ? kDone : fail("standard output: cannot be written to", kAskedWrongly);
}

/// Threads that wait for work keep a core busy by default, which several trainings on one machine take from each other.
void make_threads_sleep_while_they_wait() {
  if (std::getenv("GOMP_SPINCOUNT") == nullptr) setenv("OMP_WAIT_POLICY", "passive", /*overwrite=*/0);
}

ExitCode become_engine(char** argv) {
  std::error_code error;
  const fs::path engine = fs::read_symlink("/proc/self/exe", error).parent_path() / "b3dgs-engine";
  execv(engine.c_str(), argv);
  return fail(engine.string() + ": cannot be started (" + std::strerror(errno) +
                  "); it belongs beside b3dgs, build or copy both",
              kFailed);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  using namespace b3dgs;
  if (argc < 2) {
    std::cerr << general_help();
    return kAskedWrongly;
  }
  const std::string word = argv[1];
  if (word == "--help" || word == "-h" || word == "help") return answer(general_help());
  if (word == "--version") return answer(std::string("b3dgs ") + version() + "\n");
  make_threads_sleep_while_they_wait();
  return become_engine(argv);
}
