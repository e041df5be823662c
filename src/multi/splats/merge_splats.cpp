#include "multi/splats/merge_splats.h"

#include <torch/types.h>

#include "core/check.h"
#include "core/parallel.h"
#include "raster/torch/torch_cuda.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kGrain = 4096;

const std::int32_t* words_of(const torch::Tensor& rows) {
  return static_cast<const std::int32_t*>(rows.data_ptr());
}

}  // namespace

void pack_splats(const ViewSplats& splats, const torch::Tensor& model_rows, const torch::Tensor& words) {
  const PackSplatsArgs args{splats.size(),          words_of(splats.splats), words_of(splats.extents),
                            words_of(splats.radii), words_of(model_rows),    words.data_ptr<std::int32_t>()};
  for_rows<pack_splat_word>(words.is_cuda(), args, args.n_splats * kRowWords);
}

MergedSplats merge_splats(const torch::Tensor& words, const std::vector<RowRange>& lists) {
  B3DGS_CHECK(lists.size() <= MergeSplatsArgs::kMaxLists, lists.size(), " ranks");
  MergeSplatsArgs args;
  std::int64_t n = 0;
  for (const auto& [begin, end] : lists) {
    args.begin[args.n_lists] = begin;
    args.end[args.n_lists++] = end;
    n += end - begin;
  }
  const torch::TensorOptions floats = words.options().dtype(torch::kFloat32);
  MergedSplats merged{
      {torch::empty({n, kSplatWords}, floats), torch::empty({n, 2}, floats), torch::empty({n}, words.options())},
      torch::empty({n}, words.options().dtype(torch::kInt64))};
  args.words = words.data_ptr<std::int32_t>();
  args.splats = static_cast<std::int32_t*>(merged.splats.splats.data_ptr());
  args.extents = static_cast<std::int32_t*>(merged.splats.extents.data_ptr());
  args.radii = merged.splats.radii.data_ptr<std::int32_t>();
  args.places = merged.places.data_ptr<std::int64_t>();
  if (kTorchHasCuda && words.is_cuda()) {
    cuda::merge_splats(args, n, torch_stream());
    return merged;
  }
  parallel_each(n, kGrain, [&](std::int64_t i) {
    const MergedPlace at = merged_place(args, i);
    for (std::int64_t column = 0; column < kRowWords; ++column) merge_word(args, at, column);
  });
  return merged;
}

}  // namespace b3dgs
