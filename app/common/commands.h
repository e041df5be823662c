// The subcommands. Each parses the words after its name, calls the libraries and prints results to standard output,
// progress and warnings to standard error. run_program() turns exceptions into a message and an exit code.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

// The commands, in the order of --help: LIGHT(name, one line for the help text) if the command does not need LibTorch,
// and otherwise TORCH(...). run_NAME() runs it.
#define B3DGS_COMMANDS(LIGHT, TORCH)                                                             \
  LIGHT(reconstruct, "make a scene from photographs or a video, with COLMAP")                    \
  LIGHT(georeference, "put a COLMAP scene in metres and upright, by the GPS of its photographs") \
  TORCH(train, "train a scene")                                                                  \
  TORCH(eval, "compute PSNR and SSIM of a trained model")                                        \
  TORCH(render, "render colour, depth and alpha images of a model")                              \
  TORCH(export, "write a model for viewers and editors: SPZ, SOG, HTML, glTF; measure the loss") \
  TORCH(mesh, "make a triangle mesh of a model's surface, and measure how right it is")          \
  TORCH(view, "show a model in a browser")                                                       \
  LIGHT(info, "describe a scene folder, model folder, PLY or checkpoint")                        \
  LIGHT(synth, "write a synthetic COLMAP scene")                                                 \
  TORCH(compare, "train a scene with several configurations; compare time and quality")          \
  LIGHT(report, "rewrite report.html of a training or a comparison")                             \
  TORCH(bench, "time kernels, rendering passes and training steps")

struct CommandName {
  const char* name;
  const char* help;
  bool needs_torch;
};

inline constexpr CommandName kCommandNames[] = {
#define B3DGS_LIGHT(name, help) {#name, help, false},
#define B3DGS_TORCH(name, help) {#name, help, true},
    B3DGS_COMMANDS(B3DGS_LIGHT, B3DGS_TORCH)
#undef B3DGS_LIGHT
#undef B3DGS_TORCH
};

/// Exit codes of the program. docs/README.md lists all of them.
enum ExitCode { kDone = 0, kFailed = 1, kBadInput = 2 };

/// Each returns its exit code: 0, or 128 + signal if a signal stopped a training or comparison.
#define B3DGS_ROW(name, help) int run_##name(const std::vector<std::string>& words);
B3DGS_COMMANDS(B3DGS_ROW, B3DGS_ROW)
#undef B3DGS_ROW
int run_bench_sweep(const std::vector<std::string>& words);     // b3dgs bench sweep
int run_bench_step(const std::vector<std::string>& words);      // b3dgs bench step
int run_bench_forecast(const std::vector<std::string>& words);  // b3dgs bench forecast
int run_bench_paper(const std::vector<std::string>& words);     // b3dgs bench paper

struct Command {
  const char* name;
  int (*run)(const std::vector<std::string>& words);
};

/// Runs the command named by the first word, with the others as arguments. Returns the exit code of the program.
int run_program(int argc, char** argv, const std::vector<Command>& commands);

}  // namespace b3dgs
