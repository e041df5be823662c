// What b3dgs-engine and b3dgs-tools have in common: finding the subcommand, and turning exceptions into an error
// message and an exit code.
#pragma once

#include <functional>
#include <string>
#include <vector>

namespace b3dgs {

using RunCommand = int (*)(const std::vector<std::string>& words);

/// Calls `run` with the words of the command line. Returns the exit code of the program.
int run_program(int argc, char** argv, const std::function<int(const std::vector<std::string>& words)>& run);

/// @throws InputError that names a similar command, or all commands
[[noreturn]] void reject_command(const std::string& word);

}  // namespace b3dgs
