#include "core/options/nearest_name.h"

#include <algorithm>

namespace b3dgs {
namespace {

std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substituted = diagonal + (a[i - 1] != b[j - 1]);
      diagonal = row[j];
      row[j] = std::min({substituted, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row[b.size()];
}

}  // namespace

std::string nearest_name(const std::string& name, const std::vector<std::string>& known) {
  if (name.empty()) return "";
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(2, name.size() / 3) + 1;
  for (const std::string& candidate : known) {
    // An abbreviation counts as similar, however short.
    const bool is_abbreviation = name.size() >= 3 && candidate.compare(0, name.size(), name) == 0;
    // So does a name with more words: tile_width for tile, max_num_iterations for iterations.
    const std::size_t longer = candidate.size() + 1;
    const bool is_longer = name.compare(0, longer, candidate + "_") == 0 ||
                           (name.size() > longer && name.compare(name.size() - longer, longer, "_" + candidate) == 0);
    const std::size_t distance = is_abbreviation || is_longer ? 1 : edit_distance(name, candidate);
    if (distance < best_distance) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

std::string name_of_other_trainers(const std::string& name, const std::vector<std::string>& known) {
  struct Names {
    const char *other, *own;
  };
  // The first row whose own name the command knows.
  static constexpr Names kNames[] = {
      {"total_steps", "iterations"},
      {"num_steps", "iterations"},
      {"max_num_iterations", "iterations"},
      {"num_iterations", "iterations"},
      {"output", "model_path"},
      {"output", "folder"},
      {"output_dir", "model_path"},
      {"output_dir", "output"},
      {"output_path", "model_path"},
      {"output_path", "output"},
      {"export_path", "model_path"},
      {"o", "model_path"},
      {"o", "output"},
      {"background", "white_background"},
      {"data", "source_path"},
      {"data_path", "source_path"},
  };
  for (const Names& row : kNames) {
    if (name == row.other && std::find(known.begin(), known.end(), row.own) != known.end()) return row.own;
  }
  return "";
}

}  // namespace b3dgs
