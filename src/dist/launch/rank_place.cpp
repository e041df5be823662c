#include "dist/launch/start_ranks.h"

#include <charconv>
#include <cstdint>
#include <cstring>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr int kMaxRanks = 65536;

/// A port that all ranks of a job can compute, and that other jobs on the machine hardly share (FNV-1a hash). Below
/// 32768, where Linux takes ports for outgoing connections.
int port_of_job(const std::string& job) {
  std::uint64_t hash = 14695981039346656037u;
  for (const char byte : job) hash = (hash ^ static_cast<unsigned char>(byte)) * 1099511628211u;
  return 20000 + static_cast<int>(hash % 9000);
}

/// Reads the variables of one launcher.
class Variables {
 public:
  Variables(const Environment& environment, std::string launcher)
      : environment_(environment), launcher_(std::move(launcher)) {}

  bool has(const char* name) const { return !text(name).empty(); }

  std::string text(const char* name) const {
    const char* const value = environment_(name);
    return value == nullptr ? "" : value;
  }

  std::string required(const char* name) const {
    const std::string value = text(name);
    if (value.empty()) input_error("environment variable ", name, " is not set (expected from ", launcher_, ")");
    return value;
  }

  int number(const char* name, int least, int most) const {
    const std::string word = required(name);
    int value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc() || end != word.data() + word.size() || value < least || value > most) {
      input_error("environment variable ", name, ": expected a whole number from ", least, " to ", most, ", found \"",
                  word.substr(0, 40), '"');
    }
    return value;
  }

  void read_ranks(const char* rank, const char* size, const char* local_rank, RankPlace& place) const {
    place.launcher = launcher_;
    place.size = number(size, 1, kMaxRanks);
    place.rank = number(rank, 0, kMaxRanks - 1);
    place.local_rank = number(local_rank, 0, kMaxRanks - 1);
    if (place.rank >= place.size) {
      input_error("environment variables contradict each other: ", rank, '=', place.rank, ", but ", size, '=',
                  place.size, " (ranks count from 0)");
    }
    if (place.local_rank > place.rank) {
      input_error("environment variables contradict each other: ", local_rank, '=', place.local_rank, ", but ", rank,
                  '=', place.rank);
    }
  }

  /// MASTER_ADDR and MASTER_PORT, which mpirun and srun do not set.
  void read_optional_address(bool has_several_machines, RankPlace& place) const {
    if (has("MASTER_PORT")) {
      place.port = number("MASTER_PORT", 1, 65535);
    } else if (!place.job.empty()) {
      place.port = port_of_job(place.job);
    }
    if (has("MASTER_ADDR")) {
      place.address = text("MASTER_ADDR");
    } else if (has_several_machines) {
      input_error("environment variable MASTER_ADDR is not set: ", launcher_,
                  " started ranks on several machines; set it to the address of rank 0's machine");
    }
  }

 private:
  const Environment& environment_;
  std::string launcher_;
};

/// RANK and WORLD_SIZE, as torchrun, start_ranks() and scripts set them.
RankPlace read_torch_variables(const Environment& environment) {
  const bool is_torchrun = Variables(environment, "").has("TORCHELASTIC_RUN_ID");
  const bool is_own = Variables(environment, "").has("B3DGS_JOB");
  const Variables variables(environment, is_own        ? "b3dgs --ranks"
                                         : is_torchrun ? "torchrun"
                                                       : "a launcher that sets RANK or WORLD_SIZE");
  RankPlace place;
  variables.read_ranks("RANK", "WORLD_SIZE", "LOCAL_RANK", place);
  place.address = variables.required("MASTER_ADDR");
  place.port = variables.number("MASTER_PORT", 1, 65535);
  if (is_own) {
    place.job = variables.text("B3DGS_JOB");
    if (variables.has("B3DGS_LISTENING_SOCKET")) {
      place.listening_socket = variables.number("B3DGS_LISTENING_SOCKET", 0, 1 << 20);
    }
    return place;
  }
  // Without the count of restarts: agents of several machines may count differently. Run identifiers are often equal.
  if (is_torchrun) place.job = variables.text("TORCHELASTIC_RUN_ID") + "/" + variables.text("MASTER_PORT");
  // At MASTER_PORT, torchrun's agent listens then. It could tell the ranks a free port, but only to clients of about
  // the same version of PyTorch.
  if (variables.text("TORCHELASTIC_USE_AGENT_STORE") == "True") place.port = port_of_job(place.job);
  return place;
}

RankPlace read_openmpi_variables(const Environment& environment) {
  const Variables variables(environment, "mpirun");
  RankPlace place;
  variables.read_ranks("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_LOCAL_RANK", place);
  const int on_this_machine = variables.has("OMPI_COMM_WORLD_LOCAL_SIZE")
                                  ? variables.number("OMPI_COMM_WORLD_LOCAL_SIZE", 1, kMaxRanks)
                                  : place.size;
  place.job = variables.text("PMIX_NAMESPACE");
  variables.read_optional_address(on_this_machine < place.size, place);
  return place;
}

RankPlace read_slurm_variables(const Environment& environment) {
  const Variables variables(environment, "srun");
  RankPlace place;
  const char* const size = variables.has("SLURM_STEP_NUM_TASKS") ? "SLURM_STEP_NUM_TASKS" : "SLURM_NTASKS";
  variables.read_ranks("SLURM_PROCID", size, "SLURM_LOCALID", place);
  const char* const nodes = variables.has("SLURM_STEP_NUM_NODES") ? "SLURM_STEP_NUM_NODES" : "SLURM_NNODES";
  const int machines = variables.has(nodes) ? variables.number(nodes, 1, kMaxRanks) : 1;
  place.job = variables.text("SLURM_JOB_ID") + "." + variables.text("SLURM_STEP_ID");
  variables.read_optional_address(machines > 1 && place.size > 1, place);
  return place;
}

void check_same_ranks(const RankPlace& place, const RankPlace& other, const char* rank, const char* size) {
  if (place.rank == other.rank && place.size == other.size) return;
  input_error("environment variables contradict each other: RANK=", place.rank, " of WORLD_SIZE=", place.size, ", but ",
              rank, '=', other.rank, " of ", size, '=', other.size, "; unset those of the launcher that is not used");
}

}  // namespace

std::optional<RankPlace> read_rank_place(const Environment& environment) {
  const Variables variables(environment, "");
  const bool has_torch = variables.has("RANK") || variables.has("WORLD_SIZE");
  const bool has_openmpi = variables.has("OMPI_COMM_WORLD_RANK") || variables.has("OMPI_COMM_WORLD_SIZE");
  // A batch script of SLURM, too, has SLURM_PROCID and the number of tasks; only srun sets SLURM_STEP_ID.
  const bool has_slurm = variables.has("SLURM_PROCID") && variables.has("SLURM_STEP_ID");
  if (has_torch) {
    const RankPlace place = read_torch_variables(environment);
    // mpirun and srun may start torchrun on each machine, and this program's own launcher: their ranks count others.
    const bool is_nested = variables.has("TORCHELASTIC_RUN_ID") || variables.has("B3DGS_JOB");
    if (has_openmpi && !is_nested) {
      check_same_ranks(place, read_openmpi_variables(environment), "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE");
    }
    return place;
  }
  if (has_openmpi) return read_openmpi_variables(environment);
  if (has_slurm) return read_slurm_variables(environment);
  return std::nullopt;
}

std::optional<RankPlace> choose_rank_place(int requested, const Environment& environment) {
  const std::optional<RankPlace> place = read_rank_place(environment);
  if (!place || place->size == 1) {
    if (requested > 1) return std::nullopt;
    return RankPlace{};
  }
  if (requested > 0 && requested != place->size) {
    input_error(requested, " ranks requested, but ", place->launcher, " started ", place->size,
                "; leave the option out, or start the program without ", place->launcher);
  }
  return place;
}

}  // namespace b3dgs
