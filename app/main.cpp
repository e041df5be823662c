// b3dgs-engine, which b3dgs starts (launcher.cpp): trains, measures and renders 3D Gaussian Splatting models. The one
// place that catches.
#include <algorithm>
#include <cstring>
#include <exception>
#include <iostream>
#include <iterator>
#include <new>
#include <string>
#include <vector>

#include "app/commands.h"
#include "core/check.h"
#include "core/command_line.h"

namespace b3dgs {
namespace {

using RunCommand = int (*)(const std::vector<std::string>& words);

/// In the order of their names.
constexpr RunCommand kCommands[] = {run_train, run_eval,    run_render, run_info,
                                    run_synth, run_compare, run_report, run_bench};
static_assert(std::size(kCommands) == std::size(kCommandNames));

enum ExitCode { kFailed = 1, kAskedWrongly = 2 };

[[noreturn]] void reject_command(const std::string& word) {
  std::vector<std::string> names;
  std::string list;
  for (const CommandName& command : kCommandNames) {
    names.emplace_back(command.name);
    list += (list.empty() ? "" : ", ") + names.back();
  }
  const std::string nearest = nearest_name(word, names);
  input_error("unknown command \"", word, "\"; ",
              nearest.empty() ? "expected one of " + list : "did you mean " + nearest + "?");
}

int run(const std::vector<std::string>& words) {
  const std::string name = words.empty() ? "" : words[0];
  for (std::size_t i = 0; i < std::size(kCommands); ++i) {
    if (name == kCommandNames[i].name) return kCommands[i]({words.begin() + 1, words.end()});
  }
  reject_command(name);
}

int report(const std::string& message, ExitCode code) {
  std::string line = message.substr(0, message.find('\n'));  // LibTorch appends a stack trace to its messages
  std::cerr << "b3dgs: error: " << line << '\n';
  return code;
}

int report_out_of_memory(const std::string& what) {
  return report(what.substr(0, what.find('\n')) +
                    "; take smaller images (-r 2), limit the Gaussians (--max_gaussians), keep fewer images on the GPU "
                    "(--image_cache_gb 1), or continue from the last checkpoint (--resume auto) with more memory free",
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
  } catch (const OutOfMemoryError& error) {
    return report_out_of_memory(error.what());
  } catch (const std::bad_alloc&) {
    return report_out_of_memory("out of memory");
  } catch (const std::exception& error) {
    // LibTorch's own errors: of a GPU's memory, and a general one that speaks of the host's.
    if (std::strstr(error.what(), "CUDA out of memory") != nullptr) return report_out_of_memory("out of GPU memory");
    if (std::strstr(error.what(), "allocate memory") != nullptr) return report_out_of_memory("out of memory");
    return report(error.what(), kFailed);
  }
}
