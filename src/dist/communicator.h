// What several processes (ranks) that work on one job exchange with each other.
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

/// Of a tensor with n such rows.
std::vector<std::int64_t> sizes_with_rows(const torch::Tensor& rows, std::int64_t n);

/// All ranks call the same functions in one order. Every function throws a PeerError within 30 s after another rank has
/// failed: it called stop_others(), destroyed its Communicator because of an exception, ended, or was silent.
///
/// There is no floating-point reduction: its result would depend on the number of ranks. Gather, then add in a fixed
/// order.
///
/// Small records on the host (exchange() and what is built on it) go through a TCP connection to rank 0, tensors by
/// Transport. With NCCL, functions for tensors do not wait on the host: the current stream does.
class Communicator {
 public:
  /// The only rank of 1: every function returns its input, nothing is connected.
  static std::unique_ptr<Communicator> alone();

  /// Joins the other ranks. alone() if place.size is 1; otherwise, SIGPIPE is ignored from here on, unless the program
  /// handles it.
  /// @param device  of the tensors: the CPU, or this rank's GPU, with index
  /// @param relays  send tensors through rank 0 in any case; the same on all ranks
  /// @throws InputError if the ranks' devices differ, the address is not available or this rank is refused
  static std::unique_ptr<Communicator> connect(RankPlace place, const torch::Device& device,
                                               const RankLimits& limits = {}, bool relays = false);

  /// If an exception is the reason, tells the others. Otherwise rank 0 waits here until all ranks have finished.
  ~Communicator();
  Communicator(const Communicator&) = delete;
  Communicator& operator=(const Communicator&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }
  bool is_first() const { return rank_ == 0; }
  const torch::Device& device() const { return device_; }

  /// How tensors travel; the same on all ranks.
  Transport transport() const { return transport_; }
  /// Whether any ranks share a GPU; the same on all ranks.
  bool shares_gpus() const { return shares_gpus_; }
  /// Ranks that use the GPU of this one, including it; 1 on a CPU.
  int n_on_own_gpu() const { return n_on_own_gpu_; }

  // Records on the host. `label` says what is exchanged; it must be the same on all ranks, or all of them fail.

  /// The bytes of every rank, by rank.
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

  // Tensors: contiguous, of any type, on the device of connect(). Rows are along the first dimension; all ranks agree
  // on the type and on the other dimensions. Results are new tensors; all_to_all_rows() of one rank returns its input.

  /// The first send[0] rows go to rank 0, the next send[1] to rank 1, and so on. Returns what comes, receive[r] rows
  /// from rank r, in this order.
  torch::Tensor all_to_all_rows(const torch::Tensor& rows, const std::vector<std::int64_t>& send,
                                const std::vector<std::int64_t>& receive);

  /// The rows of all ranks in the order of the ranks, counts[r] from rank r.
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
  std::unique_ptr<RankHub> hub_;  // of rank 0
  std::unique_ptr<RankLink> link_;
  std::unique_ptr<TensorGroup> group_;
};

/// Calls body(). If it throws, tells the other ranks why before the exception goes on. If another rank has failed
/// before, throws that PeerError instead: what follows a failed exchange is a consequence. A PeerError waits for what
/// the rank that failed says at its end.
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
