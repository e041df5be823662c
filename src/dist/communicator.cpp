#include "dist/communicator.h"

#include <c10/util/accumulate.h>
#include <signal.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <set>
#include <utility>

#include "core/check.h"
#if B3DGS_TORCH_CUDA
#include "core/cuda_check.h"
#endif
#include "dist/control/rank_link.h"
#include "dist/control/socket.h"

namespace b3dgs {
namespace {

/// The same memory as a 1-D tensor of another type: c10d's groups differ in which types they know.
torch::Tensor as_type(const torch::Tensor& tensor, torch::ScalarType type) {
  const std::int64_t size = static_cast<std::int64_t>(torch::elementSize(type));
  const bool is_aligned = tensor.storage_offset() * static_cast<std::int64_t>(tensor.element_size()) % size == 0;
  return (is_aligned ? tensor : tensor.clone()).view({tensor.numel()}).view(type);
}

std::int64_t sum_of(const std::vector<std::int64_t>& counts) {
  return std::accumulate(counts.begin(), counts.end(), std::int64_t{0});
}

torch::Tensor empty_rows_like(const torch::Tensor& rows, std::int64_t n) {
  std::vector<std::int64_t> shape = rows.sizes().vec();
  shape[0] = n;
  return torch::empty(shape, rows.options());
}

/// What an all-to-all counts. c10d (1.13) counts no further than 2^31 - 1, so the largest type that divides a row.
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

/// What tells a GPU from all others, on all machines; empty for the CPU.
std::string identity_of([[maybe_unused]] const torch::Device& device) {
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) {
    cudaDeviceProp properties{};
    B3DGS_CUDA_CHECK(cudaGetDeviceProperties(&properties, device.index()));
    return {properties.uuid.bytes, sizeof properties.uuid.bytes};
  }
#endif
  return "";
}

/// The listening socket of rank 0; none on the others.
Socket prepare_to_listen(const RankPlace& place) {
  if (place.rank != 0) return {};
  if (place.listening_socket >= 0) return Socket(place.listening_socket);
  return listen_at(place.address, place.port);
}

/// Gloo writes to sockets without MSG_NOSIGNAL, since Python ignores SIGPIPE: by default, a rank whose peer has ended
/// would be killed before it could say which one. A handler of the program stays.
void ignore_broken_pipes() {
  struct sigaction current {};
  if (sigaction(SIGPIPE, nullptr, &current) == 0 && current.sa_handler == SIG_DFL) signal(SIGPIPE, SIG_IGN);
}

}  // namespace

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
  Socket listening = prepare_to_listen(place);
  if (place.rank == 0) {
    communicator->hub_ = std::make_unique<RankHub>(std::move(listening), place.size, place.job, limits);
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
  const std::vector<std::string> kinds = exchange("device", c10::DeviceTypeName(device_.type(), /*lower_case=*/true));
  for (int r = 1; r < size_; ++r) {
    const std::string& kind = kinds[static_cast<std::size_t>(r)];
    if (kind == kinds[0]) continue;
    input_error("rank ", r, " of ", size_, " uses the device ", kind, ", but rank 0 ", kinds[0],
                "; name the same device on all ranks (--device)");
  }
  transport_ = fastest_transport(device_);
  const std::vector<Transport> fastest = exchange_record("transport", transport_);
  const bool is_same = std::count(fastest.begin(), fastest.end(), transport_) == size_;
  if (device_.is_cuda()) {
    const std::string own = identity_of(device_);
    const std::vector<std::string> gpus = exchange("GPU", own);
    n_on_own_gpu_ = static_cast<int>(std::count(gpus.begin(), gpus.end(), own));
    shares_gpus_ = std::set<std::string>(gpus.begin(), gpus.end()).size() < gpus.size();
  }
  if (relays || !is_same || shares_gpus_) transport_ = Transport::kRelay;
}

std::vector<std::string> Communicator::exchange(const std::string& label, const std::string& bytes) {
  if (size_ == 1) return {bytes};
  return link_->exchange(label, {bytes});
}

std::int64_t Communicator::max(const std::string& label, std::int64_t value) {
  const std::vector<std::int64_t> values = exchange_record(label, value);
  return *std::max_element(values.begin(), values.end());
}

void Communicator::barrier(const std::string& label) {
  exchange(label, "");
}

void Communicator::check_rows(const torch::Tensor& rows) const {
  B3DGS_CHECK(rows.dim() >= 1 && rows.is_contiguous() && rows.device() == device_, "tensor ", rows.sizes(), " on ",
              rows.device().str(), ", expected contiguous rows on ", device_.str());
}

torch::Tensor Communicator::all_to_all_rows(const torch::Tensor& rows, const std::vector<std::int64_t>& send,
                                            const std::vector<std::int64_t>& receive) {
  check_rows(rows);
  const auto size = static_cast<std::size_t>(size_), rank = static_cast<std::size_t>(rank_);
  B3DGS_CHECK(
      send.size() == size && receive.size() == size && sum_of(send) == rows.size(0) && send[rank] == receive[rank],
      sum_of(send), " rows to send, ", rows.size(0), " given");
  if (size_ == 1) return rows;
  const Unit unit(rows);
  const torch::Tensor received = empty_rows_like(rows, sum_of(receive));
  group_->all_to_all(as_type(received, unit.type), unit.counts(receive), as_type(rows, unit.type), unit.counts(send));
  return received;
}

torch::Tensor Communicator::all_gather_rows(const torch::Tensor& rows) {
  check_rows(rows);
  if (size_ == 1) return rows;
  if (rows.size(0) == 0) {
    throw_if_failed();
    return rows;
  }
  if (device_.is_cuda()) {
    const torch::Tensor all = empty_rows_like(rows, rows.size(0) * size_);
    group_->all_gather(as_type(all, torch::kUInt8), as_type(rows, torch::kUInt8));
    return all;
  }
  // Gloo gathers in a ring with copies. Sending the rows to each rank is as many bytes.
  std::vector<std::int64_t> shape(static_cast<std::size_t>(rows.dim()), 1);
  shape[0] = size_;
  const std::vector<std::int64_t> counts(static_cast<std::size_t>(size_), rows.size(0));
  return all_to_all_rows(rows.repeat(shape), counts, counts);
}

void Communicator::stop_others(const std::string& cause) noexcept {
  if (link_) link_->fail(cause);
}

void Communicator::throw_if_failed() {
  if (link_) link_->throw_if_failed();
}

}  // namespace b3dgs
