// Writes small networks as TorchScript files.
#pragma once

#include <torch/script.h>

#include <filesystem>
#include <string>

namespace b3dgs::test {

/// Writes a network. `body` has the indented lines of forward(self, a, b).
inline void write_network(const std::filesystem::path& file, const std::string& body) {
  torch::jit::Module module("Network");
  module.define("def forward(self, a, b):\n" + body + "\n");
  module.save(file.string());
}

}  // namespace b3dgs::test
