#include "multi/train_on_ranks.h"

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "core/check.h"
#include "multi/rank_stepper.h"
#include "raster/torch/torch_cuda.h"

namespace b3dgs {

void train_on_ranks(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks, std::int64_t splats_at_a_time) {
  if (ranks.size() == 1) return;
  hooks.make_stepper = [&ranks, splats_at_a_time](Training& training) {
    for (const View& view : training.scene.train) {
      if (view.camera.lens.kind != LensKind::kEquirectangular) continue;
      input_error(view.name, ": panoramas cannot be trained on several ranks; train them on one");
    }
    return std::make_unique<RankStepper>(training, ranks, splats_at_a_time);
  };
  if (kTorchHasCuda && config.gpu_memory_gb == 0 && ranks.shares_gpus()) {
    device_memory_size();  // makes the context of this process, which takes memory itself
    ranks.barrier("start of the GPU");
    const std::int64_t free = device_memory_size().free;
    ranks.barrier("free GPU memory");
    hooks.gpu_memory_gb = 1e-9 * static_cast<double>(free) / ranks.n_on_own_gpu();
  }
}

namespace {

using Json = nlohmann::ordered_json;

/// FNV-1a, 64 bits.
class Checksum {
 public:
  void add(const void* data, std::size_t bytes) {
    const auto* at = static_cast<const unsigned char*>(data);
    for (const unsigned char* end = at + bytes; at != end; ++at) value_ = (value_ ^ *at) * 0x100000001b3ull;
  }
  template <class Number>
  void add(const std::vector<Number>& numbers) {
    add(numbers.data(), numbers.size() * sizeof(Number));
  }
  void add(const std::string& text) { add(text.data(), text.size()); }
  std::uint64_t value() const { return value_; }

 private:
  std::uint64_t value_ = 0xcbf29ce484222325ull;
};

std::uint64_t checksum_of(const Camera& camera) {
  Checksum sum;
  sum.add(std::vector<double>{camera.fx, camera.fy, camera.cx, camera.cy});
  const auto& pose = camera.cam_from_world;
  sum.add(pose.rotation.data(), sizeof pose.rotation);
  sum.add(pose.translation.data(), sizeof pose.translation);
  sum.add(std::vector<double>{static_cast<double>(camera.lens.kind), camera.lens.max_angle});
  sum.add(camera.lens.k, sizeof camera.lens.k);
  return sum.value();
}

/// Text with invalid UTF-8 replaced.
std::string dump(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Json describe(const std::vector<View>& views) {
  Json rows = Json::array();
  for (const View& view : views) {
    rows.push_back({view.name, detail::concat(view.camera.width, " x ", view.camera.height), checksum_of(view.camera)});
  }
  return rows;
}

Json describe(const Scene& scene, const Json& fingerprint) {
  Checksum points;
  points.add(scene.points.positions);
  points.add(scene.points.colors);
  return {{"train", describe(scene.train)},
          {"test", describe(scene.test)},
          {"photographs", fingerprint.at("photographs")},
          {"masks", fingerprint.at("masks")},
          {"n_points", scene.points.size()},
          {"points", points.value()}};
}

/// The first difference between two lists of views; "" if there is none.
std::string find_difference(const Json& there, const Json& first, const std::string& kind) {
  if (there.size() != first.size()) {
    return detail::concat(there.size(), " ", kind, " views there, ", first.size(), " on rank 0");
  }
  for (std::size_t i = 0; i < there.size(); ++i) {
    const Json &own = there[i], &other = first[i];
    const std::string name = own[0].get<std::string>(), view = detail::concat(kind, " view ", i, " (", name, ")");
    if (own[0] != other[0]) return detail::concat(view, " is ", other[0].get<std::string>(), " on rank 0");
    if (own[1] != other[1]) {
      return detail::concat(view, " has ", own[1].get<std::string>(), " px there, ", other[1].get<std::string>(),
                            " px on rank 0");
    }
    if (own[2] != other[2]) return view + " has another focal length, principal point or pose";
  }
  return "";
}

std::string find_difference(const Json& there, const Json& first) {
  for (const char* const kind : {"train", "test"}) {
    const std::string difference = find_difference(there[kind], first[kind], kind);
    if (!difference.empty()) return difference;
  }
  for (const auto& [key, file] : {std::pair("photographs", "photograph"), std::pair("masks", "mask")}) {
    const Json &files = there[key], &others = first[key];
    for (std::size_t i = 0; i < std::min(files.size(), others.size()); ++i) {
      if (files[i] == others[i]) continue;
      return detail::concat("the ", file, " of train view ", i, " (", there["train"][i][0].get<std::string>(),
                            ") is another file");
    }
  }
  if (there["n_points"] != first["n_points"]) {
    return detail::concat(dump(there["n_points"]), " points there, ", dump(first["n_points"]), " on rank 0");
  }
  return "positions or colours of the points";
}

}  // namespace

void check_same_scene(Communicator& ranks, const Scene& scene, const Json& fingerprint) {
  if (ranks.size() == 1) return;
  const std::string own = dump(describe(scene, fingerprint));
  Checksum sum;
  sum.add(own);
  const std::vector<std::uint64_t> sums = ranks.exchange_record("scene", sum.value());
  const auto other = std::find_if(sums.begin(), sums.end(), [&](std::uint64_t value) { return value != sums[0]; });
  if (other == sums.end()) return;
  const auto rank = static_cast<std::size_t>(other - sums.begin());
  const bool is_compared = ranks.is_first() || ranks.rank() == static_cast<int>(rank);
  const std::vector<std::string> scenes = ranks.exchange("scenes", is_compared ? own : "");
  const std::string path = ranks.exchange("scene path", scene.source_path)[rank];
  input_error("rank ", rank, " of ", ranks.size(),
              " and rank 0 read different scenes: ", find_difference(Json::parse(scenes[rank]), Json::parse(scenes[0])),
              " (", path, "); this folder must be the same on all machines");
}

}  // namespace b3dgs
