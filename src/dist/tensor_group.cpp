#include "dist/tensor_group.h"

#include <algorithm>
#include <cstring>

#include "core/check.h"

#if B3DGS_GLOO && !defined(USE_C10D_GLOO)
#define USE_C10D_GLOO  // the header is empty without it
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
#include <utility>

#include "dist/control/socket.h"

namespace b3dgs {

const char* name_of(Transport transport) {
  switch (transport) {
    case Transport::kNccl:
      return "NCCL";
    case Transport::kGloo:
      return "Gloo";
    case Transport::kRelay:
      return "through rank 0";
  }
  return "";
}

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

std::string to_text(const std::vector<std::uint8_t>& bytes) {
  return {bytes.begin(), bytes.end()};
}
std::vector<std::uint8_t> to_vector(const std::string& text) {
  return {text.begin(), text.end()};
}

/// RankLink's table for c10d. LibTorch's own TCPStore (1.13) listens at all addresses of the machine, and does not
/// notice a rank that has ended.
class LinkStore final : public c10d::Store {
 public:
  explicit LinkStore(RankLink& link) : link_(link) {}

  void set(const std::string& key, const std::vector<std::uint8_t>& value) override { link_.set(key, to_text(value)); }
  std::vector<std::uint8_t> get(const std::string& key) override { return to_vector(link_.get(key, timeout_)); }
  std::int64_t add(const std::string& key, std::int64_t number) override { return link_.add(key, number); }
  bool deleteKey(const std::string& key) override { return link_.remove(key); }
  bool check(const std::vector<std::string>& keys) override { return link_.check(keys); }
  std::int64_t getNumKeys() override { throw LogicError("nobody counts keys"); }
  void wait(const std::vector<std::string>& keys) override { wait(keys, timeout_); }
  void wait(const std::vector<std::string>& keys, const milliseconds& limit) override {
    for (const std::string& key : keys) link_.get(key, limit);
  }
  /// Pure virtual in LibTorch since 2.7, unknown before.
  c10::intrusive_ptr<c10d::Store> clone() { return c10::make_intrusive<LinkStore>(link_); }

 private:
  RankLink& link_;
};

// A rank may wait long for another one that writes a checkpoint. That a rank has failed is found out by RankLink, so
// the groups' own limit is only there for what nobody foresaw.
constexpr milliseconds kGroupLimit = std::chrono::hours(24);

/// For groups whose destructor would wait for a rank that has failed.
template <class Group>
void keep_forever(c10::intrusive_ptr<Group> group) {
  static auto* const groups = new std::vector<c10::intrusive_ptr<Group>>;
  groups->push_back(std::move(group));
}

/// What both kinds of groups share. `Group` is a c10d::ProcessGroup (LibTorch 1) or a c10d::Backend (2).
template <class Group>
class C10dGroup : public TensorGroup {
 public:
  C10dGroup(c10::intrusive_ptr<Group> group, RankLink& link) : group_(std::move(group)), link_(link) {}

  void all_to_all(torch::Tensor out, const std::vector<std::int64_t>& out_counts, torch::Tensor in,
                  const std::vector<std::int64_t>& in_counts) override {
    std::vector<std::int64_t> out_splits = out_counts, in_splits = in_counts;
    run([&] { return group_->alltoall_base(out, in, out_splits, in_splits, c10d::AllToAllOptions()); });
  }

  void all_gather(const torch::Tensor& out, torch::Tensor in) override {
    std::vector<torch::Tensor> ins{in};
    std::vector<std::vector<torch::Tensor>> outs{out.view({link_.size(), in.numel()}).unbind(0)};
    ins[0] = in.view({in.numel()});
    run([&] { return group_->allgather(outs, ins, c10d::AllgatherOptions()); });
  }

 protected:
  /// Starts an operation and waits for it.
  template <class Start>
  void run(Start&& start) {
    link_.throw_if_failed();
    try {
      wait(*start());
    } catch (const PeerError&) {
      throw;
    } catch (const std::exception& error) {
      // A rank that ends closes its connections to all others: who it was, rank 0 knows in a moment.
      link_.wait_for_failure(std::chrono::seconds(15));
      link_.throw_if_failed();
      throw Error(detail::concat("exchange between ranks failed: ", error.what()));
    }
  }

  virtual void wait(c10d::Work& work) = 0;

  c10::intrusive_ptr<Group> group_;
  RankLink& link_;
};

#if B3DGS_GLOO
class GlooGroup final : public C10dGroup<c10d::ProcessGroupGloo> {
 public:
  explicit GlooGroup(RankLink& link) : C10dGroup(make(link), link) {}

  ~GlooGroup() override {
    // Its destructor waits for operations, also for those that a failed rank will never complete.
    if (link_.wait_for_failure(milliseconds(0)) || is_waiting_) keep_forever(std::move(group_));
  }

 private:
  static c10::intrusive_ptr<c10d::ProcessGroupGloo> make(RankLink& link) {
    const auto options = c10d::ProcessGroupGloo::Options::create(kGroupLimit);
    // The network that leads to rank 0, and no other.
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
        if (work.isCompleted()) throw;  // failed; otherwise the time is over
      }
    }
    is_waiting_ = false;
    work.wait();
  }

  bool is_waiting_ = false;  // an operation was given up
};
#endif

#if B3DGS_NCCL
// Where LibTorch has no CUDA, scripts/check_torch_cuda.sh type-checks this against the headers of 1.13, so the lines
// for LibTorch 2 are compiled on GPU machines only.
class NcclGroup final : public C10dGroup<c10d::ProcessGroupNCCL> {
 public:
  NcclGroup(const torch::Device& device, RankLink& link) : C10dGroup(make(device, link), link) {
    // Operations that wait for a rank that has failed never end, and so does the host in its next wait for the GPU.
#if TORCH_VERSION_MAJOR >= 2
    link_.on_failure([group = group_] { group->abort(); });
#endif
  }

  ~NcclGroup() override {
    link_.on_failure([] {});
    if (link_.wait_for_failure(milliseconds(0))) {
      keep_forever(std::move(group_));
      return;
    }
#if TORCH_VERSION_MAJOR >= 2
    group_->shutdown();
#endif
  }

 private:
  static c10::intrusive_ptr<c10d::ProcessGroupNCCL> make(const torch::Device& device, RankLink& link) {
    // NCCL's watchdog would end the process before it can say which rank has failed.
    setenv("TORCH_NCCL_ASYNC_ERROR_HANDLING", "0", /*overwrite=*/0);
    setenv("TORCH_NCCL_ENABLE_MONITORING", "0", /*overwrite=*/0);
    // Without this, NCCL takes the first network that is not the loopback, also on one machine.
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

/// A host tensor for a result; `tensor` itself if it is one.
torch::Tensor host_like(const torch::Tensor& tensor) {
  return tensor.is_cpu() ? tensor : torch::empty_like(tensor, tensor.options().device(torch::kCPU));
}

void write_back(const torch::Tensor& tensor, const torch::Tensor& host) {
  if (!tensor.is_cpu()) tensor.copy_(host);
}

/// Every byte passes rank 0: without a library that a build may lack, and, unlike NCCL, also for ranks that share a
/// GPU. On a GPU, the host waits for the current stream, and results are written in it.
class RelayGroup final : public TensorGroup {
 public:
  explicit RelayGroup(RankLink& link) : link_(link) {}

  void all_to_all(torch::Tensor out, const std::vector<std::int64_t>& out_counts, torch::Tensor in,
                  const std::vector<std::int64_t>& in_counts) override {
    const torch::Tensor sent = in.to(torch::kCPU), received = host_like(out);
    std::vector<Bytes> parts = split(sent, in_counts), room = split(received, out_counts);
    Bytes& own = parts[static_cast<std::size_t>(link_.rank())];
    Bytes& own_room = room[static_cast<std::size_t>(link_.rank())];
    if (own.size > 0) std::memcpy(own_room.data, own.data, own.size);
    own.size = own_room.size = 0;
    exchange("all-to-all of tensors", parts, room);
    write_back(out, received);
  }

  void all_gather(const torch::Tensor& out, torch::Tensor in) override {
    const torch::Tensor sent = in.to(torch::kCPU), received = host_like(out);
    const std::vector<std::int64_t> counts(static_cast<std::size_t>(link_.size()), in.numel());
    exchange("all-gather of tensors", split(sent, {in.numel()}), split(received, counts));
    write_back(out, received);
  }

 private:
  struct Bytes {
    char* data = nullptr;
    std::size_t size = 0;
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

  void exchange(const std::string& label, const std::vector<Bytes>& parts, const std::vector<Bytes>& room);

  RankLink& link_;
};

/// Sends parts[r] to rank r, or the only part to all, and fills room[r] with what comes from rank r.
void RelayGroup::exchange(const std::string& label, const std::vector<Bytes>& parts, const std::vector<Bytes>& room) {
  // Rounds bound the memory of rank 0, and leave time for signs of life. A rank knows only its own parts: each round
  // says whether its sender needs another one.
  constexpr std::size_t kRoundBytes = 4 << 20;  // that a rank sends in a message
  const std::size_t limit = std::max<std::size_t>(1, kRoundBytes / parts.size());
  std::vector<std::size_t> filled(room.size(), 0);
  std::size_t sent = 0;  // of each part, unless it is shorter
  for (bool needs_round = true; needs_round; sent += limit) {
    std::string flag(1, '\0');
    for (const Bytes& part : parts) {
      if (part.size > sent + limit) flag[0] = 1;
    }
    std::vector<std::string> messages(parts.size(), flag);
    for (std::size_t i = 0; i < parts.size(); ++i) {
      if (parts[i].size > sent) messages[i].append(parts[i].data + sent, std::min(limit, parts[i].size - sent));
    }
    needs_round = false;
    const std::vector<std::string> received = link_.exchange(label, messages);
    for (std::size_t from = 0; from < received.size(); ++from) {
      const std::size_t n = received[from].size() - 1;
      needs_round = needs_round || received[from][0] != 0;
      B3DGS_CHECK(n <= room[from].size - filled[from], label, ": rank ", from, " sends more than was announced");
      if (n > 0) std::memcpy(room[from].data + filled[from], received[from].data() + 1, n);
      filled[from] += n;
    }
  }
  for (std::size_t from = 0; from < room.size(); ++from) {
    B3DGS_CHECK(filled[from] == room[from].size, label, ": rank ", from, " sends less than was announced");
  }
}

}  // namespace

std::unique_ptr<TensorGroup> make_tensor_group(const torch::Device& device, Transport transport, RankLink& link) {
  if (transport == Transport::kRelay) return std::make_unique<RelayGroup>(link);
  B3DGS_CHECK(transport == fastest_transport(device), "no ", name_of(transport), " for this device");
  try {
#if B3DGS_NCCL
    if (transport == Transport::kNccl) return std::make_unique<NcclGroup>(device, link);
#endif
#if B3DGS_GLOO
    if (transport == Transport::kGloo) return std::make_unique<GlooGroup>(link);
#endif
  } catch (const Error&) {
    throw;
  } catch (const std::exception& error) {
    link.wait_for_failure(std::chrono::seconds(15));
    link.throw_if_failed();
    throw Error(detail::concat("ranks cannot connect to each other: ", error.what()));
  }
  throw LogicError("no group for this device");
}

}  // namespace b3dgs
