// Whether all ranks read the same scene: each reads the folder of its own machine.

#include <algorithm>
#include <string>
#include <utility>

#include "core/check.h"
#include "model/checkpoint/checkpoint_header.h"
#include "multi/rank_stepper.h"
#include "scene/scene.h"

namespace b3dgs {

namespace {

using Json = nlohmann::ordered_json;

/// Text with invalid UTF-8 replaced.
std::string dump(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Json describe(const std::vector<View>& views) {
  Json rows = Json::array();
  for (const View& view : views) {
    const Camera& camera = view.camera;
    const Json numbers =
        Json::array({camera.fx, camera.fy, camera.cx, camera.cy, camera.cam_from_world.rotation,
                     camera.cam_from_world.translation, camera.lens.kind, camera.lens.max_angle, camera.lens.k});
    rows.push_back(Json::array({view.name, detail::concat(camera.width, " x ", camera.height), numbers}));
  }
  return rows;
}

Json describe(const Scene& scene, const Json& fingerprint) {
  const auto& positions = scene.points.positions;
  const auto& colors = scene.points.colors;
  const std::uint32_t points =
      add_crc(add_crc(0, positions.data(), positions.size() * sizeof(float)), colors.data(), colors.size());
  return {{"train", describe(scene.train)},
          {"test", describe(scene.test)},
          {"photographs", fingerprint.at("photographs")},
          {"masks", fingerprint.at("masks")},
          {"n_points", scene.points.size()},
          {"points", points}};
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

/// The first difference between two scenes that differ.
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

void RankStepper::check_same_scene(const Json& fingerprint) {
  const Scene& scene = training_.scene;
  const std::string own = dump(describe(scene, fingerprint));
  const std::string first = ranks_.exchange("scene", ranks_.is_first() ? own : "").front();
  std::string difference;
  if (own != first) {
    difference = find_difference(Json::parse(own), Json::parse(first)) + " (" + scene.source_path + ")";
  }
  const std::vector<std::string> differences = ranks_.exchange("differences of scenes", difference);
  for (std::size_t rank = 0; rank < differences.size(); ++rank) {
    if (differences[rank].empty()) continue;
    input_error("rank ", rank, " of ", ranks_.size(), " and rank 0 read different scenes: ", differences[rank],
                "; this folder must be the same on all machines");
  }
}

}  // namespace b3dgs
