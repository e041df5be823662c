// b3dgs bench: times the blending kernels and the passes of one view, on the scene and the machine at hand.
#include <cstdio>

#include "app/bench_devices.h"
#include "app/cli.h"
#include "app/commands.h"
#include "check.h"
#include "parallel.h"
#include "scene/atomic_file.h"

namespace b3dgs {

int run_bench(const std::vector<std::string>& words) {
  if (!words.empty() && words.front() == "step") return run_bench_step({words.begin() + 1, words.end()});
  BenchConfig config;
  CommandLine line("bench",
                   "Times the blending kernels and the passes of one view: b3dgs bench [street|balanced|SCENE].");
  line.add(config, "Benchmark", {"scene"});
  if (!line.parse(words)) return 0;
  line.apply(config);
  set_thread_count(config.threads);

  const BenchScene scene = make_bench_scene(config);
  std::printf("%s: %lld Gaussians, %d x %d px, tiles of %d x %d px\n", scene.name.c_str(),
              static_cast<long long>(scene.cloud.size()), scene.view.width, scene.view.height, config.tile_width,
              config.tile_height);
  nlohmann::ordered_json report;
  if (config.device == "cpu") {
    report = bench_cpu(config, scene);
  } else {
#if B3DGS_HAS_CUDA
    report = bench_cuda(config, scene);
#else
    input_error("--device cuda: this build has no CUDA kernels; use --device cpu");
#endif
  }
  report["config"] = config_to_json(config);
  report["n_gaussians"] = scene.cloud.size();
  if (!config.json.empty()) write_file(config.json, report.dump(2) + "\n");
  return 0;
}

}  // namespace b3dgs
