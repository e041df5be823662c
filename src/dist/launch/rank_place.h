// What the program that started this process says of its place among the others: torchrun, mpirun, srun, or
// start_ranks().
#pragma once

#include <cstdlib>
#include <functional>
#include <optional>
#include <string>

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

}  // namespace b3dgs
