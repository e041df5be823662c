#include "app/common/commands.h"

#include <algorithm>
#include <csignal>
#include <cstring>
#include <exception>
#include <filesystem>
#include <iostream>
#include <new>

#include "core/check.h"
#include "core/options/command_line.h"
#include "core/stop_signals.h"
#include "core/text.h"
#include "dist/control/message.h"

namespace b3dgs {
namespace {

int report_error(const std::string& message, int code) {
  std::cerr << "error: " + detail::one_line(first_line(message)) +
                   '\n';  // one write, so that lines of several ranks on one terminal do not mix
  return code;
}

int report_out_of_memory(const std::string& what) {
  return report_error(first_line(what) +
                          "; use smaller images (-r 2), limit the Gaussians (--max_gaussians), "
                          "or free memory and resume from the last checkpoint (--resume auto)",
                      kFailed);
}

/// @throws InputError that names a similar command, or all commands
[[noreturn]] void reject_command(const std::string& word) {
  std::vector<std::string> names;
  for (const CommandName& command : kCommandNames) names.emplace_back(command.name);
  const std::string script = word.substr(0, word.find(".py"));  // scripts of the original 3DGS: train.py, full_eval.py
  const std::string nearest = script == "metrics"   ? "eval"
                              : script == "convert" ? "reconstruct"
                                                    : nearest_name(script, names);
  input_error("unknown command \"", word, "\"; ",
              nearest.empty() ? "expected one of " + list_text(names) : "did you mean " + nearest + "?");
}

}  // namespace

int run_program(int argc, char** argv, const std::vector<Command>& commands) {
  end_by_stop_signals();
  std::signal(SIGXFSZ, SIG_IGN);  // with ulimit -f, writing then fails with an error that names the file
  try {
    const std::string name = argc > 1 ? argv[1] : "";
    const auto found =
        std::find_if(commands.begin(), commands.end(), [&](const Command& command) { return name == command.name; });
    if (found == commands.end()) reject_command(name);
    const int code = found->run({argv + 2, argv + argc});
    std::cout.flush();
    if (!std::cout) io_error("cannot write to standard output");
    return code;
  } catch (const InputError& error) {
    return report_error(error.what(), kBadInput);
  } catch (const IoError& error) {
    return report_error(error.what(), kBadInput);
  } catch (const std::filesystem::filesystem_error& error) {  // such as a path that is too long
    return report_error(error.what(), kBadInput);
  } catch (const OutOfMemoryError& error) {
    return report_out_of_memory(error.what());
  } catch (const PeerError& error) {
    return report_error(error.what(), PeerError::kExitCode);
  } catch (const std::bad_alloc&) {
    return report_out_of_memory("out of memory");
  } catch (const std::exception& error) {
    // LibTorch's messages if GPU memory or host memory is exhausted.
    if (std::strstr(error.what(), "CUDA out of memory") != nullptr) return report_out_of_memory("out of GPU memory");
    if (std::strstr(error.what(), "allocate memory") != nullptr) return report_out_of_memory("out of memory");
    return report_error(error.what(), kFailed);
  }
}

}  // namespace b3dgs
