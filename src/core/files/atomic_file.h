// Atomic file writes. A temporary file in the target's folder is written, fsynced and renamed over the target, so a
// reader never sees a partly written file.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string_view>

#include "core/stop_signals.h"

namespace b3dgs {

/// Returns a number for where process IDs mean the same processes: this start of this machine, and this container.
unsigned process_space();

/// Returns a name for a temporary file or folder in `folder`, which is removed as left behind once this process has
/// ended. It is not derived from a target's name, which may have the maximum length.
std::filesystem::path temporary_name(const std::filesystem::path& folder);

class AtomicFile {
 public:
  /// Opens a temporary file in the target's folder. If that folder is missing, creates it and syncs it and its parent.
  /// Removes temporary files that killed processes left in the folder. @throws IoError
  explicit AtomicFile(std::filesystem::path target);
  /// Removes the temporary file unless commit() has renamed it.
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Appends bytes. @throws IoError with the target, the number of bytes and the reason (disk full, ...)
  void write(const void* data, std::size_t bytes);
  void write(std::string_view text) { write(text.data(), text.size()); }

  /// Overwrites bytes that were written before, starting at `offset`. @throws IoError
  void rewrite(std::uint64_t offset, const void* data, std::size_t bytes);

  /// Returns the temporary file, for another program that writes it in place.
  const std::filesystem::path& temporary() const { return temporary_; }

  /// Fsyncs the file, renames it over the target, and fsyncs the folder. In a folder that tracks its files
  /// (own_files.h), a user's file at the target is moved aside first. @throws IoError
  void commit();

 private:
  std::filesystem::path target_, temporary_;
  std::optional<RemovedBySignal> removed_by_signal_;  // the temporary file
  std::uint64_t size_ = 0;                            // bytes
  int file_ = -1;
};

/// Writes a file atomically. @throws IoError
void write_file(const std::filesystem::path& path, std::string_view content);

/// Checks that `file` can be made or replaced, before long work whose result goes there. Leaves nothing behind.
/// `remedy` tells the user what to do if not. @throws InputError
void require_writable(const std::filesystem::path& file, std::string_view remedy);

/// Creates a folder and its missing parents, and syncs them to disk. @throws IoError
void create_folder(const std::filesystem::path& folder);

/// Removes temporary files that killed processes left in `folder` and its subfolders. Files of this machine and
/// container are removed if their process has ended, others after a day without a change. No AtomicFile of this process
/// may be open there. Files that cannot be removed are skipped.
void remove_unfinished_files(const std::filesystem::path& folder);

}  // namespace b3dgs
