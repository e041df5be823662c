// b3dgs-tools, started by launcher.cpp for the commands that do not need LibTorch.
#include "app/tools/commands.h"

int main(int argc, char** argv) {
  using namespace b3dgs;
  return run_program(
      argc, argv, {{"reconstruct", run_reconstruct}, {"info", run_info}, {"synth", run_synth}, {"report", run_report}});
}
