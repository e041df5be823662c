// What training on several GPUs would take: predicted from measured times, by formulas in the open.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace b3dgs {

/// Times on one GPU, ms, by the stages that several GPUs divide differently.
struct SceneCost {
  std::string name;
  double n_gaussians = 0;
  double n_seen = 0;       // splats of a view
  double n_pixels = 0;     // of a view
  double project_ms = 0;   // all Gaussians for one view
  double draw_ms = 0;      // binning and blending of one view, forward and backward
  double loss_ms = 0;      // of one view
  double optimize_ms = 0;  // backward projection and Adam of all Gaussians, in a step of one view
  double sum_ms = 0;       // what is added to that in a step of several views, whose gradients are kept and summed

  double learn_ms(int batch) const { return optimize_ms + (batch > 1 ? sum_ms : 0); }
  /// A step of `batch` views.
  double alone_ms(int batch) const { return batch * (project_ms + draw_ms + loss_ms) + learn_ms(batch); }
};

/// bonsai as measured (docs/benchmarks.md), and a scene of 100 million Gaussians and photographs of 2.1 megapixels,
/// whose costs are those of bonsai times the ratio of Gaussians, of splats, and of pixels.
std::vector<SceneCost> standard_scenes();

/// A link between GPUs: an exchange of b bytes takes latency_ms + b / bytes_per_ms.
struct Link {
  double latency_ms = 0, bytes_per_ms = 0;
};

struct ClusterCost {
  Link in_host;                 // of each GPU, to all others of its host together
  Link network;                 // of a host, to all other hosts together
  double record_ms = 0;         // a small record of every rank, within a host
  double overhead_ms = 0;       // waits of the host, and density control, in a step
  double band_overhead_ms = 0;  // added to that in a step whose views are drawn in bands
  double pack_ns = 0;           // to pack and merge a splat that a GPU draws, and its gradients
  double busiest = 1;           // list entries of the busiest rank, as a multiple of the mean
};

struct Prediction {
  int n_gpus = 1, n_hosts = 1, batch = 1;
  double work_ms = 0, exchange_ms = 0, overhead_ms = 0;  // of a step
  double step_ms() const { return work_ms + exchange_ms + overhead_ms; }
  double views_per_s() const { return 1e3 * batch / step_ms(); }
  double speedup = 1;         // against one GPU with as many views in a step
  double exchange_bytes = 0;  // that each GPU sends in a step
  double model_bytes = 0;     // of parameters and Adam moments, on each GPU
};

/// A step of B views on G GPUs, in hosts of at most gpus_per_host. With B < G, each view is drawn in bands by G / B
/// GPUs, each of which computes the loss of the whole view.
///
///   work     = (project + draw x busiest) B / G + loss x (B / G, at least 1) + (optimize + sums, if B > 1) / G
///   exchange = record + splats + gradients + rows of the images, if there are bands. Of each view's n_seen splats,
///              each GPU has n_seen / G, and sends (G - 1) / G of them: 60 bytes a splat forward, 48 back. Of images,
///              each GPU sends its band, 12 bytes a pixel, to the others that draw the view. Within a host and between
///              hosts at the same time; the slower one counts. GPUs of a host share its network.
///   overhead = overhead + band overhead, if there are bands + pack x n_seen B / G
///   speedup  = step of one GPU / (work + exchange + overhead)
/// @param batch  B: a multiple or a divisor of n_gpus
Prediction predict(const SceneCost& scene, const ClusterCost& cluster, int n_gpus, int gpus_per_host, int batch);

/// Link and record from the file that `b3dgs bench exchange --json` writes: least squares over its all-to-all rows.
/// `cluster` keeps its other members. @throws InputError naming `place` if rows are missing or damaged
void read_exchange(const nlohmann::ordered_json& file, const std::string& place, ClusterCost& cluster);

}  // namespace b3dgs
