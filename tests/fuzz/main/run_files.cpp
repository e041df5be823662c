// Runs a fuzz target on files, without libFuzzer, for ctest: FUZZ_TARGET [--accepted FOLDER] [FILE|FOLDER]... Each file
// has to be accepted, or rejected with an InputError. Those in the folder after --accepted have to be accepted.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <vector>

#include "fuzz/fuzz_target.h"

namespace {

namespace fs = std::filesystem;

std::vector<fs::path> files_of(const fs::path& path) {
  std::vector<fs::path> files;
  if (!fs::is_directory(path)) {
    files.push_back(path);
  } else {
    for (const fs::directory_entry& entry : fs::directory_iterator(path)) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

/// Returns whether the target behaved as expected.
bool run_file(const fs::path& path, bool has_to_be_accepted) {
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    std::cerr << path.string() << ": cannot be opened\n";
    return false;
  }
  const std::string bytes{std::istreambuf_iterator<char>(file), {}};
  // A buffer of the exact size, so that the address sanitizer detects reads beyond its end.
  const std::vector<char> exact(bytes.begin(), bytes.end());
  try {
    const bool is_accepted = b3dgs::fuzz::accepts_input({exact.data(), exact.size()});
    if (has_to_be_accepted && !is_accepted) {
      try {
        b3dgs::fuzz::read_input({exact.data(), exact.size()});
      } catch (const b3dgs::InputError& error) {
        std::cerr << path.string() << ": expected to be accepted, but rejected: " << error.what() << "\n";
      }
    }
    return is_accepted || !has_to_be_accepted;
  } catch (const std::exception& error) {
    std::cerr << path.string() << ": expected an InputError, found: " << error.what() << "\n";
    return false;
  }
}

}  // namespace

int main(int argc, char** argv) {
  int n_files = 0, n_failures = 0;
  for (int i = 1; i < argc; ++i) {
    const bool has_to_be_accepted = std::string(argv[i]) == "--accepted" && i + 1 < argc;
    if (has_to_be_accepted) ++i;
    for (const fs::path& path : files_of(argv[i])) {
      ++n_files;
      n_failures += run_file(path, has_to_be_accepted) ? 0 : 1;
    }
  }
  std::cout << n_files << " files, " << n_failures << " failures\n";
  return n_files > 0 && n_failures == 0 ? 0 : 1;
}
