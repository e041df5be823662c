// The subcommands. Each parses the words after its name, calls the libraries and prints results to standard output,
// progress and warnings to standard error. run_program() turns exceptions into a message and an exit code.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

struct CommandName {
  const char* name;
  const char* help;
  bool needs_torch = true;
};

inline constexpr CommandName kCommandNames[] = {
    {"reconstruct", "make a scene from photographs or a video, with COLMAP", false},
    {"train", "train a scene"},
    {"eval", "compute PSNR and SSIM of a trained model"},
    {"render", "render colour, depth and alpha images of a model"},
    {"export", "write a model for viewers and editors: SPZ, SOG, HTML, glTF; measure the loss"},
    {"view", "show a model in a browser"},
    {"info", "describe a scene folder, model folder, PLY or checkpoint", false},
    {"synth", "write a synthetic COLMAP scene", false},
    {"compare", "train a scene with several configurations; compare time and quality"},
    {"report", "rewrite report.html of a training or a comparison", false},
    {"bench", "time kernels, rendering passes and training steps"},
};

/// Exit codes of the program. docs/README.md lists all of them.
enum ExitCode { kDone = 0, kFailed = 1, kBadInput = 2 };

/// Each returns its exit code: 0, or 128 + signal if a signal stopped a training or comparison.
int run_reconstruct(const std::vector<std::string>& words);
int run_train(const std::vector<std::string>& words);
int run_eval(const std::vector<std::string>& words);
int run_render(const std::vector<std::string>& words);
int run_export(const std::vector<std::string>& words);
int run_view(const std::vector<std::string>& words);
int run_info(const std::vector<std::string>& words);
int run_synth(const std::vector<std::string>& words);
int run_compare(const std::vector<std::string>& words);
int run_report(const std::vector<std::string>& words);
int run_bench(const std::vector<std::string>& words);
int run_bench_sweep(const std::vector<std::string>& words);  // b3dgs bench sweep
int run_bench_step(const std::vector<std::string>& words);   // b3dgs bench step
int run_bench_paper(const std::vector<std::string>& words);  // b3dgs bench paper

struct Command {
  const char* name;
  int (*run)(const std::vector<std::string>& words);
};

/// Runs the command named by the first word, with the others as arguments. Returns the exit code of the program.
int run_program(int argc, char** argv, const std::vector<Command>& commands);

}  // namespace b3dgs
