// The program b3dgs. LibTorch takes 0.4 s or more to load, so only the commands that use it load it, with the library
// libb3dgs-engine.so.
#include <dlfcn.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <string>
#include <vector>

#include "app/common/commands.h"
#include "core/version.h"

namespace b3dgs {
namespace {

/// The commands that this program links. The others are in the engine.
const std::vector<Command> kLightCommands{
#define B3DGS_LIGHT(name, help) {#name, run_##name},
#define B3DGS_TORCH(name, help)
    B3DGS_COMMANDS(B3DGS_LIGHT, B3DGS_TORCH)
#undef B3DGS_LIGHT
#undef B3DGS_TORCH
};

std::string general_help() {
  std::string text = std::string("Balanced3DGS ") + version() +
                     ": 3D Gaussian Splatting\n\n"
                     "Usage: b3dgs COMMAND [OPTIONS]\n\nCommands:\n";
  for (const CommandName& command : kCommandNames) {
    text += "  " + std::string(command.name) + std::string(13 - std::strlen(command.name), ' ') + command.help + "\n";
  }
  return text + "\nb3dgs COMMAND --help shows how to use a command; b3dgs --version prints the version.\n";
}

int fail(const std::string& message, int code) {
  std::cerr << "error: " + message + '\n';  // one write, so that lines of several ranks on one terminal do not mix
  return code;
}

int answer(const std::string& text) {
  std::cout << text << std::flush;
  return std::cout ? kDone : fail("cannot write to standard output", kBadInput);
}

bool needs_engine(const std::string& command) {
  for (const CommandName& row : kCommandNames) {
    if (command == row.name) return row.needs_torch;
  }
  return command == "help-markdown";  // for scripts/update_options.sh: options of all commands
}

/// By default OpenMP threads that wait for work keep a core busy, which slows down other trainings on the machine.
/// OpenMP's runtime reads the setting while it is loaded, so the program starts itself again with it.
void let_waiting_threads_sleep(char* const* argv) {
  if (std::getenv("GOMP_SPINCOUNT") != nullptr || std::getenv("OMP_WAIT_POLICY") != nullptr) return;
  setenv("OMP_WAIT_POLICY", "passive", /*overwrite=*/0);
  std::error_code error;
  execv(std::filesystem::read_symlink("/proc/self/exe", error).c_str(), argv);  // if it fails, threads only wait busily
}

int run_engine(int argc, char** argv) {
  let_waiting_threads_sleep(argv);
  void* const engine = dlopen("libb3dgs-engine.so", RTLD_NOW);
  void* const run = engine == nullptr ? nullptr : dlsym(engine, "b3dgs_engine_main");
  if (run == nullptr) {
    return fail(std::string("cannot load the engine (") + dlerror() + "); build or copy libb3dgs-engine.so with b3dgs",
                kFailed);
  }
  return reinterpret_cast<int (*)(int, char**)>(run)(argc, argv);
}

int run_command(int argc, char** argv) {
  if (needs_engine(argv[1])) return run_engine(argc, argv);
  return run_program(argc, argv, kLightCommands);
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
    char option[] = "--help";
    std::vector<char*> words(argv + 2, argv + argc);
    words.insert(words.begin(), argv[0]);
    words.push_back(option);
    words.push_back(nullptr);
    return run_command(static_cast<int>(words.size()) - 1, words.data());
  }
  if (word == "--help" || word == "-h" || word == "help") return answer(general_help());
  if (word == "--version") return answer(std::string("b3dgs ") + version() + "\n");
  return run_command(argc, argv);
}
