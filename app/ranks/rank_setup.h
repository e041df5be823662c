// What commands on several ranks have in common: which rank this process is, on which device, with how many threads.
#pragma once

#include <torch/types.h>

#include <memory>
#include <string>

#include "dist/communicator.h"
#include "dist/launch/rank_place.h"

namespace b3dgs {

inline constexpr int kMaxStartedRanks = 1024;

/// Number of this machine's GPUs that this build can use.
int count_gpus();

/// GPU `place.local_rank`, or the CPU. `name` is the value of --device: "auto" is a GPU if this machine has that many.
/// @throws InputError if "cuda" is given and this machine has fewer GPUs
torch::Device choose_rank_device(const std::string& name, const RankPlace& place);

/// choose_rank_device(), joins the other ranks, and makes the GPU the current device of this thread.
/// @throws InputError as both do
struct JoinedRank {
  torch::Device device;
  std::unique_ptr<Communicator> ranks;
};
JoinedRank join_ranks(const std::string& device_name, const RankPlace& place);

/// What of this machine is for one rank.
struct MachineShare {
  int n_ranks = 1;  // on this machine
  int n_cores = 1;  // cores that this process may use, divided by the ranks that run on the same ones; at least 1
};
/// All ranks call this together.
MachineShare share_machine(Communicator& ranks);

/// The options --ranks and --gpus of a command that also runs alone.
struct RankOptions {
  int ranks = 0;     // 0 = those that a launcher started, or this process alone; 1 = this process alone
  std::string gpus;  // one rank for each: a number, or "auto" for all of this machine; empty: not given

  /// For a command line that repeats this one: " --ranks 2"; empty if neither was given.
  std::string as_words() const;
};

/// What this process is to do.
struct RankPlan {
  RankPlace place;          // size 1: this process alone
  int n_to_start = 0;       // not 0: it starts so many ranks (start_ranks()), which come here again
  std::string device_name;  // --device, with "cuda" instead of "auto" where --gpus demands GPUs
};

/// Checks before ranks are started what all of them would fail at, so that the error is one line.
/// @param device_name  value of --device
/// @throws InputError if the options contradict each other or a launcher, or this build or machine cannot do it
RankPlan plan_ranks(const RankOptions& options, const std::string& device_name);

}  // namespace b3dgs
