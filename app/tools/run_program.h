// What b3dgs-engine and b3dgs-tools have in common: finding the subcommand, and turning exceptions into an error
// message and an exit code.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

struct Command {
  const char* name;
  int (*run)(const std::vector<std::string>& words);
};

/// Runs the command that the first word names, with the others. Returns the exit code of the program.
int run_program(int argc, char** argv, const std::vector<Command>& commands);

}  // namespace b3dgs
