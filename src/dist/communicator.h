// Communication between the processes (ranks) of one training.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <cstring>
#include <exception>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "dist/control/rank_link.h"
#include "dist/launch/start_ranks.h"
#include "dist/tensor_group.h"

namespace b3dgs {

/// Returns the sizes of a tensor that has n rows shaped like those of `rows`.
std::vector<std::int64_t> sizes_with_rows(const torch::Tensor& rows, std::int64_t n);

/// All ranks call the same functions in the same order. Every function throws a PeerError within 30 s after another
/// rank has failed. A rank fails if it calls stop_others(), destroys its Communicator because of an exception, ends, or
/// is silent.
///
/// There is no floating-point reduction, because its result would depend on the number of ranks. Gather instead, then
/// add in a fixed order.
///
/// Small host messages (exchange() and functions that use it) go through a TCP connection to rank 0, and tensors by
/// Transport. With NCCL, functions for tensors do not wait on the host, but the current stream does.
class Communicator {
 public:
  /// Returns the only rank of 1. Every function returns its input, and nothing is connected.
  static std::unique_ptr<Communicator> alone();

  /// Joins the other ranks. Returns alone() if place.size is 1. Otherwise SIGPIPE is ignored from now on, unless the
  /// program handles it.
  /// @param device  device of the tensors: the CPU, or this rank's GPU, with index
  /// @param relays  always send tensors through rank 0; must be the same on all ranks
  /// @throws InputError if the ranks' devices differ, the address is not available or this rank is refused
  static std::unique_ptr<Communicator> connect(RankPlace place, const torch::Device& device,
                                               const RankLimits& limits = {}, bool relays = false);

  /// Tells the others if an exception is the reason. Otherwise rank 0 waits here until all ranks have finished.
  ~Communicator();
  Communicator(const Communicator&) = delete;
  Communicator& operator=(const Communicator&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }
  bool is_first() const { return rank_ == 0; }
  const torch::Device& device() const { return device_; }

  /// Returns how tensors travel. The same on all ranks.
  Transport transport() const { return transport_; }
  /// Returns whether any ranks share a GPU. The same on all ranks.
  bool shares_gpus() const { return shares_gpus_; }
  /// Returns the number of ranks that use the GPU of this one, including it. 1 on a CPU.
  int n_on_own_gpu() const { return n_on_own_gpu_; }

  // Messages on the host. `label` names the exchange and must be the same on all ranks, otherwise all of them fail.

  /// Returns the bytes of every rank, by rank.
  std::vector<std::string> exchange(const std::string& label, const std::string& bytes) {
    return size_ == 1 ? std::vector{bytes} : link_->exchange(label, {bytes});
  }

  /// The same for a struct of numbers.
  template <class Record>
  std::vector<Record> exchange_record(const std::string& label, const Record& record) {
    static_assert(std::is_trivially_copyable_v<Record>);
    std::vector<Record> records;
    for (const std::string& bytes :
         exchange(label, std::string(reinterpret_cast<const char*>(&record), sizeof record))) {
      B3DGS_CHECK(bytes.size() == sizeof(Record), label);
      std::memcpy(&records.emplace_back(), bytes.data(), sizeof(Record));
    }
    return records;
  }

  std::int64_t max(const std::string& label, std::int64_t value);
  void barrier(const std::string& label) { exchange(label, ""); }

  // Tensors are contiguous, of any type, on the device of connect(). Rows are along the first dimension. All ranks must
  // use the same type and the same other dimensions. Results are new tensors, except that all_to_all_rows() of one rank
  // returns its input.

  /// Sends the first send[0] rows to rank 0, the next send[1] to rank 1, and so on. Returns the received rows,
  /// receive[r] from rank r, in this order.
  torch::Tensor all_to_all_rows(const torch::Tensor& rows, const std::vector<std::int64_t>& send,
                                const std::vector<std::int64_t>& receive);

  /// Returns the rows of all ranks in the order of the ranks, counts[r] from rank r.
  torch::Tensor all_gather_rows(const torch::Tensor& rows, const std::vector<std::int64_t>& counts);

  /// Tells the others that this rank stops. Afterwards, only the destructor may be called.
  void stop_others(const std::string& cause) noexcept {
    if (link_) link_->fail(cause);
  }

  /// @throws PeerError if another rank is known to have failed
  void throw_if_failed() {
    if (link_) link_->throw_if_failed();
  }

 private:
  Communicator() = default;
  /// Compares the devices of all ranks, and chooses the transport.
  void agree_on_transport(bool relays);

  int rank_ = 0, size_ = 1;
  torch::Device device_ = torch::kCPU;
  Transport transport_ = Transport::kRelay;
  bool shares_gpus_ = false;
  int n_on_own_gpu_ = 1;
  int n_exceptions_ = std::uncaught_exceptions();
  std::unique_ptr<RankHub> hub_;  // only on rank 0
  std::unique_ptr<RankLink> link_;
  std::unique_ptr<TensorGroup> group_;
};

/// Calls body(). If it throws, tells the other ranks why before the exception continues. If another rank failed before,
/// throws that PeerError instead, because errors after a failed exchange are consequences. A PeerError waits for the
/// last message of the rank that failed.
template <class Body>
auto run_as_rank(Communicator& communicator, Body&& body) {
  try {
    return body();
  } catch (const PeerError& error) {
    try {
      communicator.barrier("the end of a rank that failed");
    } catch (const PeerError& last) {
      const bool says_more = std::string(error.what()).rfind(last.what(), 0) == 0;
      if (!says_more) throw;
    }
    throw PeerError(error);
  } catch (const std::exception& error) {
    communicator.throw_if_failed();
    communicator.stop_others(error.what());
    throw;
  }
}

}  // namespace b3dgs
