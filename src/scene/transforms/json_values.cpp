#include "scene/transforms/json_values.h"

#include <cmath>

namespace b3dgs::transforms {
namespace {

constexpr double kMaxNumber = 1e12;   // its square is finite in single precision
constexpr double kMaxSide = 1 << 20;  // px; larger only in damaged files

}  // namespace

double finite_number(const Json& json, const std::string& what, const std::string& place) {
  const double value = json.is_number() ? json.get<double>() : kMaxNumber * 2;
  if (!(std::abs(value) <= kMaxNumber)) {
    input_error(place, ": expected ", what, " to be a number of at most ", kMaxNumber, ", found ", json_excerpt(json));
  }
  return value;
}

const Json* FrameValues::find(const char* key) const {
  for (const Json* json : {&frame_, &file_}) {
    const auto found = json->find(key);
    if (found != json->end() && !found->is_null()) return &*found;
  }
  return nullptr;
}

std::optional<double> FrameValues::number(const char* key) const {
  const Json* json = find(key);
  if (json == nullptr) return std::nullopt;
  return finite_number(*json, key, place_);
}

std::optional<int> FrameValues::side(const char* key) const {
  const std::optional<double> value = number(key);
  if (!value) return std::nullopt;
  if (*value != std::floor(*value) || *value < 1 || *value > kMaxSide) {
    input_error(place_, ": expected ", key, " to be a whole number of 1 to ", kMaxSide, " px, found ", *value);
  }
  return static_cast<int>(*value);
}

std::optional<bool> FrameValues::boolean(const char* key) const {
  const Json* json = find(key);
  if (json == nullptr) return std::nullopt;
  if (!json->is_boolean()) {
    input_error(place_, ": expected ", key, " to be true or false, found ", json_excerpt(*json));
  }
  return json->get<bool>();
}

std::string FrameValues::text(const char* key) const {
  const Json* json = find(key);
  if (json == nullptr) return "";
  if (!json->is_string()) input_error(place_, ": expected ", key, " to be a text, found ", json_excerpt(*json));
  return json->get<std::string>();
}

}  // namespace b3dgs::transforms
