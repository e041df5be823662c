#include "dist/relay_group.h"

#include <algorithm>
#include <cstring>

#include "core/check.h"

namespace b3dgs {
namespace {

/// A host tensor for a result; `tensor` itself if it is one.
torch::Tensor host_like(const torch::Tensor& tensor) {
  return tensor.is_cpu() ? tensor : torch::empty_like(tensor, tensor.options().device(torch::kCPU));
}

void write_back(const torch::Tensor& tensor, const torch::Tensor& host) {
  if (!tensor.is_cpu()) tensor.copy_(host);
}

}  // namespace

RelayGroup::Bytes RelayGroup::bytes_of(const torch::Tensor& host) {
  return {static_cast<char*>(host.data_ptr()), static_cast<std::size_t>(host.numel()) * host.element_size()};
}

std::vector<RelayGroup::Bytes> RelayGroup::split(const torch::Tensor& host, const std::vector<std::int64_t>& counts) {
  std::vector<Bytes> parts;
  char* next = bytes_of(host).data;
  for (const std::int64_t count : counts) {
    parts.push_back({next, static_cast<std::size_t>(count) * host.element_size()});
    next += parts.back().size;
  }
  return parts;
}

void RelayGroup::all_to_all(torch::Tensor out, const std::vector<std::int64_t>& out_counts, torch::Tensor in,
                            const std::vector<std::int64_t>& in_counts) {
  const torch::Tensor sent = in.to(torch::kCPU), received = host_like(out);
  std::vector<Bytes> parts = split(sent, in_counts), room = split(received, out_counts);
  Bytes& own = parts[static_cast<std::size_t>(link_.rank())];
  Bytes& own_room = room[static_cast<std::size_t>(link_.rank())];
  if (own.size > 0) std::memcpy(own_room.data, own.data, own.size);
  own.size = own_room.size = 0;
  exchange("all-to-all of tensors", parts, room);
  write_back(out, received);
}

void RelayGroup::all_gather(const torch::Tensor& out, torch::Tensor in) {
  const torch::Tensor sent = in.to(torch::kCPU), received = host_like(out);
  const std::vector<std::int64_t> counts(static_cast<std::size_t>(link_.size()), in.numel());
  exchange("all-gather of tensors", {bytes_of(sent)}, split(received, counts));
  write_back(out, received);
}

void RelayGroup::all_reduce_max(torch::Tensor tensor) {
  const torch::Tensor own = tensor.to(torch::kCPU).view({1, tensor.numel()});
  const torch::Tensor all = torch::empty({link_.size(), tensor.numel()}, own.options());
  const std::vector<std::int64_t> counts(static_cast<std::size_t>(link_.size()), tensor.numel());
  exchange("reduction of a tensor", {bytes_of(own)}, split(all, counts));
  tensor.copy_(all.amax(0).view(tensor.sizes()));
}

void RelayGroup::exchange(const std::string& label, const std::vector<Bytes>& parts, const std::vector<Bytes>& room) {
  // Rounds bound the memory of rank 0, and leave time for signs of life. A rank knows only its own parts: each round
  // says whether its sender needs another one.
  const std::size_t limit = std::max<std::size_t>(1, round_bytes_ / parts.size());
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

}  // namespace b3dgs
