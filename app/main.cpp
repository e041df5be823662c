// b3dgs: trains, measures and renders 3D Gaussian Splatting models. The one place that catches.
#include <algorithm>
#include <cstring>
#include <exception>
#include <iostream>
#include <new>
#include <string>
#include <vector>

#include "app/cli.h"
#include "app/commands.h"
#include "check.h"

namespace b3dgs {
namespace {

struct Command {
  const char* name;
  int (*run)(const std::vector<std::string>& words);
  const char* help;
};

constexpr Command kCommands[] = {
    {"train", run_train, "train a COLMAP scene"},
    {"eval", run_eval, "measure a trained model on its photographs: PSNR, SSIM"},
    {"render", run_render, "render colour, depth and alpha images of a model"},
    {"info", run_info, "say what a scene folder, a PLY or a checkpoint holds"},
    {"synth", run_synth, "write a synthetic COLMAP scene"},
    {"compare", run_compare, "train a scene with several configurations and compare time and quality"},
    {"report", run_report, "write report.html of a training or a comparison again"},
    {"bench", run_bench, "time the rasterizer's kernels and passes"},
};

enum ExitCode { kFailed = 1, kAskedWrongly = 2 };

std::string general_help() {
  std::string text = "Balanced3DGS " B3DGS_VERSION
                     ": 3D Gaussian Splatting from COLMAP scenes\n\n"
                     "Usage: b3dgs COMMAND [OPTIONS]\n\nCommands:\n";
  for (const Command& command : kCommands) {
    text += "  " + std::string(command.name) + std::string(9 - std::strlen(command.name), ' ') + command.help + "\n";
  }
  return text + "\nb3dgs COMMAND --help lists the options of a command; b3dgs --version prints the version.\n";
}

[[noreturn]] void reject_command(const std::string& word) {
  std::vector<std::string> names;
  std::string list;
  for (const Command& command : kCommands) {
    names.emplace_back(command.name);
    list += (list.empty() ? "" : ", ") + names.back();
  }
  const std::string nearest = nearest_name(word, names);
  input_error("unknown command \"", word, "\"; ",
              nearest.empty() ? "expected one of " + list : "did you mean " + nearest + "?");
}

int run(const std::vector<std::string>& words) {
  if (words.empty()) {
    std::cerr << general_help();
    return kAskedWrongly;
  }
  if (words[0] == "--help" || words[0] == "-h" || words[0] == "help") {
    std::cout << general_help();
    return 0;
  }
  if (words[0] == "--version") {
    std::cout << "b3dgs " B3DGS_VERSION "\n";
    return 0;
  }
  for (const Command& command : kCommands) {
    if (words[0] == command.name) return command.run({words.begin() + 1, words.end()});
  }
  reject_command(words[0]);
}

int report(const std::string& message, ExitCode code) {
  std::string line = message.substr(0, message.find('\n'));  // LibTorch appends a stack trace to its messages
  std::cerr << "b3dgs: error: " << line << '\n';
  return code;
}

int report_out_of_memory(const char* whose) {
  return report(std::string("out of ") + whose +
                    "memory; take smaller images (-r 2), limit the Gaussians (--max_gaussians), "
                    "keep fewer images on the GPU (--image_cache_gb 1), "
                    "or continue from the last checkpoint (--resume auto) with more memory free",
                kFailed);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  using namespace b3dgs;
  try {
    const int code = run(std::vector<std::string>(argv + 1, argv + std::max(1, argc)));
    std::cout.flush();
    if (!std::cout) io_error("standard output: cannot be written to");
    return code;
  } catch (const InputError& error) {
    return report(error.what(), kAskedWrongly);
  } catch (const IoError& error) {
    return report(error.what(), kAskedWrongly);
  } catch (const OutOfMemoryError&) {
    return report_out_of_memory("GPU ");
  } catch (const std::bad_alloc&) {
    return report_out_of_memory("");
  } catch (const std::exception& error) {
    // LibTorch's own errors: of a GPU's memory, and a general one that speaks of the host's.
    if (std::strstr(error.what(), "CUDA out of memory") != nullptr) return report_out_of_memory("GPU ");
    if (std::strstr(error.what(), "allocate memory") != nullptr) return report_out_of_memory("");
    return report(error.what(), kFailed);
  }
}
