#include "dist/tensor_group.h"

#include <algorithm>
#include <cstring>

#include "core/check.h"

#if B3DGS_GLOO && !defined(USE_C10D_GLOO)
#define USE_C10D_GLOO  // otherwise the header is empty
#endif
#if B3DGS_NCCL && !defined(USE_C10D_NCCL)
#define USE_C10D_NCCL
#endif

#if B3DGS_C10D
#include <torch/csrc/distributed/c10d/Store.hpp>
#include <torch/csrc/distributed/c10d/Types.hpp>
#include <torch/csrc/distributed/c10d/Work.hpp>
#endif
#if B3DGS_GLOO
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#endif
#if B3DGS_NCCL
#include <c10/cuda/CUDAGuard.h>

#include <torch/csrc/distributed/c10d/ProcessGroupNCCL.hpp>
#endif

#include <torch/version.h>

#include <chrono>
#include <cstdlib>
#include <string_view>
#include <utility>

#include "dist/control/socket.h"

namespace b3dgs {

Transport fastest_transport(const torch::Device& device) {
#if B3DGS_NCCL
  if (device.is_cuda()) return Transport::kNccl;
#endif
#if B3DGS_GLOO
  if (device.is_cpu()) return Transport::kGloo;
#endif
  static_cast<void>(device);
  return Transport::kRelay;
}

#if B3DGS_C10D

namespace {

using std::chrono::milliseconds;

/// Gives c10d the key-value table of RankHub. LibTorch's own TCPStore (1.13) listens at all addresses of the machine,
/// and does not notice a rank that has ended.
class LinkStore final : public c10d::Store {
 public:
  explicit LinkStore(RankLink& link) : link_(link) {}

  void set(const std::string& key, const std::vector<std::uint8_t>& value) override {
    link_.request(MessageKind::kSet, {key, {value.begin(), value.end()}});
  }
  std::vector<std::uint8_t> get(const std::string& key) override {
    const std::string value = link_.request(MessageKind::kGet, {key}, timeout_).at(0);
    return {value.begin(), value.end()};
  }
  std::int64_t add(const std::string& key, std::int64_t number) override {
    return std::stoll(link_.request(MessageKind::kAdd, {key, std::to_string(number)}).at(0));
  }
  bool deleteKey(const std::string& key) override { return link_.request(MessageKind::kDelete, {key}).at(0) == "1"; }
  bool check(const std::vector<std::string>& keys) override {
    return std::all_of(keys.begin(), keys.end(), [this](const std::string& key) {
      return link_.request(MessageKind::kCheck, {key}).at(0) == "1";
    });
  }
  std::int64_t getNumKeys() override { throw LogicError("nobody counts keys"); }
  void wait(const std::vector<std::string>& keys) override { wait(keys, timeout_); }
  void wait(const std::vector<std::string>& keys, const milliseconds& limit) override {
    for (const std::string& key : keys) link_.request(MessageKind::kGet, {key}, limit);
  }
  /// Pure virtual in LibTorch since 2.7, does not exist before.
  c10::intrusive_ptr<c10d::Store> clone() { return c10::make_intrusive<LinkStore>(link_); }

 private:
  RankLink& link_;
};

// A rank may wait long for another one that writes a checkpoint. RankLink notices that a rank has failed, so the limit
// of the groups is only for unforeseen cases.
constexpr milliseconds kGroupLimit = std::chrono::hours(24);
constexpr char kCannotConnect[] = "ranks cannot connect to each other";

/// Calls work(). If that fails because another rank has failed, throws the error of that rank. That rank closes its
/// connections to all others, and rank 0 soon knows which one it was.
template <class Work>
auto run_with(RankLink& link, const char* failure, Work&& work) {
  try {
    return work();
  } catch (const Error&) {
    throw;
  } catch (const std::exception& error) {
    link.wait_for_failure(std::chrono::seconds(15));
    link.throw_if_failed();
    throw Error(detail::concat(failure, ": ", error.what()));
  }
}

/// Shared by both kinds of groups. `Group` is a c10d::ProcessGroup (LibTorch 1) or a c10d::Backend (2).
template <class Group>
class C10dGroup : public TensorGroup {
 public:
  C10dGroup(c10::intrusive_ptr<Group> group, RankLink& link) : group_(std::move(group)), link_(link) {}

  void all_to_all(torch::Tensor out, std::vector<std::int64_t> out_counts, torch::Tensor in,
                  std::vector<std::int64_t> in_counts) override {
    link_.throw_if_failed();
    run_with(link_, "exchange between ranks failed",
             [&] { wait(*group_->alltoall_base(out, in, out_counts, in_counts, c10d::AllToAllOptions())); });
  }

 protected:
  virtual void wait(c10d::Work& work) = 0;

  /// Leaks the group if its destructor would wait for a rank that has failed.
  void leak() { static_cast<void>(group_.release()); }

  c10::intrusive_ptr<Group> group_;
  RankLink& link_;
};

#if B3DGS_GLOO
class GlooGroup final : public C10dGroup<c10d::ProcessGroupGloo> {
 public:
  explicit GlooGroup(RankLink& link) : C10dGroup(make(link), link) {}

  ~GlooGroup() override {
    // Its destructor waits for operations, also for those that a failed rank will never complete.
    if (link_.wait_for_failure(milliseconds(0)) || is_waiting_) leak();
  }

 private:
  static c10::intrusive_ptr<c10d::ProcessGroupGloo> make(RankLink& link) {
    const auto options = c10d::ProcessGroupGloo::Options::create(kGroupLimit);
    // Use only the network that leads to rank 0.
    options->devices = {c10d::ProcessGroupGloo::createDeviceForHostname(link.own_address())};
    options->threads = 1;
    return c10::make_intrusive<c10d::ProcessGroupGloo>(c10::make_intrusive<LinkStore>(link), link.rank(), link.size(),
                                                       options);
  }

  void wait(c10d::Work& work) override {
    is_waiting_ = true;
    while (!work.isCompleted()) {
      link_.throw_if_failed();
      try {
        work.wait(std::chrono::seconds(1));
      } catch (const std::exception&) {
        if (work.isCompleted()) throw;  // failed; otherwise the time limit is over
      }
    }
    is_waiting_ = false;
    work.wait();
  }

  bool is_waiting_ = false;  // an operation was given up
};
#endif

#if B3DGS_NCCL
// If LibTorch has no CUDA, scripts/check_torch_cuda.sh type-checks this against the headers of 1.13, so the lines for
// LibTorch 2 are compiled only on GPU machines.
class NcclGroup final : public C10dGroup<c10d::ProcessGroupNCCL> {
 public:
  NcclGroup(const torch::Device& device, RankLink& link) : C10dGroup(make(device, link), link) {
    // Operations that wait for a failed rank never end, and then the host hangs in its next wait for the GPU.
#if TORCH_VERSION_MAJOR >= 2
    link_.on_failure([group = group_] { group->abort(); });
#endif
  }

  ~NcclGroup() override {
    link_.on_failure([] {});
    if (link_.wait_for_failure(milliseconds(0))) {
      leak();
      return;
    }
#if TORCH_VERSION_MAJOR >= 2
    group_->shutdown();
#endif
  }

 private:
  static c10::intrusive_ptr<c10d::ProcessGroupNCCL> make(const torch::Device& device, RankLink& link) {
    // Otherwise NCCL's watchdog would end the process before it can report which rank has failed.
    setenv("TORCH_NCCL_ASYNC_ERROR_HANDLING", "0", /*overwrite=*/0);
    setenv("TORCH_NCCL_ENABLE_MONITORING", "0", /*overwrite=*/0);
    // Without this, NCCL takes the first network that is not the loopback, even on one machine.
    const std::string interface = interface_with(link.own_address());
    if (!interface.empty()) setenv("NCCL_SOCKET_IFNAME", ("=" + interface).c_str(), /*overwrite=*/0);
    const c10::cuda::CUDAGuard guard(device);
    const auto options = c10d::ProcessGroupNCCL::Options::create();
    options->timeout = kGroupLimit;
    auto group = c10::make_intrusive<c10d::ProcessGroupNCCL>(c10::make_intrusive<LinkStore>(link), link.rank(),
                                                             link.size(), options);
#if TORCH_VERSION_MAJOR >= 2
    group->setBoundDeviceId(device);
    group->eagerConnectSingleDevice(device);
#endif
    return group;
  }

  void wait(c10d::Work& work) override {
    work.wait();
  }
};
#endif

}  // namespace

#endif

namespace {

/// Sends every byte through rank 0. It needs no library that a build may lack and, unlike NCCL, supports ranks that
/// share a GPU. On a GPU, the host waits for the current stream, and results are written in it.
class RelayGroup final : public TensorGroup {
 public:
  explicit RelayGroup(RankLink& link) : link_(link) {}

  void all_to_all(torch::Tensor out, std::vector<std::int64_t> out_counts, torch::Tensor in,
                  std::vector<std::int64_t> in_counts) override {
    const torch::Tensor sent = in.to(torch::kCPU);
    const torch::Tensor received = out.is_cpu() ? out : torch::empty_like(out, out.options().device(torch::kCPU));
    std::vector<Bytes> parts = split(sent, in_counts), room = split(received, out_counts);
    const auto own = static_cast<std::size_t>(link_.rank());
    room[own].put(parts[own].take(parts[own].size));
    // Rounds limit the memory of rank 0.
    constexpr std::size_t kRoundBytes = 4 << 20;  // that a rank sends in one message
    const std::size_t limit = std::max<std::size_t>(1, kRoundBytes / parts.size());
    for (bool needs_round = true; needs_round;) {
      // A rank knows only its own parts, so the first byte tells whether its sender needs another round.
      const bool has_more =
          std::any_of(parts.begin(), parts.end(), [&](const Bytes& part) { return part.size > limit; });
      std::vector<std::string> messages;
      for (Bytes& part : parts) {
        messages.emplace_back(1, has_more ? '1' : '0').append(part.take(std::min(limit, part.size)));
      }
      messages = link_.exchange("tensors", std::move(messages));
      needs_round = false;
      for (std::size_t from = 0; from < room.size(); ++from) {
        needs_round = needs_round || messages[from][0] == '1';
        const std::string_view bytes = std::string_view(messages[from]).substr(1);
        B3DGS_CHECK(bytes.size() <= room[from].size, "rank ", from, " sends more than was announced");
        room[from].put(bytes);
      }
    }
    for (const Bytes& rest : room) B3DGS_CHECK(rest.size == 0, "a rank sends less than was announced");
    out.copy_(received);
  }

 private:
  /// Data that has not been sent or received yet.
  struct Bytes {
    char* data;
    std::size_t size;

    /// Removes the first n bytes.
    std::string_view take(std::size_t n) {
      size -= n;
      return {std::exchange(data, data + n), n};
    }
    void put(std::string_view bytes) {
      std::copy(bytes.begin(), bytes.end(), data);
      take(bytes.size());
    }
  };

  static std::vector<Bytes> split(const torch::Tensor& host, const std::vector<std::int64_t>& counts) {
    std::vector<Bytes> parts;
    char* next = static_cast<char*>(host.data_ptr());
    for (const std::int64_t count : counts) {
      parts.push_back({next, static_cast<std::size_t>(count) * host.element_size()});
      next += parts.back().size;
    }
    return parts;
  }

  RankLink& link_;
};

}  // namespace

std::unique_ptr<TensorGroup> make_tensor_group([[maybe_unused]] const torch::Device& device, Transport transport,
                                               RankLink& link) {
  switch (transport) {
    case Transport::kRelay:
      return std::make_unique<RelayGroup>(link);
#if B3DGS_NCCL
    case Transport::kNccl:
      return run_with(link, kCannotConnect, [&] { return std::make_unique<NcclGroup>(device, link); });
#endif
#if B3DGS_GLOO
    case Transport::kGloo:
      return run_with(link, kCannotConnect, [&] { return std::make_unique<GlooGroup>(link); });
#endif
    default:
      throw LogicError("this build lacks the transport");
  }
}

}  // namespace b3dgs
