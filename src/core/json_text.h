// For JSON from files: parsing without exceptions, integers with range checks, and short excerpts for error messages.
#pragma once

#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "core/check.h"

namespace b3dgs {

/// Deeper nesting is rejected, since copying, comparing and printing a JSON value recurse.
inline constexpr int kMaxJsonDepth = 64;

/// The document, or a discarded value (is_discarded()) if `input`, a string or a stream, is not valid JSON or is nested
/// too deeply.
template <class Input>
nlohmann::ordered_json parse_json(Input&& input, bool ignore_comments = false) {
  using Json = nlohmann::ordered_json;
  bool is_too_deep = false;
  const auto limit_depth = [&](int depth, Json::parse_event_t event, Json&) {
    const bool begins = event == Json::parse_event_t::object_start || event == Json::parse_event_t::array_start;
    if (begins && depth >= kMaxJsonDepth) is_too_deep = true;
    return !is_too_deep;
  };
  Json json = Json::parse(std::forward<Input>(input), limit_depth, /*allow_exceptions=*/false,
                          /*ignore_comments=*/ignore_comments);
  return is_too_deep ? Json(Json::value_t::discarded) : json;
}

/// Why parse_json(), ignoring comments, has discarded a text: "parse error at line 3, column 5: ...".
inline std::string json_damage(std::string_view text) {
  try {
    const auto nested =
        nlohmann::ordered_json::parse(text, nullptr, /*allow_exceptions=*/true, /*ignore_comments=*/true);
    return detail::concat("nesting of more than ", kMaxJsonDepth, " levels");
  } catch (const nlohmann::json::exception& error) {
    constexpr std::size_t kMaxLength = 200;  // it quotes what was read last
    const std::string reason = error.what();
    return reason.substr(reason.find("] ") + 2, kMaxLength);  // without the library's number
  }
}

/// A value for an error message: its text, at most 80 characters of it, or "an object", "an array of 20 values".
inline std::string json_excerpt(const nlohmann::ordered_json& json) {
  if (json.is_object()) return "an object";
  if (json.is_array() && json.size() > 16) return detail::concat("an array of ", json.size(), " values");
  std::string text = json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
  constexpr std::size_t kMaxLength = 80;
  if (text.size() <= kMaxLength) return text;
  std::size_t end = kMaxLength;
  while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0) == 0x80) --end;  // not inside a UTF-8 character
  return text.substr(0, end) + "...";
}

/// An integer in [min, max]. @throws InputError naming `place` and `what` for any other value, including 1.0 and true
template <class Integer>
Integer json_integer(const nlohmann::ordered_json& json, const char* what, const std::string& place,
                     Integer min = std::numeric_limits<Integer>::min(),
                     Integer max = std::numeric_limits<Integer>::max()) {
  static_assert(std::is_integral_v<Integer> && sizeof(Integer) <= sizeof(std::int64_t));
  bool fits = false;
  Integer value{};
  const auto take = [&](auto number) {
    value = static_cast<Integer>(number);
    const bool same_sign = (number < decltype(number){}) == (value < Integer{});
    fits = static_cast<decltype(number)>(value) == number && same_sign && value >= min && value <= max;
  };
  if (json.is_number_unsigned()) {
    take(json.get<std::uint64_t>());
  } else if (json.is_number_integer()) {
    take(json.get<std::int64_t>());
  }
  if (!fits) {
    input_error(place, ": ", what, " must be a whole number from ", min, " to ", max, ", found ", json_excerpt(json));
  }
  return value;
}

}  // namespace b3dgs
