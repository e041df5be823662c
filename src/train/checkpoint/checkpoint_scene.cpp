#include "train/checkpoint/checkpoint.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <set>

#include "core/check.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Returns whether two extents are equal up to rounding, because the order of a sum may change between versions.
bool is_same_extent(const Json& before, const Json& after) {
  constexpr double kTolerance = 1e-6;
  const auto a = before.get<double>(), b = after.get<double>();
  return std::abs(a - b) <= kTolerance * std::max(std::abs(a), std::abs(b));
}

Json describe_views(const Scene& scene) {
  Json views = Json::array();
  for (const View& view : scene.train) {
    views.push_back({{"name", view.name}, {"width", view.camera.width}, {"height", view.camera.height}});
  }
  return views;
}

/// Returns a checksum of pose and intrinsics for each training view. Values are rounded to float, because a later
/// version may compute them in another order.
Json camera_crcs(const Scene& scene) {
  Json crcs = Json::array();
  for (const View& view : scene.train) {
    const Camera& camera = view.camera;
    const Pose& pose = camera.cam_from_world;
    std::vector<double> values{camera.fx, camera.fy, camera.cx, camera.cy};
    values.insert(values.end(), pose.rotation.begin(), pose.rotation.end());
    values.insert(values.end(), pose.translation.begin(), pose.translation.end());
    if (!camera.is_pinhole()) {
      values.push_back(static_cast<double>(camera.lens.kind));
      values.insert(values.end(), std::begin(camera.lens.k), std::end(camera.lens.k));
    }
    std::uint32_t crc = 0;
    for (const double value : values) {
      const float rounded = static_cast<float>(value) + 0.0f;  // turns -0 into 0
      crc = add_crc(crc, &rounded, sizeof rounded);
    }
    crcs.push_back(crc);
  }
  return crcs;
}

// Returns a checksum of the scene's own points only. A resumed training does not search the photographs for more.
std::uint32_t points_crc(const Scene& scene) {
  const auto n = static_cast<std::size_t>(3 * (scene.points.size() - scene.n_added_points));
  return add_crc(add_crc(0, scene.points.positions.data(), n * sizeof(float)), scene.points.colors.data(), n);
}

std::string describe_view(const Json& view) {
  return detail::concat(view.at("name").get<std::string>(), ", ", view.at("width").get<int>(), " x ",
                        view.at("height").get<int>(), " px");
}

// Returns "; 2 are missing (00002.png, ...)", or "" if there are no names.
std::string count_and_first(const std::vector<std::string>& names, const char* what) {
  if (names.empty()) return "";
  return detail::concat("; ", names.size(), names.size() == 1 ? " is " : " are ", what, " (", names[0],
                        names.size() > 1 ? ", ...)" : ")");
}

// Describes which of the training views `before` are not among those of the scene, and vice versa. Returns "" if there
// is no difference.
std::string describe_difference(const Json& before, const Json& after, const Scene& scene) {
  std::set<std::string> old_names, new_names, test_names;
  for (const Json& view : before) old_names.insert(view.at("name").get<std::string>());
  for (const Json& view : after) new_names.insert(view.at("name").get<std::string>());
  for (const View& view : scene.test) test_names.insert(view.name);
  std::vector<std::string> missing, held_out, added;
  for (const std::string& name : old_names) {
    if (new_names.count(name) == 0) (test_names.count(name) == 0 ? missing : held_out).push_back(name);
  }
  std::set_difference(new_names.begin(), new_names.end(), old_names.begin(), old_names.end(),
                      std::back_inserter(added));
  return count_and_first(missing, "missing") + count_and_first(held_out, "held out for testing now") +
         count_and_first(added, "new");
}

}  // namespace

Json scene_fingerprint(const Scene& scene) {
  Json photographs = Json::array(), masks = Json::array();
  for (const View& view : scene.train) {
    photographs.push_back(photograph_fingerprint(view.file));
    masks.push_back(photograph_fingerprint(view.mask_file));
  }
  return {{"frame", {{"origin", scene.frame.origin}, {"unit", scene.frame.unit}}},
          {"extent", scene.extent},
          {"train_views", describe_views(scene)},
          {"camera_crc32s", camera_crcs(scene)},
          {"points_crc32", points_crc(scene)},
          {"photographs", std::move(photographs)},
          {"masks", std::move(masks)}};
}

CoordinateFrame checkpoint_frame(const Json& header, const std::string& place) {
  CoordinateFrame frame;
  try {
    const Json& scene = header.at("scene");
    scene.at("frame").at("origin").get_to(frame.origin);
    scene.at("frame").at("unit").get_to(frame.unit);
  } catch (const nlohmann::json::exception& error) {
    input_error(place, ": invalid checkpoint header: ", error.what());
  }
  for (const double value : frame.origin) {
    if (!std::isfinite(value)) input_error(place, ": invalid checkpoint header: scene.frame.origin");
  }
  if (!(frame.unit > 0) || !std::isfinite(frame.unit)) {
    input_error(place, ": invalid checkpoint header: scene.frame.unit must be above 0, found ", frame.unit);
  }
  return frame;
}

void check_scene(const Json& header, const Scene& scene, const std::string& place) {
  const std::string remedy = "; resume with the same -s, -i, -r and --eval";
  B3DGS_CHECK(checkpoint_frame(header, place) == scene.frame, place,
              ": the scene is in another frame; load it with SceneOptions::frame = checkpoint_frame()");
  try {
    const Json &saved = header.at("scene"), &before = saved.at("train_views");
    const Json after = describe_views(scene);
    const std::string difference = describe_difference(before, after, scene);
    if (before.size() != after.size()) {
      input_error(place, ": trained on ", before.size(), " views, but the scene has ", after.size(), difference,
                  remedy);
    }
    if (!difference.empty()) input_error(place, ": trained on other views of the scene", difference, remedy);
    for (std::size_t i = 0; i < before.size(); ++i) {
      if (before[i] != after[i]) {
        input_error(place, ": expected training view ", i, " to be ", describe_view(before[i]), ", found ",
                    describe_view(after[i]), remedy);
      }
    }
    const Json &cameras = saved.at("camera_crc32s"), now = camera_crcs(scene);
    std::vector<std::string> moved;
    for (std::size_t i = 0; i < std::min(cameras.size(), now.size()); ++i) {
      if (cameras[i] != now[i]) moved.push_back(scene.train[i].name);
    }
    if (!moved.empty()) {
      input_error(place, ": poses or intrinsics of ", moved.size(), " of ", now.size(),
                  " training views have changed since it was written (", moved.size() > 1 ? "first: " : "", moved[0],
                  "), so its Gaussians do not fit them; resume with the cameras of that training, or train anew");
    }
    if (!is_same_extent(saved.at("extent"), scene.extent)) {
      input_error(place, ": trained on a scene of extent ", saved.at("extent").dump(), ", but this one has extent ",
                  Json(scene.extent).dump(), remedy);
    }
  } catch (const nlohmann::json::exception& error) {
    input_error(place, ": invalid checkpoint header: ", error.what());
  }
}

std::vector<std::string> scene_changes(const Json& header, const Json& fingerprint) {
  const Json scene = header.value("scene", Json::object()), &views = fingerprint.at("train_views");
  std::vector<std::string> changes;
  for (const auto& [kind, key] :
       {std::pair{"", "photographs"}, {"masks of ", "masks"}, {"depth maps of ", "depth_maps"}}) {
    const bool may_be_added = key != std::string("photographs");
    const Json saved = scene.value(key, Json::array()), now = fingerprint.value(key, Json::array());
    std::vector<std::string> names;
    for (std::size_t i = 0; i < std::min(saved.size(), now.size()); ++i) {
      if (is_same_photograph(saved[i], now[i]) || (saved[i].is_null() && !may_be_added)) continue;
      names.push_back(views[i].at("name").get<std::string>());
    }
    if (names.empty()) continue;
    changes.push_back(detail::concat(
        kind, names.size(), " of ", views.size(), " photographs have changed since this checkpoint was written (",
        names.size() > 1 ? "first: " : "", names.front(), "); training continues with the current files"));
  }
  if (scene.contains("points_crc32") && scene.at("points_crc32") != fingerprint.at("points_crc32")) {
    changes.emplace_back(
        "the points of the scene have changed since this checkpoint was written; training continues "
        "with its Gaussians");
  }
  return changes;
}

}  // namespace b3dgs
