#include "dist/launch/start_ranks.h"

#include <charconv>
#include <cstdint>
#include <cstring>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr int kMaxRanks = 65536;

/// Returns a port that all ranks of a job can compute, and that other jobs on the machine are unlikely to share (FNV-1a
/// hash). It is below 32768, where Linux begins to take ports for outgoing connections.
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

  /// Returns "" if the variable is not set.
  std::string text(const char* name) const {
    const char* const value = environment_(name);
    return value == nullptr ? "" : value;
  }
  bool has(const char* name) const { return !text(name).empty(); }

  std::string required(const char* name) const {
    if (!has(name)) input_error("environment variable ", name, " is not set (expected from ", launcher_, ")");
    return text(name);
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
  int number(const char* name, int least, int most, int otherwise) const {
    return has(name) ? number(name, least, most) : otherwise;
  }

  RankPlace ranks(const char* rank, const char* size, const char* local_rank) const {
    RankPlace place;
    place.launcher = launcher_;
    place.size = number(size, 1, kMaxRanks);
    place.rank = number(rank, 0, kMaxRanks - 1);
    place.local_rank = number(local_rank, 0, kMaxRanks - 1);
    constexpr char kContradict[] = "environment variables contradict each other: ";
    if (place.rank >= place.size) {
      input_error(kContradict, rank, '=', place.rank, ", but ", size, '=', place.size, " (ranks count from 0)");
    }
    if (place.local_rank > place.rank) {
      input_error(kContradict, local_rank, '=', place.local_rank, ", but ", rank, '=', place.rank);
    }
    return place;
  }

  /// Reads MASTER_ADDR and MASTER_PORT, which mpirun and srun do not set.
  void read_optional_address(bool has_several_machines, RankPlace& place) const {
    place.port = number("MASTER_PORT", 1, 65535, place.job.empty() ? place.port : port_of_job(place.job));
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

/// Reads RANK and WORLD_SIZE, which torchrun, start_ranks() and scripts set.
RankPlace read_torch_variables(const Environment& environment, bool is_own, bool is_torchrun) {
  const Variables variables(environment, is_own        ? "b3dgs --ranks"
                                         : is_torchrun ? "torchrun"
                                                       : "a launcher that sets RANK or WORLD_SIZE");
  RankPlace place = variables.ranks("RANK", "WORLD_SIZE", "LOCAL_RANK");
  place.address = variables.required("MASTER_ADDR");
  place.port = variables.number("MASTER_PORT", 1, 65535);
  if (is_own) {
    place.job = variables.text("B3DGS_JOB");
    place.listening_socket = variables.number("B3DGS_LISTENING_SOCKET", 0, 1 << 20, -1);
    return place;
  }
  // Without the count of restarts, because agents of several machines may count differently. Run IDs are often equal.
  if (is_torchrun) place.job = variables.text("TORCHELASTIC_RUN_ID") + "/" + variables.text("MASTER_PORT");
  // In this case torchrun's agent listens at MASTER_PORT. It could tell the ranks a free port, but only to clients of
  // about the same version of PyTorch.
  if (variables.text("TORCHELASTIC_USE_AGENT_STORE") == "True") place.port = port_of_job(place.job);
  return place;
}

RankPlace read_openmpi_variables(const Environment& environment) {
  const Variables variables(environment, "mpirun");
  RankPlace place = variables.ranks("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_LOCAL_RANK");
  place.job = variables.text("PMIX_NAMESPACE");
  const int n_here = variables.number("OMPI_COMM_WORLD_LOCAL_SIZE", 1, kMaxRanks, place.size);
  variables.read_optional_address(n_here < place.size, place);
  return place;
}

RankPlace read_slurm_variables(const Environment& environment) {
  const Variables variables(environment, "srun");
  const auto first_of = [&](const char* name, const char* otherwise) { return variables.has(name) ? name : otherwise; };
  RankPlace place = variables.ranks("SLURM_PROCID", first_of("SLURM_STEP_NUM_TASKS", "SLURM_NTASKS"), "SLURM_LOCALID");
  place.job = variables.text("SLURM_JOB_ID") + "." + variables.text("SLURM_STEP_ID");
  const int n_machines = variables.number(first_of("SLURM_STEP_NUM_NODES", "SLURM_NNODES"), 1, kMaxRanks, 1);
  variables.read_optional_address(n_machines > 1 && place.size > 1, place);
  return place;
}

}  // namespace

std::optional<RankPlace> read_rank_place(const Environment& environment) {
  const Variables variables(environment, "");
  const bool has_openmpi = variables.has("OMPI_COMM_WORLD_RANK") || variables.has("OMPI_COMM_WORLD_SIZE");
  if (variables.has("RANK") || variables.has("WORLD_SIZE")) {
    const bool is_own = variables.has("B3DGS_JOB"), is_torchrun = variables.has("TORCHELASTIC_RUN_ID");
    const RankPlace place = read_torch_variables(environment, is_own, is_torchrun);
    // mpirun and srun may start torchrun or this program's own launcher on each machine. Their ranks count others.
    if (!has_openmpi || is_own || is_torchrun) return place;
    const RankPlace other = read_openmpi_variables(environment);
    if (place.rank == other.rank && place.size == other.size) return place;
    input_error("environment variables contradict each other: RANK=", place.rank, " of WORLD_SIZE=", place.size,
                ", but OMPI_COMM_WORLD_RANK=", other.rank, " of OMPI_COMM_WORLD_SIZE=", other.size,
                "; unset those of the launcher that is not used");
  }
  if (has_openmpi) return read_openmpi_variables(environment);
  // A batch script of SLURM also has SLURM_PROCID and the number of tasks. Only srun sets SLURM_STEP_ID.
  if (variables.has("SLURM_PROCID") && variables.has("SLURM_STEP_ID")) return read_slurm_variables(environment);
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
