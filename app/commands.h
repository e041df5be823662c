// The subcommands. Each reads its words (those after its name), builds objects, calls one library function and reports:
// results to standard output, progress and warnings to standard error. Faults are thrown; main() turns them into a line
// and an exit code.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

struct CommandName {
  const char* name;
  const char* help;
};

inline constexpr CommandName kCommandNames[] = {
    {"train", "train a COLMAP scene"},
    {"eval", "measure a trained model on its photographs: PSNR, SSIM"},
    {"render", "render colour, depth and alpha images of a model"},
    {"info", "say what a scene folder, a PLY or a checkpoint holds"},
    {"synth", "write a synthetic COLMAP scene"},
    {"compare", "train a scene with several configurations and compare time and quality"},
    {"report", "write report.html of a training or a comparison again"},
    {"bench", "time the rasterizer's kernels and passes"},
};

/// Exit code of a command that did what it was asked: 0, or 128 + signal for a training or comparison that was stopped.
int run_train(const std::vector<std::string>& words);
int run_eval(const std::vector<std::string>& words);
int run_render(const std::vector<std::string>& words);
int run_info(const std::vector<std::string>& words);
int run_synth(const std::vector<std::string>& words);
int run_compare(const std::vector<std::string>& words);
int run_report(const std::vector<std::string>& words);
int run_bench(const std::vector<std::string>& words);
int run_bench_sweep(const std::vector<std::string>& words);  // what `bench sweep` does
int run_bench_step(const std::vector<std::string>& words);   // what `bench step` does

}  // namespace b3dgs
