#include "dist/communicator.h"

#include <c10/util/accumulate.h>
#include <signal.h>

#include <algorithm>
#include <array>
#include <limits>
#include <numeric>
#include <set>
#include <utility>

#include "core/check.h"
#if B3DGS_TORCH_CUDA
#include "core/cuda_check.h"
#endif

namespace b3dgs {
namespace {

/// Returns the same memory as a 1-D tensor of another type, because c10d's groups support different types.
torch::Tensor as_type(const torch::Tensor& tensor, torch::ScalarType type) {
  const std::int64_t size = static_cast<std::int64_t>(torch::elementSize(type));
  const bool is_aligned = tensor.storage_offset() * static_cast<std::int64_t>(tensor.element_size()) % size == 0;
  return (is_aligned ? tensor : tensor.clone()).view({tensor.numel()}).view(type);
}

std::int64_t sum_of(const std::vector<std::int64_t>& counts) {
  return std::accumulate(counts.begin(), counts.end(), std::int64_t{0});
}

/// The unit that an all-to-all counts: the largest type that divides a row. c10d (1.13) counts only to 2^31 - 1.
struct Unit {
  torch::ScalarType type;
  std::int64_t per_row;

  explicit Unit(const torch::Tensor& rows) {
    const auto bytes = c10::multiply_integers(rows.sizes().slice(1)) * static_cast<std::int64_t>(rows.element_size());
    type = bytes % 8 == 0 ? torch::kInt64 : bytes % 4 == 0 ? torch::kInt32 : torch::kUInt8;
    per_row = bytes / static_cast<std::int64_t>(torch::elementSize(type));
  }

  std::vector<std::int64_t> counts(std::vector<std::int64_t> rows) const {
    for (std::int64_t& count : rows) count *= per_row;
    B3DGS_CHECK(sum_of(rows) <= std::numeric_limits<std::int32_t>::max(), "exchange of ", sum_of(rows),
                " numbers at once; exchange fewer rows at a time");
    return rows;
  }
};

/// The data that ranks exchange about their devices.
struct DeviceRecord {
  c10::DeviceType type;
  Transport fastest;
  std::array<char, 16> gpu{};  // unique among all GPUs of all machines
};

DeviceRecord describe(const torch::Device& device) {
  DeviceRecord record{device.type(), fastest_transport(device)};
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) {
    cudaDeviceProp properties{};
    B3DGS_CUDA_CHECK(cudaGetDeviceProperties(&properties, device.index()));
    std::copy_n(properties.uuid.bytes, record.gpu.size(), record.gpu.begin());
  }
#endif
  return record;
}

/// Gloo writes to sockets without MSG_NOSIGNAL, because Python ignores SIGPIPE. By default, a rank whose peer has ended
/// would be killed before it could report which one. A handler of the program is kept.
void ignore_broken_pipes() {
  struct sigaction current {};
  if (sigaction(SIGPIPE, nullptr, &current) == 0 && current.sa_handler == SIG_DFL) signal(SIGPIPE, SIG_IGN);
}

}  // namespace

std::vector<std::int64_t> sizes_with_rows(const torch::Tensor& rows, std::int64_t n) {
  std::vector<std::int64_t> sizes = rows.sizes().vec();
  sizes[0] = n;
  return sizes;
}

std::unique_ptr<Communicator> Communicator::alone() {
  return std::unique_ptr<Communicator>(new Communicator);
}

std::unique_ptr<Communicator> Communicator::connect(RankPlace place, const torch::Device& device,
                                                    const RankLimits& limits, bool relays) {
  std::unique_ptr<Communicator> communicator = alone();
  if (place.size == 1) return communicator;
  ignore_broken_pipes();
  communicator->rank_ = place.rank;
  communicator->size_ = place.size;
  communicator->device_ = device;
  if (place.rank == 0) {
    Socket listening(place.listening_socket);
    if (!listening) listening = listen_at(place.address, place.port);
    communicator->hub_ = start_rank_hub(std::move(listening), place.size, place.job, limits);
  }
  communicator->link_ =
      std::make_unique<RankLink>(place.address, place.port, place.rank, place.size, place.job, limits);
  try {
    communicator->agree_on_transport(relays);
    communicator->group_ = make_tensor_group(device, communicator->transport_, *communicator->link_);
  } catch (const PeerError&) {
    throw;
  } catch (const std::exception& error) {
    communicator->stop_others(error.what());
    throw;
  }
  return communicator;
}

Communicator::~Communicator() {
  if (link_ && std::uncaught_exceptions() > n_exceptions_) link_->fail("an error there");
  group_.reset();
  link_.reset();
  hub_.reset();
}

void Communicator::agree_on_transport(bool relays) {
  const DeviceRecord own = describe(device_);
  const std::vector<DeviceRecord> all = exchange_record("device", own);
  std::set<std::array<char, 16>> gpus;
  for (std::size_t r = 0; r < all.size(); ++r) {
    if (all[r].type != all[0].type) {
      const auto name = [](c10::DeviceType type) { return c10::DeviceTypeName(type, /*lower_case=*/true); };
      input_error("rank ", r, " of ", size_, " uses the device ", name(all[r].type), ", but rank 0 ", name(all[0].type),
                  "; name the same device on all ranks (--device)");
    }
    relays |= all[r].fastest != own.fastest;
    gpus.insert(all[r].gpu);
  }
  if (device_.is_cuda()) {
    n_on_own_gpu_ = static_cast<int>(
        std::count_if(all.begin(), all.end(), [&](const DeviceRecord& other) { return other.gpu == own.gpu; }));
    shares_gpus_ = gpus.size() < all.size();
  }
  transport_ = relays || shares_gpus_ ? Transport::kRelay : own.fastest;
}

std::int64_t Communicator::max(const std::string& label, std::int64_t value) {
  const std::vector<std::int64_t> values = exchange_record(label, value);
  return *std::max_element(values.begin(), values.end());
}

torch::Tensor Communicator::all_to_all_rows(const torch::Tensor& rows, const std::vector<std::int64_t>& send,
                                            const std::vector<std::int64_t>& receive) {
  B3DGS_CHECK(rows.dim() >= 1 && rows.is_contiguous() && rows.device() == device_, "tensor ", rows.sizes(), " on ",
              rows.device().str(), ", expected contiguous rows on ", device_.str());
  const auto size = static_cast<std::size_t>(size_), rank = static_cast<std::size_t>(rank_);
  B3DGS_CHECK(
      send.size() == size && receive.size() == size && sum_of(send) == rows.size(0) && send[rank] == receive[rank],
      sum_of(send), " rows to send, ", rows.size(0), " given");
  if (size_ == 1) return rows;
  const Unit unit(rows);
  const torch::Tensor received = torch::empty(sizes_with_rows(rows, sum_of(receive)), rows.options());
  group_->all_to_all(as_type(received, unit.type), unit.counts(receive), as_type(rows, unit.type), unit.counts(send));
  return received;
}

torch::Tensor Communicator::all_gather_rows(const torch::Tensor& rows, const std::vector<std::int64_t>& counts) {
  // c10d's own gathering takes the same number of rows from each rank, and Gloo's is slow (a ring with copies). Within
  // a machine, this sends the same number of bytes.
  const std::vector<torch::Tensor> to_each(static_cast<std::size_t>(size_), rows);
  return all_to_all_rows(torch::cat(to_each), std::vector(to_each.size(), rows.size(0)), counts);
}

}  // namespace b3dgs
