// Starts the ranks of a job on this machine, for users without torchrun, mpirun or srun.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <string>
#include <vector>

namespace b3dgs {

struct StartOptions {
  std::string program = "/proc/self/exe";
  std::string address = "127.0.0.1";       // rank 0 listens here, at a free port
  std::chrono::milliseconds grace{20000};  // after one rank has failed, the others are given this time to end
};

/// Runs `program words...` as `size` processes with the environment that read_rank_place() reads, and waits for them.
/// SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1 and SIGUSR2 are passed on to all of them; standard input is empty. If this
/// process dies, they get SIGTERM. After one has failed, those that have not ended after `grace` are killed. Ranks that
/// are killed, here or by a signal that was not passed on, are named on standard error.
/// Call this while the process has a single thread.
/// @return 0, or the exit status of the rank that failed first: 128 + signal if a signal ended it. Ranks that ended
/// only because another one failed (PeerError::kExitCode) come last.
/// @throws InputError if `address` cannot be bound, IoError if a process cannot be started
int start_ranks(int size, const std::vector<std::string>& words, const StartOptions& options = {});

}  // namespace b3dgs
