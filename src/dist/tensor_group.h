// Collective operations on tensors, by the process groups of LibTorch (c10d), or through rank 0. tensor_group.cpp is
// the only file that knows c10d, and the differences between its versions.
#pragma once

#include <torch/types.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "dist/control/rank_link.h"

namespace b3dgs {

/// All ranks call the same functions in one order. Tensors are contiguous, and on the group's device. On a CPU the
/// functions return when the results are there; on a GPU, the current stream waits for them, and with NCCL the host
/// does not. @throws PeerError if another rank has failed. NCCL notices as far as the host waits, others in every
/// function.
class TensorGroup {
 public:
  virtual ~TensorGroup() = default;

  /// 1-D tensors of uint8, int32 or int64: in_counts[r] elements of `in`, in order, go to rank r; `out` takes what
  /// comes, out_counts[r] from rank r. At most 2^31 - 1 elements each.
  virtual void all_to_all(torch::Tensor out, const std::vector<std::int64_t>& out_counts, torch::Tensor in,
                          const std::vector<std::int64_t>& in_counts) = 0;

  /// `out` has `size` times the elements of `in`.
  virtual void all_gather(const torch::Tensor& out, torch::Tensor in) = 0;

  /// Of int64.
  virtual void all_reduce_max(torch::Tensor tensor) = 0;
};

/// How tensors travel between ranks.
enum class Transport {
  kNccl,  // from GPU to GPU; each rank needs one of its own
  kGloo,  // between CPUs
  kRelay  // through the memory of rank 0, from and to any device, in every build; slow
};
/// For messages: "NCCL".
const char* name_of(Transport transport);

/// The fastest one that this build has for the device, if each rank has a device of its own.
Transport fastest_transport(const torch::Device& device);

/// All ranks of the link call this together. @param transport  that this build has for the device
std::unique_ptr<TensorGroup> make_tensor_group(const torch::Device& device, Transport transport, RankLink& link);

// Collective operations on tensors through the control connections: every byte passes rank 0. Slow, but without a
// library that a build may lack, and, unlike NCCL, also for ranks that share a GPU.

/// Tensors on any device. On a GPU, the host waits for the current stream, and results are written in it.
class RelayGroup final : public TensorGroup {
 public:
  /// @param round_bytes  that a rank sends in a message
  explicit RelayGroup(RankLink& link, std::size_t round_bytes = std::size_t{4} << 20)
      : link_(link), round_bytes_(round_bytes) {}

  void all_to_all(torch::Tensor out, const std::vector<std::int64_t>& out_counts, torch::Tensor in,
                  const std::vector<std::int64_t>& in_counts) override;
  void all_gather(const torch::Tensor& out, torch::Tensor in) override;
  void all_reduce_max(torch::Tensor tensor) override;

 private:
  struct Bytes {
    char* data = nullptr;
    std::size_t size = 0;
  };
  static Bytes bytes_of(const torch::Tensor& host);
  static std::vector<Bytes> split(const torch::Tensor& host, const std::vector<std::int64_t>& counts);

  /// Sends parts[r] to rank r, or the only part to all, and fills room[r] with what comes from rank r.
  void exchange(const std::string& label, const std::vector<Bytes>& parts, const std::vector<Bytes>& room);

  RankLink& link_;
  std::size_t round_bytes_;
};

}  // namespace b3dgs
