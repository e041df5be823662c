#include "reconstruct/colmap_progress.h"

#include <charconv>
#include <system_error>

namespace b3dgs {
namespace {

/// Removes the next number, and everything before it, from `text`.
std::optional<std::size_t> take_number(std::string_view& text) {
  const std::size_t begin = text.find_first_of("0123456789");
  if (begin == std::string_view::npos) return std::nullopt;
  text.remove_prefix(begin);
  std::size_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  if (error != std::errc()) return std::nullopt;
  return value;
}

/// What follows `words` in the line.
std::optional<std::string_view> text_after(std::string_view line, std::string_view words) {
  const std::size_t at = line.find(words);
  if (at == std::string_view::npos) return std::nullopt;
  return line.substr(at + words.size());
}

/// "3/50" as {3, 50}.
std::optional<ColmapStep> take_share(std::string_view& text) {
  const auto done = take_number(text);
  const auto total = take_number(text);
  if (!done || !total) return std::nullopt;
  return ColmapStep{*done, *total};
}

}  // namespace

std::optional<ColmapStep> colmap_step(std::string_view line) {
  for (const char* words : {"Processed file [", "Matching image [", "Processing image ["}) {
    if (auto rest = text_after(line, words)) return take_share(*rest);
  }
  for (const char* words : {"Matching block [", "Processing block ["}) {
    auto rest = text_after(line, words);
    if (!rest) continue;
    const auto row = take_share(*rest), column = take_share(*rest);
    if (!row || !column || row->done == 0) return std::nullopt;
    return ColmapStep{(row->done - 1) * column->total + column->done, row->total * column->total};
  }
  if (auto rest = text_after(line, "Registering image #")) {
    const std::size_t bracket = rest->rfind('(');
    if (bracket == std::string_view::npos) return std::nullopt;
    rest->remove_prefix(bracket);
    if (const auto done = take_number(*rest)) return ColmapStep{*done, 0};
  }
  return std::nullopt;
}

std::optional<std::size_t> colmap_camera(std::string_view line) {
  auto rest = text_after(line, "Camera:");
  if (!rest || rest->find('#') == std::string_view::npos) return std::nullopt;
  return take_number(*rest);
}

}  // namespace b3dgs
