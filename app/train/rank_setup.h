// Setup of `b3dgs train` on several ranks: the rank of this process, its device and its number of threads.
#pragma once

#include <torch/types.h>

#include <memory>
#include <string>

#include "dist/communicator.h"
#include "dist/launch/start_ranks.h"

namespace b3dgs {

inline constexpr int kMaxStartedRanks = 1024;

/// Returns the number of this machine's GPUs that this build can use.
int count_gpus();

/// Returns GPU `place.local_rank`, or the CPU. `name` is the value of --device. "auto" is the CPU if this process sees
/// no GPU. @param may_share  with fewer GPUs than ranks, the ranks are distributed among them round-robin @throws
/// InputError if this process sees too few GPUs
torch::Device choose_rank_device(const std::string& name, const RankPlace& place, int n_gpus, bool may_share = false);

/// This rank's share of its machine.
struct MachineShare {
  int n_ranks = 1;  // on this machine
  int n_cores = 1;  // cores that this process may use, divided by the ranks that share them; at least 1
};
/// Determines this rank's share. All ranks call this together.
MachineShare share_machine(Communicator& ranks);

/// --ranks and --gpus, for commands that can also run as one process.
struct RankOptions {
  int ranks = 0;     // 0 = those that a launcher started, or this process alone; 1 = this process alone
  std::string gpus;  // one rank for each: a number, or "auto" for all of this machine; empty: not given

  /// Returns the options for a suggested command line: " --ranks 2", or "" if neither was given.
  std::string as_words() const;
};

/// The tasks of this process.
struct RankPlan {
  RankPlace place;          // size 1: this process alone
  int n_to_start = 0;       // not 0: start this many ranks (start_ranks()), each of which calls plan_ranks()
  std::string device_name;  // --device, with "cuda" instead of "auto" where --gpus demands GPUs
  // If --ranks and --device cuda are both given, several ranks on a GPU are intended.
  bool may_share_gpus = false;
};

/// Reports errors that every rank would have before any is started, so that they appear once. @param device_name  value
/// of --device @throws InputError if the options contradict each other or a launcher, or this build or machine does not
/// support them
RankPlan plan_ranks(const RankOptions& options, const std::string& device_name);

struct JoinedRank {
  torch::Device device;
  std::unique_ptr<Communicator> ranks;
};
/// Chooses the device as choose_rank_device() does, makes a GPU the current device of this thread, and joins the other
/// ranks. @throws InputError as choose_rank_device() and Communicator::connect() do
JoinedRank join_ranks(const RankPlan& plan);

}  // namespace b3dgs
