// Helpers for JSON in files: text for names of any bytes, parsing without exceptions, integers with range checks, and
// short excerpts for error messages.
#pragma once

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/check.h"

namespace b3dgs {

/// Deeper nesting is rejected, because copying, comparing and printing a JSON value recurse.
inline constexpr int kMaxJsonDepth = 64;

// JSON is UTF-8, but the name of a file can be any bytes. dump_json() writes such strings with an escape for each byte
// that is not part of a UTF-8 character, and parse_json() restores the bytes. Other strings are written as they are.

/// Starts an escape, followed by two hexadecimal digits. Names of photographs have no control characters.
inline constexpr char kByteEscape = '\x1a';

/// Returns UTF-8 from which unescape_bytes() restores `bytes`. Valid UTF-8 without kByteEscape stays as it is.
inline std::string escape_bytes(std::string_view bytes) {
  std::string text;
  while (!bytes.empty()) {
    const detail::Character c = detail::first_character(bytes);
    if (!c.is_utf8 || bytes[0] == kByteEscape) {
      constexpr const char* kDigits = "0123456789abcdef";
      text += {kByteEscape, kDigits[c.code >> 4], kDigits[c.code & 15]};
    } else {
      text += bytes.substr(0, c.bytes);
    }
    bytes.remove_prefix(c.bytes);
  }
  return text;
}

/// The inverse of escape_bytes(). Does not change text that escape_bytes() does not write.
inline std::string unescape_bytes(std::string_view text) {
  std::string bytes;
  while (!text.empty()) {
    unsigned char byte = 0;
    if (text[0] == kByteEscape && text.size() >= 3) {
      const auto read = std::from_chars(text.data() + 1, text.data() + 3, byte, 16);
      if (read.ptr != text.data() + 3 || (byte < 0x80 && byte != kByteEscape)) byte = 0;
    }
    bytes += byte == 0 ? text[0] : static_cast<char>(byte);
    text.remove_prefix(byte == 0 ? 1 : 3);
  }
  return bytes;
}

namespace detail {

/// Replaces each string of a document, including keys of objects, by convert(string).
template <class Convert>
void convert_strings(nlohmann::ordered_json& json, const Convert& convert) {
  using Json = nlohmann::ordered_json;
  if (json.is_string()) {
    json = convert(json.get_ref<const std::string&>());
  } else if (json.is_array()) {
    for (Json& part : json) convert_strings(part, convert);
  } else if (json.is_object()) {
    Json::object_t converted;
    converted.reserve(json.size());
    for (auto& [key, value] : json.get_ref<Json::object_t&>()) {
      convert_strings(value, convert);
      converted.emplace_back(convert(key), std::move(value));
    }
    json = std::move(converted);
  }
}

}  // namespace detail

/// Returns the text of a document, with strings of any bytes. An `indent` of -1 gives one line.
inline std::string dump_json(nlohmann::ordered_json json, int indent = -1) {
  detail::convert_strings(json, escape_bytes);
  return json.dump(indent);
}

/// Returns a value for an error message: at most 80 characters of its text, or "an object", "an array of 20 values".
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

/// Parses a string or a stream. Returns a discarded value (is_discarded()) if `input` is not valid JSON, is nested too
/// deeply, or has an object with the same key twice. `repeated_key` then gets an excerpt of this key.
template <class Input>
nlohmann::ordered_json parse_json(Input&& input, bool ignore_comments = false, std::string* repeated_key = nullptr) {
  using Json = nlohmann::ordered_json;
  using Event = Json::parse_event_t;
  bool is_refused = false;
  std::vector<std::set<std::string>> keys;  // of the objects around the current position
  const auto check = [&](int depth, Event event, Json& parsed) {
    if (is_refused) return false;
    if (event == Event::object_start) keys.emplace_back();
    if (event == Event::object_end) keys.pop_back();
    if (event == Event::key && !keys.back().insert(parsed.template get<std::string>()).second) {
      is_refused = true;
      if (repeated_key != nullptr) *repeated_key = json_excerpt(parsed);
    }
    const bool begins = event == Event::object_start || event == Event::array_start;
    if (begins && depth >= kMaxJsonDepth) is_refused = true;
    return !is_refused;
  };
  Json json = Json::parse(std::forward<Input>(input), check, /*allow_exceptions=*/false,
                          /*ignore_comments=*/ignore_comments);
  if (is_refused) return Json(Json::value_t::discarded);
  detail::convert_strings(json, unescape_bytes);
  return json;
}

/// Returns why parse_json(), ignoring comments, discarded a text: "parse error at line 3, column 5: ...".
inline std::string json_damage(std::string_view text) {
  std::string repeated_key;
  parse_json(text, /*ignore_comments=*/true, &repeated_key);
  if (!repeated_key.empty()) return "the key " + repeated_key + " twice in one object";
  try {
    const auto nested =
        nlohmann::ordered_json::parse(text, nullptr, /*allow_exceptions=*/true, /*ignore_comments=*/true);
    return detail::concat("nesting of more than ", kMaxJsonDepth, " levels");
  } catch (const nlohmann::json::exception& error) {
    constexpr std::size_t kMaxLength = 200;  // it quotes the text that was read last
    const std::string reason = error.what();
    return reason.substr(reason.find("] ") + 2, kMaxLength);  // without the library's error number
  }
}

/// Returns an integer in [min, max]. @throws InputError naming `place` and `what` for others, including 1.0 and true
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
