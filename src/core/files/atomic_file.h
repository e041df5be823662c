// Files that appear whole or not at all: written beside the target, fsynced, then renamed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string_view>

namespace b3dgs {

class AtomicFile {
 public:
  /// Opens a temporary file in the target's folder, which is created if missing (and then synced, as is the folder
  /// that it is in). @throws IoError
  explicit AtomicFile(std::filesystem::path target);
  /// Removes the temporary file unless commit() was reached.
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Appends bytes. @throws IoError, naming target, bytes wanted and the system's reason (disk full, ...)
  void write(const void* data, std::size_t bytes);
  void write(std::string_view text) { write(text.data(), text.size()); }

  /// Replaces bytes that were written before, from `offset` on. @throws IoError
  void rewrite(std::uint64_t offset, const void* data, std::size_t bytes);

  /// Flushes, fsyncs file and folder, renames over the target. @throws IoError
  void commit();

 private:
  std::filesystem::path target_, temporary_;
  int file_ = -1;

  template <class WriteSome>
  void write_all(const void* data, std::size_t bytes, WriteSome&& write_some);
};

/// Writes a whole file atomically.
void write_file(const std::filesystem::path& path, std::string_view content);

/// Creates a folder and those above it, and syncs the new ones. @throws IoError
void create_folder(const std::filesystem::path& folder);

/// Removes the temporary files of processes that were killed, in `folder` and all below it. No AtomicFile of this
/// process may be open there. What cannot be removed stays.
void remove_unfinished_files(const std::filesystem::path& folder);

}  // namespace b3dgs
