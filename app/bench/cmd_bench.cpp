// b3dgs bench: times the blending kernels and the passes of one view, on the device that --device selects.
#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "app/bench/bench_view.h"
#include "app/tools/commands.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "train/device.h"

namespace b3dgs {
namespace {

/// A mistyped subcommand or built-in scene would be taken for a folder. @throws InputError
void check_scene(const std::string& scene) {
  static const std::vector<std::string> kNames{"street", "spread", "kernels", "step", "sweep", "exchange"};
  if (std::find(kNames.begin(), kNames.end(), scene) != kNames.end() || std::filesystem::exists(scene)) return;
  const std::string nearest = nearest_name(scene, kNames);
  input_error("neither a scene nor a subcommand of bench: ", scene,
              nearest.empty() ? " (expected a COLMAP or model folder, street, spread, step, sweep or exchange)"
                              : "; did you mean " + nearest + "?");
}

int run_bench_kernels(const std::vector<std::string>& words) {
  BenchConfig config;
  CommandLine line(
      "bench",
      "Time the kernels and the rendering passes on one view. `b3dgs bench step` times training steps by stage, `b3dgs "
      "bench sweep` times the forward kernels for various numbers and distributions of Gaussians, `b3dgs bench "
      "exchange` what several processes exchange.",
      "b3dgs bench street");
  line.add(config, "Benchmark", {"scene"});
  if (!line.parse(words)) return 0;
  if (config.scene == "balanced") {  // its former name
    std::fprintf(stderr, "the scene balanced is now spread\n");
    config.scene = "spread";
  }
  check_scene(config.scene);
  resolve_auto(config);
  set_compute_threads(config.threads);

  const BenchScene scene = make_bench_scene(config);
  std::printf("%s: %lld Gaussians, %d x %d px, tiles of %d x %d px\n", scene.name.c_str(),
              static_cast<long long>(scene.cloud.size()), scene.view.width, scene.view.height, config.tile_width,
              config.tile_height);
  BenchFile file(config.json);
  file.set("config", config_to_json(config));
  file.set("n_gaussians", scene.cloud.size());
  bench_kernels(config, scene, file);
  return 0;
}

}  // namespace

int run_bench(const std::vector<std::string>& words) {
  std::setvbuf(stdout, nullptr, _IOLBF, BUFSIZ);  // shows each row immediately, even through a pipe
  const std::string what = words.empty() ? "" : words.front();
  const auto rest = [&] { return std::vector<std::string>(words.begin() + 1, words.end()); };
  if (what == "sweep") return run_bench_sweep(rest());
  if (what == "step") return run_bench_step(rest());
  if (what == "exchange") return run_bench_exchange(rest());
  return run_bench_kernels(what == "kernels" ? rest() : words);
}

}  // namespace b3dgs
