// The model as a whole, of which each rank has some rows: distributed at the start, gathered for PLYs and checkpoints.

#include <set>
#include <vector>

#include "train/checkpoint/checkpoint.h"
#include "train/ranks/rows/move_rows.h"
#include "train/ranks/rows/sharded_rows.h"
#include "train/trainer_impl.h"

namespace b3dgs {

namespace {

/// All tensors with a row per Gaussian.
template <class Visit>
void visit_rows(TrainState& state, Visit&& visit) {
  for (GaussianTensors* group : {&state.gaussians, &state.adam.m, &state.adam.v}) {
    for (torch::Tensor* tensor : group->all()) visit(*tensor);
  }
  visit(state.gaussians.filters);
  for (torch::Tensor* column : state.statistics.all()) visit(*column);
}

/// Tensors on the device that are whole on every rank, and the same.
template <class Visit>
void visit_shared(TrainState& state, Visit&& visit) {
  visit_appearance(state.appearance, [&](const char*, torch::Tensor& tensor) { visit(tensor); });
}
}  // namespace

void Trainer::Impl::keep_own_rows() {
  state.n_of_all_ranks = state.gaussians.size();
  owners = RowOwners::round_robin(ranks->rank(), ranks->size(), state.gaussians.size(), device);
  visit_rows(state, [&](torch::Tensor& tensor) {
    if (tensor.defined()) tensor = own_rows(tensor, owners).to(device);
  });
  visit_shared(state, [&](torch::Tensor& tensor) { tensor = tensor.to(device); });
}

void Trainer::Impl::redistribute_rows() {
  std::vector<torch::Tensor*> rows;
  visit_rows(state, [&](torch::Tensor& tensor) {
    if (tensor.defined()) rows.push_back(&tensor);
  });
  RowOwners after;
  bool has_room = true;
  try {
    after = RowOwners::round_robin(ranks->rank(), ranks->size(), owners.n_rows(), device);
    const torch::TensorOptions bytes = state.gaussians.means.options().dtype(torch::kUInt8);
    const torch::Tensor room = memory->allocate({bytes_to_move_rows(rows, owners, after)}, bytes);
  } catch (const OutOfMemoryError&) {
    has_room = false;
  } catch (const c10::OutOfMemoryError&) {
    has_room = false;
  }
  if (ranks->max("room to move rows", has_room ? 0 : 1) != 0) return;
  is_consistent = false;
  move_rows(*ranks, rows, owners, after);
  owners = after;
  is_consistent = true;
}

GaussianTensors Trainer::Impl::gathered_gaussians() {
  GaussianTensors whole = flushed_state().gaussians;
  const auto gather = [&](torch::Tensor& tensor) {
    if (tensor.defined()) tensor = gather_rows_on_first(*ranks, tensor, owners);
  };
  for (torch::Tensor* tensor : whole.all()) gather(*tensor);
  gather(whole.filters);
  return whole;
}

void Trainer::Impl::write_checkpoint_of_ranks() {
  using TakeBytes = std::function<void(const void*, std::size_t)>;
  const TrainState& own = flushed_state();
  std::set<const void*> rows;  // tensors of which each rank has a part
  visit_rows(state, [&](torch::Tensor& tensor) {
    if (tensor.defined()) rows.insert(tensor.unsafeGetTensorImpl());
  });
  const TakeBytes ignore = [](const void*, std::size_t) {};
  std::vector<OutputWriter::TensorPieces> tensors;
  std::size_t n_read = 0;  // all ranks read all tensors in one order, even if rank 0 cannot write them
  for (const auto& [name, tensor] : checkpoint_tensors(own)) {
    const bool has_part = rows.count(tensor.unsafeGetTensorImpl()) > 0;
    TensorEntry entry{name, tensor.scalar_type(), tensor.sizes().vec()};
    if (has_part) entry.shape[0] = state.n_gaussians();
    tensors.push_back({entry, [this, has_part, &n_read, part = tensor](const TakeBytes& take) {
                         ++n_read;
                         const auto take_rows = [&](const torch::Tensor& piece) {
                           take(piece.data_ptr(), piece.nbytes());
                         };
                         if (has_part) return stream_rows_to_first(*ranks, part, owners, take_rows);
                         take_rows(part.cpu());
                       }});
  }
  if (writes_files()) recorder.write_checkpoint(checkpoint_header(config, own, fingerprint), tensors);
  while (n_read < tensors.size()) tensors[n_read].read(ignore);
}

}  // namespace b3dgs
