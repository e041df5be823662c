#include "core/options/option_values.h"

#include <charconv>
#include <cmath>
#include <sstream>

namespace b3dgs {
namespace {

template <class Number>
Number to_number(const OptionSpec& spec, const std::string& word) {
  Number value{};
  const char* end = word.data() + word.size();
  const auto [stop, error] = std::from_chars(word.data(), end, value);
  if (error == std::errc() && stop == end && std::isfinite(static_cast<double>(value))) return value;
  std::string expected = "a number";
  if constexpr (std::is_integral_v<Number>) {
    const bool is_too_large = error == std::errc::result_out_of_range && stop == end;
    expected = "a whole number" + (is_too_large ? detail::limits_text<Number>() : "");
  }
  detail::invalid_value(/*place=*/"", spec.name, expected, '"' + word + '"');
}

/// "a,b" "c d" "e, f" -> a b c d e f; an empty entry stays, to be reported.
std::vector<std::string> list_entries(const std::vector<std::string>& words) {
  std::vector<std::string> entries;
  for (const std::string& word : words) {
    std::istringstream text(word);
    for (std::string part; std::getline(text, part, ',');) {
      std::istringstream blanks(part);
      const std::size_t n_before = entries.size();
      for (std::string entry; blanks >> entry;) entries.push_back(entry);
      if (entries.size() == n_before) entries.emplace_back();
    }
  }
  return entries;
}

template <class Number>
nlohmann::json to_numbers(const OptionSpec& spec, const std::vector<std::string>& words) {
  nlohmann::json values = nlohmann::json::array();
  for (const std::string& entry : list_entries(words)) values.push_back(to_number<Number>(spec, entry));
  return values;
}

}  // namespace

bool is_truth_value(const std::string& word) {
  return word == "true" || word == "false";
}

nlohmann::json option_value(const OptionSpec& spec, const std::vector<std::string>& words) {
  switch (spec.kind) {
    case ValueKind::kFlag:
      if (!is_truth_value(words.back())) {
        detail::invalid_value(/*place=*/"", spec.name, "true or false", '"' + words.back() + '"');
      }
      return words.back() == "true";
    case ValueKind::kInt:
      return to_number<int>(spec, words.back());
    case ValueKind::kInt64:
      return to_number<std::int64_t>(spec, words.back());
    case ValueKind::kNumber:
      return to_number<double>(spec, words.back());
    case ValueKind::kText:
      if (words.back().empty() && !spec.is_empty_allowed && !spec.lists_choices) {
        input_error("invalid value for --", spec.name,
                    " (expected a text that is not empty, found \"\"); leave the option out to have none");
      }
      return words.back();
    case ValueKind::kInts:
      return to_numbers<int>(spec, words);
    case ValueKind::kInt64s:
      return to_numbers<std::int64_t>(spec, words);
    case ValueKind::kNumbers:
      return to_numbers<double>(spec, words);
    case ValueKind::kNames:
      return list_entries(words);
  }
  return {};
}

}  // namespace b3dgs
