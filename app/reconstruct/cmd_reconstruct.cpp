// b3dgs reconstruct: makes a scene from photographs or a video, using COLMAP.
#include <atomic>
#include <iostream>

#include "app/common/commands.h"
#include "app/common/single_option.h"
#include "app/common/status_line.h"
#include "app/reconstruct/reconstruct.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/stop_signals.h"
#include "core/text.h"

namespace b3dgs {
namespace {

std::atomic<int> stop_signal{0};

extern "C" void stop_reconstruction(int signal) {
  stop_signal = signal;
}

void report_reconstruction(const ReconstructResult& result, const std::string& scene) {
  std::cout << scene << ": " << result.n_registered << " of " << result.n_photographs << " photographs registered, "
            << format_count(static_cast<std::int64_t>(result.n_points)) << " points, mean reprojection error "
            << print_to_string("%.2f px", result.mean_error) << "\n";
  if (result.n_models > 1) {
    std::cout << "COLMAP made " << result.n_models << " models that it could not join; sparse/0 is the largest\n";
  }
  if (result.georeference) {
    std::cout << "in metres, z up: " << result.georeference->describe_fit() << "; origin "
              << result.georeference->describe_origin() << "\n";
  }
  std::cout << "next: b3dgs train " << shell_quote(scene) << " -m MODEL --eval\n";
}

}  // namespace

int run_reconstruct(const std::vector<std::string>& words) {
  CommandLine line("reconstruct",
                   "Make a scene from photographs or a video: runs COLMAP, and ffmpeg for videos. Call it again to go "
                   "on after an interruption.",
                   "b3dgs reconstruct photos/garden scenes/garden");
  ReconstructOptions options;
  SingleOption<bool> quiet{Option{"quiet"}.common(), false, "show no progress"};
  line.add(options, "Reconstruct", {"input", "output"});
  line.add(quiet, "Run");
  if (!line.parse(words)) return 0;
  if (options.input.empty() || options.output.empty()) {
    input_error("missing argument: ", options.input.empty() ? "INPUT" : "OUTPUT",
                "; usage: b3dgs reconstruct PHOTOS|VIDEO SCENE");
  }
  // COLMAP's programs link Qt, which otherwise needs a display.
  setenv("QT_QPA_PLATFORM", "offscreen", /*overwrite=*/0);
  handle_stop_signals(stop_reconstruction);

  StatusLine status = StatusLine::for_stderr(quiet.value);
  const ReconstructResult result =
      reconstruct(options, show_loading(status), &stop_signal, [&](const std::string& line) { status.warn(line); });
  status.clear();
  if (result.is_stopped) {
    status.print("stopped; give the same command again to go on");
    return 128 + stop_signal;
  }
  report_reconstruction(result, options.output);
  return 0;
}

}  // namespace b3dgs
