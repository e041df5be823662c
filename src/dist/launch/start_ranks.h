// Reads the rank of this process from the environment of the program that started it: torchrun, mpirun, srun, or
// start_ranks().
#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdlib>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace b3dgs {

/// The rank of this process in a job, and the address of rank 0.
struct RankPlace {
  std::string launcher;               // for messages, such as "torchrun"
  int rank = 0, size = 1;             // 0 <= rank < size
  int local_rank = 0;                 // among the ranks of this machine; on GPUs, the index of the GPU
  std::string address = "127.0.0.1";  // rank 0 listens here
  int port = 29500;                   // 1 .. 65535
  std::string job;                    // equal on all ranks of a job, different for other jobs; may be empty
  int listening_socket = -1;          // rank 0 of start_ranks(): a socket that already listens at address and port
};

/// Returns the value of an environment variable, or nullptr.
using Environment = std::function<const char*(const char* name)>;

/// Returns nullopt if no launcher started this process.
/// @throws InputError naming a variable that is missing, malformed or contradicts another one
std::optional<RankPlace> read_rank_place(const Environment& environment = std::getenv);

/// Returns the rank of this process if the user requests `requested` ranks on this machine (0: as many as a launcher
/// started, or one). If nullopt, the caller must start them (start_ranks()), and they call this again.
/// @throws InputError also if a launcher started a different number
std::optional<RankPlace> choose_rank_place(int requested, const Environment& environment = std::getenv);

// Starts the ranks of a job on this machine, for users without torchrun, mpirun or srun.

struct StartOptions {
  std::string program = "/proc/self/exe";
  std::chrono::milliseconds grace{20000};  // after one rank has failed, time for the others to end
};

/// Runs `program words...` as `size` processes with the environment that read_rank_place() reads, and waits for them.
/// Rank 0 listens at 127.0.0.1, at a free port.
/// Passes SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1 and SIGUSR2 on to all of them. Their standard input is empty. If
/// this process dies, they get SIGTERM. After one has failed, those that have not ended after `grace` are killed.
/// Standard error names ranks that are killed, here or by a signal that was not passed on.
/// Must be called while the process has a single thread.
/// @return 0, or the exit status of the rank that failed first: 128 + signal if a signal ended it. Ranks that ended
/// only because another one failed (PeerError::kExitCode) come last.
/// @throws IoError if a process cannot be started
int start_ranks(int size, const std::vector<std::string>& words, const StartOptions& options = {});

}  // namespace b3dgs
