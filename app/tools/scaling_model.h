// What training on several GPUs would take: predicted from measured times, by formulas in the open.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace b3dgs {

/// One step with one view on one GPU, ms by the stages that several GPUs divide differently.
struct SceneCost {
  std::string name;
  double n_gaussians = 0;
  double n_seen = 0;       // splats of a view
  double project_ms = 0;   // all Gaussians of one view
  double draw_ms = 0;      // binning, blending, loss and backward blend of one view
  double optimize_ms = 0;  // backward projection and Adam, all Gaussians
  /// A view on one GPU, in steps of `batch` views.
  double alone_ms(int batch) const { return project_ms + draw_ms + optimize_ms / batch; }
};

/// bonsai as measured (docs/benchmarks.md), and a scene of 100 million Gaussians and 4K photographs, whose costs are
/// those of bonsai times the ratio of Gaussians, of splats, and of pixels.
std::vector<SceneCost> standard_scenes();

/// A link between GPUs: an exchange of b bytes takes latency_ms + b / bytes_per_ms.
struct Link {
  double latency_ms = 0, bytes_per_ms = 0;
};

struct ClusterCost {
  Link in_host;            // of each GPU, to all others of its host together
  Link network;            // of a host, to all other hosts together
  double record_ms = 0;    // a small record of every rank, within a host
  double overhead_ms = 0;  // packing, sorting and waits of the host in a step, besides the exchanges
  double busiest = 1;      // list entries of the busiest rank, as a multiple of the mean
};

struct Prediction {
  int n_gpus = 1, n_hosts = 1;
  double work_ms = 0, exchange_ms = 0, overhead_ms = 0;  // of a step with one view for each GPU
  double step_ms() const { return work_ms + exchange_ms + overhead_ms; }
  double speedup = 1;        // views per second, as a multiple of one GPU with as many views in a step
  double exchange_bytes = 0; // that each GPU sends in a step
  double model_bytes = 0;    // of parameters, moments, gradients and statistics, on each GPU
};

/// A step of G views on G GPUs, in hosts of at most gpus_per_host.
///
///   work     = project + draw x busiest + optimize / G. Each GPU projects N / G Gaussians for G views.
///   exchange = record + splats + gradients. Of each view's n_seen splats, each GPU has n_seen / G, and sends those of
///              the G - 1 views that others draw: 60 bytes a splat forward, 48 back. Within a host and between hosts
///              at the same time; the slower one counts. GPUs of a host share its network.
///   speedup  = G x (project + draw + optimize / G) / (work + exchange + overhead)
Prediction predict(const SceneCost& scene, const ClusterCost& cluster, int n_gpus, int gpus_per_host);

/// Link and record from the file that `b3dgs bench exchange --json` writes: least squares over its all-to-all rows.
/// `cluster` keeps its other members. @throws InputError naming `place` if rows are missing or damaged
void read_exchange(const nlohmann::ordered_json& file, const std::string& place, ClusterCost& cluster);

}  // namespace b3dgs
