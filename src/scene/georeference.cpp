#include "scene/georeference.h"

#include <cmath>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/json_file.h"
#include "core/json_text.h"
#include "core/text.h"
#include "core/vec.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kEarthRadius = 6371e3;  // m

/// Calls field(group, key, value) for each number of the file.
template <class Value, class Field>
void visit_numbers(Value& g, Field&& field) {
  field("origin", "latitude", g.latitude);
  field("origin", "longitude", g.longitude);
  field("utm", "epsg", g.epsg);
  field("utm", "easting", g.easting);
  field("utm", "northing", g.northing);
  field("utm", "grid_convergence_degrees", g.convergence);
  field("utm", "grid_scale", g.grid_scale);
  field("fit", "photographs", g.n_photographs);
  field("fit", "gps_positions", g.n_fixes);
  field("fit", "gps_positions_kept", g.n_kept);
  field("fit", "residual_median_m", g.median_residual);
  field("fit", "residual_largest_m", g.largest_residual);
}

}  // namespace

std::array<double, 3> Georeference::to_utm(const std::array<double, 3>& point) const {
  const auto& [x, y, z] = point;
  // The grid lies on the curved Earth, and the scene has the plane that touches it at the origin.
  const double scale = grid_scale * (1 - z / kEarthRadius);
  const double c = std::cos(convergence * kDegree), s = std::sin(convergence * kDegree);
  return {easting + scale * (c * x - s * y), northing + scale * (s * x + c * y),
          height.value_or(0) + z + (x * x + y * y) / (2 * kEarthRadius)};
}

std::string Georeference::describe_origin() const {
  return print_to_string("%.6f %c, %.6f %c, %s, EPSG:%d", std::abs(latitude), latitude < 0 ? 'S' : 'N',
                         std::abs(longitude), longitude < 0 ? 'W' : 'E',
                         height ? print_to_string("height %.1f m", *height).c_str() : "height unknown", epsg);
}

std::string Georeference::describe_fit() const {
  return print_to_string("%d of %d GPS positions agree, median %.2f m, largest %.2f m", n_kept, n_fixes,
                         median_residual, largest_residual);
}

std::optional<Georeference> read_georeference(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / Georeference::kFile;
  const Json json = read_json(file);
  if (json.is_null()) return std::nullopt;
  Georeference read;
  const auto number = [&](const char* group, const char* key) -> const Json& {
    static const Json kMissing;
    const bool has_key =
        json.is_object() && json.contains(group) && json[group].is_object() && json[group].contains(key);
    return has_key ? json[group][key] : kMissing;
  };
  visit_numbers(read, [&](const char* group, const char* key, auto& value) {
    const Json& found = number(group, key);
    if (!found.is_number()) {
      input_error(file.string(), ": expected the number \"", key, "\" in \"", group,
                  "\"; remove the file, or run b3dgs georeference again");
    }
    value = found.get<std::decay_t<decltype(value)>>();
  });
  const Json& height = number("origin", "height");
  if (height.is_number()) read.height = height.get<double>();
  return read;
}

void write_georeference(const std::filesystem::path& folder, const Georeference& georeference) {
  Json json{{"coordinates", "metres east, north and up from the origin"}};
  visit_numbers(georeference, [&](const char* group, const char* key, const auto& value) { json[group][key] = value; });
  json["origin"]["height"] = georeference.height ? Json(*georeference.height) : Json();
  write_file(folder / Georeference::kFile, dump_json(json, 2) + "\n");
}

}  // namespace b3dgs
