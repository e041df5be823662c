// A fuzz target over files, for ctest and without libFuzzer: FUZZ_TARGET [--accepted FOLDER] [FILE|FOLDER]...
// Each file has to be taken or refused with an InputError; those of the folder after --accepted have to be taken.
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

/// Whether all went as it should.
bool run_file(const fs::path& path, bool has_to_be_taken) {
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    std::cerr << path.string() << ": cannot be opened\n";
    return false;
  }
  const std::string bytes{std::istreambuf_iterator<char>(file), {}};
  // Exactly as long as the input, so that the address sanitizer sees what is read beyond it.
  const std::vector<char> exact(bytes.begin(), bytes.end());
  try {
    const bool taken = b3dgs::fuzz::takes_input({exact.data(), exact.size()});
    if (has_to_be_taken && !taken) {
      try {
        b3dgs::fuzz::read_input({exact.data(), exact.size()});
      } catch (const b3dgs::InputError& error) {
        std::cerr << path.string() << ": refused: " << error.what() << "\n";
      }
    }
    return taken || !has_to_be_taken;
  } catch (const std::exception& error) {
    std::cerr << path.string() << ": an error of another kind: " << error.what() << "\n";
    return false;
  }
}

}  // namespace

int main(int argc, char** argv) {
  int n_files = 0, n_faults = 0;
  for (int i = 1; i < argc; ++i) {
    const bool has_to_be_taken = std::string(argv[i]) == "--accepted" && i + 1 < argc;
    if (has_to_be_taken) ++i;
    for (const fs::path& path : files_of(argv[i])) {
      ++n_files;
      n_faults += run_file(path, has_to_be_taken) ? 0 : 1;
    }
  }
  std::cout << n_files << " files, " << n_faults << " faults\n";
  return n_files > 0 && n_faults == 0 ? 0 : 1;
}
