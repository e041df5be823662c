// Collective operations on tensors, by the process groups of LibTorch (c10d), or through rank 0. tensor_group.cpp is
// the only file that knows c10d, and the differences between its versions.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "dist/control/rank_link.h"

namespace b3dgs {

/// All ranks call the same functions in the same order. Tensors are contiguous, and on the group's device. On a CPU,
/// functions return when the results are ready. On a GPU, the current stream waits for them, and with NCCL the host
/// does not.
/// @throws PeerError if another rank has failed. NCCL notices only when the host waits, others in every function.
class TensorGroup {
 public:
  virtual ~TensorGroup() = default;

  /// Exchanges 1-D tensors of uint8, int32 or int64. in_counts[r] elements of `in`, in order, go to rank r, and `out`
  /// receives out_counts[r] elements from rank r. At most 2^31 - 1 elements each.
  virtual void all_to_all(torch::Tensor out, std::vector<std::int64_t> out_counts, torch::Tensor in,
                          std::vector<std::int64_t> in_counts) = 0;
};

/// How tensors travel between ranks.
enum class Transport {
  kNccl,  // from GPU to GPU; each rank needs its own GPU
  kGloo,  // between CPUs
  kRelay  // through the control connections and the memory of rank 0; any device, every build; slow
};

/// Returns the fastest transport that this build has for the device, if each rank has its own device.
Transport fastest_transport(const torch::Device& device);

/// All ranks of the link call this together. @param transport  one that this build has for the device
std::unique_ptr<TensorGroup> make_tensor_group(const torch::Device& device, Transport transport, RankLink& link);

}  // namespace b3dgs
