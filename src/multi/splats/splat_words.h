// Format of splats that are exchanged between ranks. Each is a row of 32-bit words, where the Gaussian's index among
// the rank's own rows is replaced by that in the whole model. The functions here give the same results on CPU and GPU.
#pragma once

#include <cstddef>
#include <cstdint>

#include "config/batch_steps.h"
#include "core/vec.h"
#include "raster/args.h"

namespace b3dgs {

// Columns of an exchanged row: Splat, its extent, its radius.
inline constexpr std::int64_t kSplatWords = sizeof(Splat) / sizeof(std::int32_t);
inline constexpr std::int64_t kGaussianColumn = offsetof(Splat, gaussian) / sizeof(std::int32_t);
inline constexpr std::int64_t kExtentColumn = kSplatWords, kRadiusColumn = kExtentColumn + 2;
inline constexpr std::int64_t kRowWords = kRadiusColumn + 1;

/// Arguments for packing the splats of a rank into rows of words.
struct PackSplatsArgs {
  std::int64_t n_splats = 0;                 // M
  const std::int32_t* splats = nullptr;      // [M, kSplatWords]
  const std::int32_t* extents = nullptr;     // [M, 2]
  const std::int32_t* radii = nullptr;       // [M]
  const std::int32_t* model_rows = nullptr;  // [own rows] index in the model of each
  std::int32_t* words = nullptr;             // [M, kRowWords] out
};

/// Writes word k of the rows.
B3DGS_HD void pack_splat_word(const PackSplatsArgs& args, std::int64_t k) {
  const std::int64_t column = k % kRowWords;
  const std::int64_t row = k / kRowWords;
  std::int32_t word = 0;
  if (column < kSplatWords) {
    word = args.splats[row * kSplatWords + column];
    if (column == kGaussianColumn) word = args.model_rows[word];
  } else if (column < kRadiusColumn) {
    word = args.extents[row * 2 + column - kExtentColumn];
  } else {
    word = args.radii[row];
  }
  args.words[k] = word;
}

/// Arguments for merging the splats of one view, of which each rank has sent a list. They are sorted by Gaussian, as on
/// a single rank.
struct MergeSplatsArgs {
  static constexpr int kMaxLists =
      kMaxBatch;  // the maximum number of ranks, each of which renders at least one view of a step

  const std::int32_t* words = nullptr;  // [rows received, kRowWords]
  int n_lists = 0;
  std::int64_t begin[kMaxLists]{},
      end[kMaxLists]{};             // rows of each list, ascending by Gaussian; no Gaussian is in two lists
  std::int32_t* splats = nullptr;   // [sum of the lists, kSplatWords] out
  std::int32_t* extents = nullptr;  // [.., 2] out
  std::int32_t* radii = nullptr;    // [..] out
  std::int64_t* places = nullptr;   // [..] out: row in `words` of each splat
};

/// Position of a splat before and after merging.
struct MergedPlace {
  std::int64_t row = 0, place = 0;  // in MergeSplatsArgs::words, and in the output
};

/// Returns the position of row i of the concatenated lists.
B3DGS_HD MergedPlace merged_place(const MergeSplatsArgs& args, std::int64_t i) {
  int own = 0;
  for (; i >= args.end[own] - args.begin[own]; ++own) i -= args.end[own] - args.begin[own];
  MergedPlace at{args.begin[own] + i, i};
  const std::int32_t gaussian = args.words[at.row * kRowWords + kGaussianColumn];
  for (int list = 0; list < args.n_lists; ++list) {
    if (list == own) continue;
    std::int64_t low = args.begin[list], high = args.end[list];  // searches the first row that is not before this one
    while (low < high) {
      const std::int64_t middle = low + (high - low) / 2;
      if (args.words[middle * kRowWords + kGaussianColumn] < gaussian) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    at.place += low - args.begin[list];
  }
  return at;
}

/// Writes one word of a merged splat, and with the last word its entry in `places`.
B3DGS_HD void merge_word(const MergeSplatsArgs& args, const MergedPlace& at, std::int64_t column) {
  const std::int32_t word = args.words[at.row * kRowWords + column];
  if (column < kSplatWords) {
    args.splats[at.place * kSplatWords + column] = word;
  } else if (column < kRadiusColumn) {
    args.extents[at.place * 2 + column - kExtentColumn] = word;
  } else {
    args.radii[at.place] = word;
    args.places[at.place] = at.row;
  }
}

namespace cuda {

/// Merges all rows. `n_splats` is the number in all lists. Asynchronous.
void merge_splats(const MergeSplatsArgs& args, std::int64_t n_splats, cudaStream_t stream);

}  // namespace cuda
}  // namespace b3dgs
