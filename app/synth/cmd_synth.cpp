// b3dgs synth: writes a synthetic COLMAP scene.
#include <iostream>

#include "app/common/commands.h"
#include "app/common/status_line.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "data_synth/synth_writer.h"

namespace b3dgs {
namespace {

struct SynthCommandOptions {
  bool overwrite = false;
  bool quiet = false;
};

template <class Visitor>
void visit_fields(SynthCommandOptions& c, Visitor&& field) {
  field(Option{"overwrite"}, c.overwrite, Any{}, "replace an existing synthetic scene in the output folder");
  field(Option{"quiet"}, c.quiet, Any{}, "show no progress");
}

}  // namespace

int run_synth(const std::vector<std::string>& words) {
  CommandLine line("synth", "Write a synthetic scene as a COLMAP folder.", "b3dgs synth orbit scenes/orbit");
  SynthConfig config;
  SynthCommandOptions options;
  line.add(config, "Scene", {"scene", "output"});
  line.add(options, "Run");
  if (!line.parse(words)) return 0;
  for (const char* option : {"sh_degree", "skew", "truth"}) {
    const std::string scene = std::string(option) == "sh_degree" ? "orbit" : "street";
    if (line.was_given(option) && config.scene != scene) {
      input_error("--", option, " has no effect on ", config.scene, "; it is an option of ", scene);
    }
  }
  if (config.output.empty()) input_error("missing argument: OUTPUT; usage: b3dgs synth ", config.scene, " OUTPUT");
  if (holds_synth_scene(config.output) && !options.overwrite) {
    input_error("output folder already holds a synthetic scene: ", config.output,
                "; replace it with --overwrite, or choose another folder");
  }
  config = with_scene_defaults(config);

  StatusLine status = StatusLine::for_stderr(options.quiet);
  const ProgressFn progress = show_loading(status);
  const SynthScene scene = make_scene(config);
  write_synth_scene(config, scene,
                    [&](std::size_t done, std::size_t total) { progress("rendering images", done, total); });
  status.clear();
  std::cout << config.output << ": " << config.scene << ", " << config.views << " images of " << config.width << " x "
            << config.height << " px, " << format_count(scene.points.size()) << " points of "
            << format_count(scene.truth.size()) << " Gaussians (truth.ply), seed " << config.seed << "\n";
  return 0;
}

}  // namespace b3dgs
