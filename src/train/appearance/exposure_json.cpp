#include "train/appearance/exposure_json.h"

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/json_text.h"

namespace b3dgs {

using Json = nlohmann::ordered_json;

Exposures named_exposures(const torch::Tensor& exposures, const std::vector<View>& views) {
  B3DGS_CHECK(exposures.size(0) == static_cast<std::int64_t>(views.size()), exposures.size(0), " exposures of ",
              views.size(), " views");
  const torch::Tensor host = exposures.to(torch::kCPU).contiguous();
  Exposures named;
  const float* values = host.data_ptr<float>();
  for (const View& view : views) {
    ColorTransform& transform = named[view.name];
    for (double& value : transform) value = *values++;
  }
  return named;
}

void write_exposures(const std::filesystem::path& path, const Exposures& exposures) {
  Json json = Json::object();
  for (const auto& [name, transform] : exposures) {
    Json& rows = json[name] = Json::array();
    for (std::size_t row = 0; row < 3; ++row) {
      rows.push_back({transform[4 * row], transform[4 * row + 1], transform[4 * row + 2], transform[4 * row + 3]});
    }
  }
  write_file(path, json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

Exposures read_exposures(const std::filesystem::path& path) {
  std::ifstream file(path);
  if (!file) input_error(path.string(), ": cannot be opened");
  const Json json = parse_json(file);
  if (!json.is_object()) input_error(path.string(), ": not a JSON object; the file is damaged");
  Exposures exposures;
  for (const auto& [name, rows] : json.items()) {
    ColorTransform& transform = exposures[name];
    try {
      const auto values = rows.get<std::array<std::array<double, 4>, 3>>();
      // Of a longer list, the conversion takes the beginning.
      bool is_valid = rows.size() == 3;
      for (std::size_t row = 0; row < 3; ++row) {
        is_valid = is_valid && rows[row].size() == 4;
        for (std::size_t i = 0; i < 4; ++i) {
          transform[4 * row + i] = values[row][i];
          is_valid = is_valid && std::isfinite(values[row][i]);
        }
      }
      if (is_valid) continue;
    } catch (const nlohmann::json::exception&) {  // reported below
    }
    input_error(path.string(), ": ", name, ": expected 3 rows of 4 numbers, found ", json_excerpt(rows));
  }
  return exposures;
}

}  // namespace b3dgs
