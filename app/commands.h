// The subcommands. Each reads its words (those after its name), builds objects, calls one library function and reports:
// results to standard output, progress and warnings to standard error. Faults are thrown; main() turns them into a line
// and an exit code.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

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
