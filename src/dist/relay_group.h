// Collective operations on tensors through the control connections: every byte passes rank 0. Slow, but without a
// library that a build may lack, and, unlike NCCL, also for ranks that share a GPU.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "dist/tensor_group.h"

namespace b3dgs {

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
