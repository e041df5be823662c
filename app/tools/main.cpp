// b3dgs-tools, which launcher.cpp starts for the commands that need no LibTorch.
#include "app/tools/commands.h"

int main(int argc, char** argv) {
  using namespace b3dgs;
  return run_program(
      argc, argv, {{"reconstruct", run_reconstruct}, {"info", run_info}, {"synth", run_synth}, {"report", run_report}});
}
