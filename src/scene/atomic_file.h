// Files that appear whole or not at all: written beside the target, fsynced, then renamed.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string_view>

namespace b3dgs {

class AtomicFile {
 public:
  /// Opens a temporary file in the target's folder, which is created if missing. @throws IoError
  explicit AtomicFile(std::filesystem::path target);
  /// Removes the temporary file unless commit() was reached.
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Appends bytes. @throws IoError, naming target, bytes wanted and the system's reason (disk full, ...)
  void write(const void* data, std::size_t bytes);
  void write(std::string_view text) { write(text.data(), text.size()); }

  /// Flushes, fsyncs file and folder, renames over the target. @throws IoError
  void commit();

 private:
  std::filesystem::path target_, temporary_;
  int file_ = -1;
};

/// Writes a whole file atomically.
void write_file(const std::filesystem::path& path, std::string_view content);

}  // namespace b3dgs
