// b3dgs-tools, which launcher.cpp starts for the commands that need no LibTorch.
#include "app/tools/commands.h"
#include "app/tools/run_program.h"

int main(int argc, char** argv) {
  using namespace b3dgs;
  return run_program(argc, argv, [](const std::vector<std::string>& words) {
    const std::string name = words.empty() ? "" : words[0];
    const std::vector<std::string> rest(words.begin() + (words.empty() ? 0 : 1), words.end());
    if (name == "reconstruct") return run_reconstruct(rest);
    if (name == "info") return run_info(rest);
    if (name == "synth") return run_synth(rest);
    if (name == "report") return run_report(rest);
    reject_command(name);
  });
}
