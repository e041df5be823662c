#include "app/georeference/georeference_scene.h"

#include <algorithm>
#include <system_error>
#include <utility>
#include <vector>

#include "app/georeference/fit_to_gps.h"
#include "app/georeference/gps.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/own_files.h"
#include "scene/cameras/camera.h"
#include "scene/colmap/colmap.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

template <class Item, class Value>
double median_of(const std::vector<Item>& items, const Value& value) {
  std::vector<double> values;
  for (const Item& item : items) values.push_back(value(item));
  return median(std::move(values));
}

/// Images of a model with the GPS positions of their photographs.
struct Positions {
  std::vector<std::size_t> images;
  std::vector<GpsPosition> of_images;
};

Positions read_positions(const ColmapModel& model, const std::function<fs::path(const std::string&)>& photograph) {
  Positions found;
  for (std::size_t i = 0; i < model.images.size(); ++i) {
    if (const auto position = read_gps(photograph(model.images[i].name))) {
      found.images.push_back(i);
      found.of_images.push_back(*position);
    }
  }
  // Without the few that lack a height, or without any height if many lack it.
  const auto has_height = [](const GpsPosition& position) { return position.height.has_value(); };
  const auto n_heights =
      static_cast<std::size_t>(std::count_if(found.of_images.begin(), found.of_images.end(), has_height));
  const bool keeps_heights = n_heights >= kLeastPositions && 2 * n_heights >= found.images.size();
  Positions used;
  for (std::size_t i = 0; i < found.images.size(); ++i) {
    if (keeps_heights && !has_height(found.of_images[i])) continue;
    used.images.push_back(found.images[i]);
    used.of_images.push_back(found.of_images[i]);
    if (!keeps_heights) used.of_images.back().height.reset();
  }
  return used;
}

/// The median, because some positions may be wrong by kilometres.
GpsPosition middle_of(const std::vector<GpsPosition>& positions) {
  GpsPosition middle{median_of(positions, [](const GpsPosition& p) { return p.latitude; }),
                     median_of(positions, [](const GpsPosition& p) { return p.longitude; }), std::nullopt};
  if (positions.front().height) middle.height = median_of(positions, [](const GpsPosition& p) { return *p.height; });
  return middle;
}

std::optional<std::array<double, 3>> up_of(const ColmapModel& model) {
  std::vector<Camera> cameras;
  for (const ColmapImage& image : model.images) {
    cameras.emplace_back().cam_from_world = {rotation_from_quaternion(image.quat), image.translation};
  }
  return up_direction(cameras);
}

/// Puts the model in place of that in the folder. Returns where files of the user that were in the folder are, or "".
fs::path replace_model(const fs::path& scene, const fs::path& folder, const ColmapModel& model) {
  OwnFiles* const own = OwnFiles::of(scene / Georeference::kFile);
  B3DGS_CHECK(own != nullptr, "the scene folder is not locked");
  const fs::path made = temporary_name(scene), previous = previous_name(scene / "sparse"), split = folder / "test.txt";
  write_colmap_model(made, model, *colmap_format(folder));
  std::error_code error;
  if (fs::exists(split, error)) {
    fs::copy_file(split, made / split.filename());
    own->add(made / split.filename());
  }
  if (folder.filename() == "sparse") {
    own->move(folder, previous);
  } else {
    create_folder(previous);
    own->move(folder, previous / folder.filename());
  }
  own->move(made, folder);
  own->remove(previous);
  return fs::exists(previous, error) ? previous : "";
}

}  // namespace

GeoreferenceOutcome georeference_scene(const fs::path& scene, const fs::path& folder,
                                       const std::function<fs::path(const std::string& name)>& photograph) {
  ColmapModel model = read_colmap_model(folder, Observations::kAll);
  const Positions positions = read_positions(model, photograph);
  if (positions.images.empty()) return {};
  const GpsPosition middle = middle_of(positions.of_images);
  GpsFitInput input;
  for (std::size_t i = 0; i < positions.images.size(); ++i) {
    input.centers.push_back(center_of(model.images[positions.images[i]]));
    input.positions.push_back(east_north_up(middle, positions.of_images[i]));
  }
  input.has_heights = middle.height.has_value();
  input.up = up_of(model);
  GeoreferenceOutcome outcome;
  std::optional<GpsFit> fit = fit_to_gps(input, outcome.why_not);
  if (!fit) return outcome;

  if (!model.left_out.empty()) input_error(model.left_out.front().reason);
  transform(fit->to_earth, model);
  const double ground =
      model.points.empty() ? 0 : median_of(model.points, [](const ColmapPoint& point) { return point.position[2]; });
  transform({1, Similarity().rotation, {0, 0, -ground}}, model);
  Georeference place;
  place.latitude = middle.latitude;
  place.longitude = middle.longitude;
  if (middle.height) place.height = *middle.height + ground;
  const UtmPlace utm = utm_place({place.latitude, place.longitude, place.height});
  place.epsg = utm.epsg;
  place.easting = utm.easting;
  place.northing = utm.northing;
  place.convergence = utm.convergence;
  place.grid_scale = utm.grid_scale;
  place.n_photographs = static_cast<int>(model.images.size());
  place.n_fixes = static_cast<int>(positions.images.size());
  place.n_kept = static_cast<int>(fit->kept.size());
  place.median_residual = fit->median_residual;
  place.largest_residual = fit->largest_residual;
  outcome.previous = replace_model(scene, folder, model);
  write_georeference(scene, place);
  outcome.georeference = place;
  return outcome;
}

}  // namespace b3dgs
