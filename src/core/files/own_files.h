// Tracks which files of a folder this program has written. It removes and replaces no others.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "core/descriptor.h"

namespace b3dgs {

/// Locks a folder while shared files in it are read, changed and written, so that no change of another process or
/// thread is lost. Waits until the lock is free. A thread that has the lock may take it again. The locked file is
/// OwnFiles::kRecord. Does nothing if that file cannot be opened, or on file systems without locks.
class FolderTurn {
 public:
  /// Action if another process does not release the lock within a minute.
  enum class IfLocked {
    kFail,
    kGoOn,  // without the lock, with a warning, and from then on without waiting; a file may then count as the user's
  };
  /// @throws IoError with kFail
  explicit FolderTurn(const std::filesystem::path& folder, IfLocked if_locked = IfLocked::kFail);
  ~FolderTurn();
  FolderTurn(const FolderTurn&) = delete;
  FolderTurn& operator=(const FolderTurn&) = delete;

  /// Replaces the minute, for tests.
  static void set_longest_wait(std::chrono::milliseconds wait);

 private:
  /// Returns false if another process holds the lock.
  bool lock_record(const std::filesystem::path& record, std::chrono::milliseconds wait);

  std::unique_lock<std::recursive_mutex> thread_turn_;
  std::filesystem::path root_;  // empty if this thread already had the lock
  Descriptor file_;
};

/// Returns the path without symbolic links, as far as it exists. Replaces std::filesystem::weakly_canonical(), for the
/// reason in folders.h.
std::filesystem::path real_path(const std::filesystem::path& path);

/// Returns the first of PATH.previous, PATH.previous.2, ... that does not exist.
std::filesystem::path previous_name(const std::filesystem::path& path);

/// The files that the program has written below a folder, with their sizes and modification times, stored in
/// FOLDER/kRecord. A file is the program's own while both match. A file that is not listed, or was changed since,
/// belongs to the user, and so does a symbolic link.
///
/// While an object exists, AtomicFile and make_way() use it for files below its folder: before a file replaces one of
/// the user's, that file is moved aside. If the list cannot be written or is lost, files count as the user's, so
/// nothing is lost. Thread-safe.
class OwnFiles {
 public:
  static constexpr const char* kRecord = ".b3dgs-files";

  /// Reads the list of `folder`, if there is one. Writes nothing.
  explicit OwnFiles(const std::filesystem::path& folder);
  ~OwnFiles();
  OwnFiles(const OwnFiles&) = delete;
  OwnFiles& operator=(const OwnFiles&) = delete;

  /// Returns the folder, with symbolic links followed.
  const std::filesystem::path& root() const { return root_; }

  bool is_own(const std::filesystem::path& file);

  /// Adds a file that the program has just written. `is_growing` means that more lines will be appended. It then stays
  /// the program's own as long as it only grows.
  void add(const std::filesystem::path& file, bool is_growing = false);

  /// Moves a user's file to previous_name(), and reports it. Does nothing if there is no file, or if it is the
  /// program's own. @throws IoError
  void make_way(const std::filesystem::path& file);

  /// Removes a file, or the files in a folder and then the folder, as far as they are the program's own.
  void remove(const std::filesystem::path& path);

  /// Renames a file or a folder in the folder, after make_way() for a file at `to`. Own files stay own.
  /// @throws IoError
  void move(const std::filesystem::path& from, const std::filesystem::path& to);

  /// Returns the object for the innermost folder that contains the file, or null.
  static OwnFiles* of(const std::filesystem::path& file);

  /// Sets the receiver of the lines of make_way(). The default is standard error.
  static void set_reporter(std::function<void(const std::string& line)> report);

 private:
  struct Entry {
    std::uintmax_t bytes = 0;
    std::int64_t changed = 0;  // ns
    bool is_growing = false;
  };

  std::string name_of(const std::filesystem::path& file) const;  // empty: not in the folder
  bool is_recorded(const std::string& name) const;
  bool is_own(const std::string& name);
  void read_record();
  void record(const std::string& name, const Entry* entry);
  void remove_known(const std::filesystem::path& path);

  std::filesystem::path root_, given_;  // with links followed, and as given
  std::map<std::string, Entry> entries_;
  std::mutex mutex_;
};

/// Must be called before a file is written without AtomicFile. Calls OwnFiles::make_way() for its folder, if any.
void make_way(const std::filesystem::path& file);
/// Must be called after the file is written. Calls OwnFiles::add().
void add_own_file(const std::filesystem::path& file);
/// Removes a file if it is the program's own. Returns whether it did.
bool remove_own_file(const std::filesystem::path& file);

}  // namespace b3dgs
