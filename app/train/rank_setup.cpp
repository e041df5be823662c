#include "app/train/rank_setup.h"

#include <omp.h>
#include <sched.h>
#include <torch/cuda.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <csignal>
#include <fstream>
#include <optional>

#include "core/check.h"
#if B3DGS_TORCH_CUDA
#include <c10/cuda/CUDAFunctions.h>
#endif

namespace b3dgs {
namespace {

/// The value of --gpus. 0: auto
int parse_gpus(const std::string& text) {
  if (text == "auto") return 0;
  int n = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), n);
  if (error != std::errc() || end != text.data() + text.size() || n < 1 || n > kMaxStartedRanks) {
    input_error("invalid value for --gpus (expected auto, or a whole number from 1 to ", kMaxStartedRanks, "): ", text);
  }
  return n;
}

/// @throws InputError if this machine has fewer than n, or none if they may be shared
void require_gpus(const RankOptions& options, int n, int n_gpus, bool may_share) {
  if (n <= n_gpus || (may_share && n_gpus > 0)) return;
  std::string reason = "this build has no CUDA support (needs nvcc and a LibTorch with CUDA); use";
#if B3DGS_TORCH_CUDA
  reason = n_gpus == 0 ? "no GPU found, or its driver does not respond; use"
                       : detail::concat("this machine has ", n_gpus, n_gpus == 1 ? " GPU" : " GPUs",
                                        ", each rank needs one; use fewer ranks, or --ranks ", n,
                                        " --device cuda to share, or");
#endif
  input_error(options.as_words().substr(1), ": ", reason, " the CPU: --ranks ", n, " --device cpu");
}

std::string machine_name() {
  std::string name;
  std::ifstream("/proc/sys/kernel/random/boot_id") >> name;
  std::array<char, 256> host{};
  gethostname(host.data(), host.size() - 1);
  return name + " " + host.data();
}

/// Returns the cores of this process. A launcher may bind ranks to different cores of one machine.
std::string own_cores() {
  cpu_set_t cores;
  CPU_ZERO(&cores);
  sched_getaffinity(0, sizeof cores, &cores);  // fails with more than 1024 cores, so there are none
  return std::string(reinterpret_cast<const char*>(&cores), sizeof cores);
}

}  // namespace

int count_gpus() {
#if B3DGS_TORCH_CUDA
  // Signals are blocked in threads that CUDA starts, which would otherwise receive those that start_ranks() waits for.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, &before);
  const auto n = static_cast<int>(torch::cuda::device_count());
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  return n;
#else
  return 0;
#endif
}

torch::Device choose_rank_device(const std::string& name, const RankPlace& place, int n_gpus, bool may_share) {
  if (name == "cpu") return torch::kCPU;
  if (place.local_rank < n_gpus || (may_share && n_gpus > 0)) {
    return torch::Device(torch::kCUDA, static_cast<c10::DeviceIndex>(place.local_rank % n_gpus));
  }
  if (name == "auto" && n_gpus == 0) return torch::kCPU;
  input_error(
      "rank ", place.rank, " of ", place.size, " needs a GPU of its own (number ", place.local_rank,
      " of this machine), but sees ", n_gpus, n_gpus == 1 ? " GPU" : " GPUs",
      "; let each rank see all GPUs (srun: no --gpus-per-task), or use fewer ranks, or --device cpu, or let ranks "
      "share GPUs, which is slow (--ranks ",
      place.size, " --device cuda)");
}

JoinedRank join_ranks(const RankPlan& plan) {
  const int n_gpus = plan.device_name == "cpu" ? 0 : count_gpus();
  const torch::Device device = choose_rank_device(plan.device_name, plan.place, n_gpus, plan.may_share_gpus);
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) c10::cuda::set_device(device.index());
#endif
  return {device, Communicator::connect(plan.place, device)};
}

MachineShare share_machine(Communicator& ranks) {
  const std::string machine = machine_name() + '\n', own = machine + own_cores();
  MachineShare share{0, 0};
  int n_on_own_cores = 0;
  for (const std::string& other : ranks.exchange("machine", own)) {
    share.n_ranks += other.rfind(machine, 0) == 0 ? 1 : 0;
    n_on_own_cores += other == own ? 1 : 0;
  }
  share.n_cores = std::max(1, omp_get_num_procs() / n_on_own_cores);
  return share;
}

std::string RankOptions::as_words() const {
  if (!gpus.empty()) return " --gpus " + gpus;
  return ranks == 0 ? "" : " --ranks " + std::to_string(ranks);
}

RankPlan plan_ranks(const RankOptions& options, const std::string& device_name) {
  RankPlan plan{RankPlace{}, 0, device_name, options.ranks > 1 && device_name == "cuda"};
  const bool has_gpus = !options.gpus.empty();
  if (options.ranks > 0 && has_gpus) {
    input_error("--ranks and --gpus exclude each other: --gpus starts one rank for each GPU; leave out one of them");
  }
  const int requested = has_gpus ? parse_gpus(options.gpus) : options.ranks;
  if (has_gpus && device_name == "cpu") {
    input_error("--gpus ", options.gpus, " and --device cpu exclude each other; use --ranks for processes on a CPU");
  }
  if (options.ranks == 1) return plan;

  const std::optional<RankPlace> launched = choose_rank_place(requested);
  if (launched && launched->size > 1) {
    plan.place = *launched;
    if (has_gpus) plan.device_name = "cuda";
    return plan;
  }
  const int n = options.gpus == "auto" ? count_gpus() : requested;
  if (n > 1) {
    const int n_here = device_name == "cpu" ? 0 : count_gpus();
    if (has_gpus || device_name == "cuda" || n_here > 0) require_gpus(options, n, n_here, plan.may_share_gpus);
    plan.n_to_start = n;
  } else if (requested == 1) {
    require_gpus(options, 1, count_gpus(), false);
    plan.device_name = "cuda";
  }
  return plan;
}

}  // namespace b3dgs
