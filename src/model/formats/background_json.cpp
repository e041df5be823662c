#include "model/formats/background_json.h"

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/json_text.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kSkyDegree = 4;
constexpr std::size_t kSkyCoefficients = (kSkyDegree + 1) * (kSkyDegree + 1);
constexpr double kY0 = 0.28209479177387814;  // SH of degree 0: sqrt(1 / (4 pi))

double sigmoid(double x) {
  return 1 / (1 + std::exp(-x));
}

/// @throws nlohmann::json::exception for missing keys and wrong types; InputError for other faults
BackgroundSh parse(const Json& json, const std::string& place) {
  const Json& rows = json.at("coefficients");
  const int degree = json_integer<int>(json.at("sh_degree"), "sh_degree", place, 0, kSkyDegree);
  const std::size_t wanted = degree == 0 ? 1 : kSkyCoefficients;
  if (degree != 0 && degree != kSkyDegree) {
    input_error(place, ": sh_degree: expected 0 or ", kSkyDegree, ", found ", degree);
  }
  if (!rows.is_array() || rows.size() != wanted) {
    input_error(place, ": coefficients: expected ", wanted, " rows for sh_degree ", degree, ", found ",
                rows.is_array() ? std::to_string(rows.size()) : json_excerpt(rows));
  }
  BackgroundSh background;
  for (const Json& row : rows) {
    if (!row.is_array() || row.size() != 3) {
      input_error(place, ": coefficients: expected three numbers in a row, found ", json_excerpt(row));
    }
    for (const Json& value : row) {
      const auto number = value.get<float>();
      if (!std::isfinite(number)) input_error(place, ": coefficients: expected finite numbers, found ", number);
      background.coefficients.push_back(number);
    }
  }
  return background;
}

}  // namespace

std::filesystem::path background_path(const std::filesystem::path& ply) {
  return ply.parent_path() / "background.json";
}

void write_background_json(const std::filesystem::path& path, const BackgroundSh& background) {
  const std::vector<float>& values = background.coefficients;
  const bool is_one_color = values.size() == 3;
  Json json{{"type", is_one_color ? "learned" : "sky"}, {"sh_degree", is_one_color ? 0 : kSkyDegree}};
  if (is_one_color) {
    for (const float value : values) json["color"].push_back(sigmoid(kY0 * static_cast<double>(value)));
  }
  Json& rows = json["coefficients"] = Json::array();
  for (std::size_t i = 0; i + 2 < values.size(); i += 3) rows.push_back({values[i], values[i + 1], values[i + 2]});
  write_file(path, json.dump(2) + "\n");
}

std::optional<BackgroundSh> read_background_json(const std::filesystem::path& path) {
  std::ifstream file(path);
  if (!file && !std::filesystem::exists(path)) return std::nullopt;
  if (!file) input_error(path.string(), ": cannot be opened");
  const Json json = parse_json(file);
  const std::string place = path.string();
  if (!json.is_object()) input_error(place, ": not a JSON object; the file is damaged");
  try {
    return parse(json, place);
  } catch (const nlohmann::json::exception& error) {
    input_error(place, ": unexpected content: ", error.what());
  }
}

}  // namespace b3dgs
