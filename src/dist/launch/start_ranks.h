// What the program that started this process says of its place among the others: torchrun, mpirun, srun, or
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

/// Place of this process among the ranks of a job, and where rank 0 can be reached.
struct RankPlace {
  std::string launcher;               // for messages: "torchrun"
  int rank = 0, size = 1;             // 0 <= rank < size
  int local_rank = 0;                 // among the ranks of this machine; on GPUs, the index of the GPU
  std::string address = "127.0.0.1";  // rank 0 listens here
  int port = 29500;                   // 1 .. 65535
  std::string job;                    // equal on all ranks of a job, different for others; may be empty
  int listening_socket = -1;          // rank 0 of start_ranks(): a socket that listens at address and port already
};

/// The value of an environment variable, or nullptr.
using Environment = std::function<const char*(const char* name)>;

/// nullopt if no launcher started this process.
/// @throws InputError naming the variable that is missing, malformed or in contradiction to another
std::optional<RankPlace> read_rank_place(const Environment& environment = std::getenv);

/// The place of this process where the user asks for `requested` ranks on this machine (0: as many as a launcher
/// started, or one). nullopt: the caller starts them (start_ranks()), and they come here again.
/// @throws InputError also if a launcher started another number
std::optional<RankPlace> choose_rank_place(int requested, const Environment& environment = std::getenv);

// Starts the ranks of a job on this machine, for users without torchrun, mpirun or srun.

struct StartOptions {
  std::string program = "/proc/self/exe";
  std::chrono::milliseconds grace{20000};  // after one rank has failed, the others are given this time to end
};

/// Runs `program words...` as `size` processes with the environment that read_rank_place() reads, and waits for them.
/// Rank 0 listens at 127.0.0.1, at a free port.
/// SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1 and SIGUSR2 are passed on to all of them; standard input is empty. If this
/// process dies, they get SIGTERM. After one has failed, those that have not ended after `grace` are killed. Ranks that
/// are killed, here or by a signal that was not passed on, are named on standard error.
/// Call this while the process has a single thread.
/// @return 0, or the exit status of the rank that failed first: 128 + signal if a signal ended it. Ranks that ended
/// only because another one failed (PeerError::kExitCode) come last.
/// @throws IoError if a process cannot be started
int start_ranks(int size, const std::vector<std::string>& words, const StartOptions& options = {});

}  // namespace b3dgs
