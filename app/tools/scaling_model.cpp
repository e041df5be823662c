#include "app/tools/scaling_model.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr double kSplatBytes = 60, kGradBytes = 48, kPixelBytes = 12;  // src/train/ranks
constexpr double kStateBytes = 708;  // of a Gaussian with SH degree 3: 59 floats, 3 times

std::optional<double> positive(const nlohmann::ordered_json& row, const char* key) {
  const auto it = row.find(key);
  if (it == row.end() || !it->is_number()) return std::nullopt;
  const double value = it->get<double>();
  return std::isfinite(value) && value > 0 ? std::optional(value) : std::nullopt;
}

/// Of `bytes` that each GPU sends to all others, evenly. One direction.
double exchange_ms(const ClusterCost& cluster, double bytes, int n_gpus, int n_here) {
  if (n_gpus == 1) return 0;
  const double part_within = static_cast<double>(n_here - 1) / (n_gpus - 1);
  const double within = cluster.in_host.latency_ms + part_within * bytes / cluster.in_host.bytes_per_ms;
  if (n_here == n_gpus) return within;
  const double between = cluster.network.latency_ms + (1 - part_within) * bytes * n_here / cluster.network.bytes_per_ms;
  return std::max(within, between);
}

}  // namespace

std::vector<SceneCost> standard_scenes() {
  constexpr double kBin = 0.206, kBlend = 0.186 + 0.452;
  const SceneCost bonsai{"bonsai", 928297, 350000, 800 * 533, 0.259, kBin + kBlend, 0.052, 0.133, 0.65};
  constexpr double kGaussians = 100e6, kSeen = 5e6, kPixels = 5;  // pixels as a multiple of bonsai's
  const double n = kGaussians / bonsai.n_gaussians, m = kSeen / bonsai.n_seen;
  const SceneCost large{"large",
                        kGaussians,
                        kSeen,
                        bonsai.n_pixels * kPixels,
                        bonsai.project_ms * n,
                        kBin * m + kBlend * kPixels,
                        bonsai.loss_ms * kPixels,
                        bonsai.optimize_ms * n,
                        bonsai.sum_ms * m};
  return {bonsai, large};
}

Prediction predict(const SceneCost& scene, const ClusterCost& cluster, int n_gpus, int gpus_per_host, int batch) {
  B3DGS_CHECK(n_gpus >= 1 && gpus_per_host >= 1 && batch >= 1 && (batch % n_gpus == 0 || n_gpus % batch == 0), n_gpus,
              " GPUs, ", gpus_per_host, " per host, ", batch, " views");
  Prediction prediction;
  prediction.batch = batch;
  const int n_here = std::min(n_gpus, gpus_per_host);
  prediction.n_gpus = n_gpus;
  prediction.n_hosts = (n_gpus + gpus_per_host - 1) / gpus_per_host;
  prediction.model_bytes = kStateBytes * scene.n_gaussians / n_gpus;
  if (n_gpus == 1) {
    prediction.work_ms = scene.alone_ms(batch);
    return prediction;
  }
  const bool has_bands = batch < n_gpus;
  const double n_views = static_cast<double>(batch) / n_gpus;  // that a GPU draws
  const double n_drawn = n_views * scene.n_seen, n_sent = n_drawn / n_gpus * (n_gpus - 1);
  prediction.work_ms = (scene.project_ms + scene.draw_ms * cluster.busiest) * n_views +
                       scene.loss_ms * std::max(1.0, n_views) + scene.learn_ms(batch) / n_gpus;
  prediction.exchange_bytes = n_sent * (kSplatBytes + kGradBytes);
  prediction.exchange_ms = cluster.record_ms + exchange_ms(cluster, n_sent * kSplatBytes, n_gpus, n_here) +
                           exchange_ms(cluster, n_sent * kGradBytes, n_gpus, n_here);
  if (prediction.n_hosts > 1) prediction.exchange_ms += cluster.network.latency_ms;  // the record
  prediction.overhead_ms = cluster.overhead_ms + 1e-6 * cluster.pack_ns * n_drawn;
  if (has_bands) {
    // The 1 / n_views GPUs of a view are neighbours: hosts exchange rows if a host has fewer GPUs than that.
    const int n_of_view = std::max(2, static_cast<int>(1 / n_views));
    const double row_bytes = kPixelBytes * scene.n_pixels * n_views * (n_of_view - 1);
    prediction.exchange_bytes += row_bytes;
    prediction.exchange_ms += exchange_ms(cluster, row_bytes, n_of_view, std::min(n_of_view, n_here));
    prediction.overhead_ms += cluster.band_overhead_ms;
  }
  prediction.speedup = scene.alone_ms(batch) / prediction.step_ms();
  return prediction;
}

void read_exchange(const nlohmann::ordered_json& file, const std::string& place, ClusterCost& cluster) {
  constexpr const char* kExpected = " (expected the file that b3dgs bench exchange --json writes)";
  const auto rows = file.is_object() ? file.find("rows") : file.end();
  if (!file.is_object() || rows == file.end() || !rows->is_array()) input_error(place, ": no rows", kExpected);
  double n = 0, sum_x = 0, sum_y = 0, sum_xx = 0, sum_xy = 0;
  std::optional<double> record_ms;
  for (const auto& row : *rows) {
    if (!row.is_object()) continue;
    const std::string name = row.value("exchange", nlohmann::ordered_json()).is_string() ? row["exchange"] : "";
    const std::optional<double> ms = positive(row, "median_ms"), bytes = positive(row, "received_bytes");
    if (name == "record" && ms) record_ms = ms;
    if (name != "all-to-all" || !ms || !bytes) continue;
    ++n;
    sum_x += *bytes;
    sum_y += *ms;
    sum_xx += *bytes * *bytes;
    sum_xy += *bytes * *ms;
  }
  if (!record_ms) input_error(place, ": no time of a record", kExpected);
  const double spread = n * sum_xx - sum_x * sum_x;
  if (n < 2 || !(spread > 0)) {
    input_error(place, ": expected all-to-all exchanges of at least two sizes, found ", n,
                " rows; time them with b3dgs", " bench exchange --mib 1 64 --json FILE");
  }
  const double slope = (n * sum_xy - sum_x * sum_y) / spread;
  if (!(slope > 0))
    input_error(place, ": larger exchanges do not take longer, so there is no bandwidth; time larger ones");
  cluster.in_host = {std::max(0.0, (sum_y - slope * sum_x) / n), 1 / slope};
  cluster.record_ms = *record_ms;
}

}  // namespace b3dgs
