// b3dgs bench scaling: predicts how training would scale over GPUs and hosts (scaling_model.h).
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include "app/tools/commands.h"
#include "app/tools/scaling_model.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/json_text.h"
#include "core/options/command_line.h"
#include "core/text.h"

namespace b3dgs {
namespace {

struct ScalingConfig {
  std::vector<int> gpus{1, 2, 4, 8, 16, 32};
  int gpus_per_host = 8, batch = 0;
  // Two H200 of one host, docs/distributed.md.
  double gb_per_s = 273, latency_ms = 0.042, record_ms = 0.029, overhead_ms = 0.58, band_overhead_ms = 0.49;
  double pack_ns = 0.4, busiest = 1.05;
  double network_gb_per_s = 12.5, network_latency_ms = 0.05;
  std::string exchange, json;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, ScalingConfig>> visit_fields(Config& c, Visitor&& field) {
  field(Option{"gpus"}, c.gpus, InRange{1, 1024}, "numbers of GPUs; a line for each value and scene");
  field(Option{"gpus_per_host"}, c.gpus_per_host, InRange{1, 1024}, "GPUs of a host; more GPUs are on several hosts");
  field(Option{"batch"}, c.batch, InRange{0, 1024},
        "views in a step: a multiple or divisor of the GPUs; fewer: bands (0 = one per GPU)");
  field(Option{"exchange"}, c.exchange, Any{},
        "take bandwidth, latency and record from this file of bench exchange --json");
  field(Option{"gb_per_s"}, c.gb_per_s, Above{0}, "what a GPU receives from others of its host, GB/s");
  field(Option{"latency_ms"}, c.latency_ms, AtLeast{0}, "of an all-to-all within a host");
  field(Option{"record_ms"}, c.record_ms, AtLeast{0}, "a record of a few numbers of every rank");
  field(Option{"network_gb_per_s"}, c.network_gb_per_s, Above{0},
        "what a host receives from other hosts, GB/s (12.5 = 100 Gbit/s)");
  field(Option{"network_latency_ms"}, c.network_latency_ms, AtLeast{0}, "of an all-to-all between hosts");
  field(Option{"overhead_ms"}, c.overhead_ms, AtLeast{0}, "waits of the host, and density control, in a step");
  field(Option{"band_overhead_ms"}, c.band_overhead_ms, AtLeast{0}, "added to that in a step with bands");
  field(Option{"pack_ns"}, c.pack_ns, AtLeast{0}, "to pack and merge a splat that a GPU draws, and its gradients");
  field(Option{"busiest"}, c.busiest, AtLeast{1}, "work of the busiest rank, as a multiple of the mean");
  field(Option{"json"}, c.json, Any{}, "also write all numbers to this file");
}

nlohmann::ordered_json read_json(const std::string& path) {
  std::ifstream file(path);
  if (!file) input_error(path, ": cannot be read");
  nlohmann::ordered_json json = parse_json(file);
  if (json.is_discarded()) input_error(path, ": not valid JSON");
  return json;
}

nlohmann::ordered_json to_json(const SceneCost& scene, const Prediction& p) {
  return {{"scene", scene.name},
          {"gpus", p.n_gpus},
          {"hosts", p.n_hosts},
          {"batch", p.batch},
          {"work_ms", p.work_ms},
          {"exchange_ms", p.exchange_ms},
          {"overhead_ms", p.overhead_ms},
          {"step_ms", p.step_ms()},
          {"views_per_s", p.views_per_s()},
          {"speedup", p.speedup},
          {"sent_bytes", p.exchange_bytes},
          {"model_bytes", p.model_bytes},
          {"prediction", true}};
}

}  // namespace

int run_bench_scaling(const std::vector<std::string>& words) {
  CommandLine line("bench scaling",
                   "Predict how training would scale over GPUs and hosts. Nothing is measured: docs/distributed.md "
                   "has the formulas, and says where the default figures come from.",
                   "b3dgs bench scaling --exchange exchange.json");
  ScalingConfig config;
  line.add(config, "Prediction");
  if (!line.parse(words)) return 0;
  line.apply(config);
  if (config.gpus.empty()) input_error("--gpus needs at least one value");
  for (const int n_gpus : config.gpus) {
    if (config.batch == 0 || config.batch % n_gpus == 0 || n_gpus % config.batch == 0) continue;
    input_error("--batch ", config.batch, ": expected a multiple or a divisor of the number of GPUs, ", n_gpus,
                "; name other numbers with --gpus");
  }
  ClusterCost cluster{{config.latency_ms, 1e6 * config.gb_per_s},
                      {config.network_latency_ms, 1e6 * config.network_gb_per_s},
                      config.record_ms,
                      config.overhead_ms,
                      config.band_overhead_ms,
                      config.pack_ns,
                      config.busiest};
  if (!config.exchange.empty()) read_exchange(read_json(config.exchange), config.exchange, cluster);

  std::printf("in a host %.3g GB/s, %.3g ms; between hosts %.3g GB/s, %.3g ms; record %.3g ms; overhead %.3g ms\n",
              1e-6 * cluster.in_host.bytes_per_ms, cluster.in_host.latency_ms, 1e-6 * cluster.network.bytes_per_ms,
              cluster.network.latency_ms, cluster.record_ms, cluster.overhead_ms);
  std::printf("%-8s %5s %6s %6s %9s %12s %9s %8s %8s %13s\n", "scene", "GPUs", "hosts", "views", "work ms",
              "exchange ms", "step ms", "views/s", "speed-up", "model per GPU");
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (const SceneCost& scene : standard_scenes()) {
    for (const int n_gpus : config.gpus) {
      const Prediction p =
          predict(scene, cluster, n_gpus, config.gpus_per_host, config.batch > 0 ? config.batch : n_gpus);
      std::printf("%-8s %5d %6d %6d %9.2f %12.2f %9.2f %8.0f %8.2f %13s  prediction\n", scene.name.c_str(), p.n_gpus,
                  p.n_hosts, p.batch, p.work_ms, p.exchange_ms, p.step_ms(), p.views_per_s(), p.speedup,
                  format_bytes(static_cast<std::int64_t>(p.model_bytes)).c_str());
      rows.push_back(to_json(scene, p));
    }
  }
  if (!config.json.empty()) write_file(config.json, nlohmann::ordered_json{{"rows", rows}}.dump(2) + "\n");
  return 0;
}

}  // namespace b3dgs
