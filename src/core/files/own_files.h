// Which files of a folder this program has written. It removes and replaces no others.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "core/descriptor.h"

namespace b3dgs {

/// Holds the lock of a folder while shared files in it are read, changed and written, so that no change of another
/// process or thread is lost. Waits until the lock is free. A thread that holds it may take it again. The lock is that
/// of the record OwnFiles::kRecord. It is skipped where the record cannot be opened, and on file systems without locks.
class FolderTurn {
 public:
  /// @throws IoError if another process does not release the lock
  explicit FolderTurn(const std::filesystem::path& folder);
  ~FolderTurn();
  FolderTurn(const FolderTurn&) = delete;
  FolderTurn& operator=(const FolderTurn&) = delete;

 private:
  void lock_record(const std::filesystem::path& record);

  std::unique_lock<std::recursive_mutex> thread_turn_;
  std::filesystem::path root_;  // empty if this thread held the lock before
  Descriptor file_;
};

/// The path without symbolic links, as far as it exists. Instead of std::filesystem::weakly_canonical(), for the reason
/// in folders.h.
std::filesystem::path real_path(const std::filesystem::path& path);

/// The first of PATH.previous, PATH.previous.2, ... that is not taken.
std::filesystem::path previous_name(const std::filesystem::path& path);

/// The files that the program has written below a folder, with their sizes and modification times, kept in
/// FOLDER/kRecord. A file is the program's own while both are as recorded; one that is not recorded, or was
/// changed since, is the user's, and so is a symbolic link.
///
/// While an object exists, AtomicFile and make_way() follow it for files below its folder: what is the user's is moved
/// aside before a file takes its place. A record that cannot be written, or is lost, costs nothing: files are then
/// taken for the user's. Thread-safe.
class OwnFiles {
 public:
  static constexpr const char* kRecord = ".b3dgs-files";

  /// Reads the record of `folder`, if there is one. Writes nothing.
  explicit OwnFiles(const std::filesystem::path& folder);
  ~OwnFiles();
  OwnFiles(const OwnFiles&) = delete;
  OwnFiles& operator=(const OwnFiles&) = delete;

  /// The folder, with symbolic links followed.
  const std::filesystem::path& root() const { return root_; }

  bool is_own(const std::filesystem::path& file);

  /// Records the file, which the program has just written. `is_growing`: other lines will be appended to it; it stays
  /// the program's own while it only grows.
  void add(const std::filesystem::path& file, bool is_growing = false);

  /// Moves a file that is the user's to previous_name(), and reports it. Does nothing where there is no file, or one of
  /// the program's own. @throws IoError
  void make_way(const std::filesystem::path& file);

  /// Removes a file, or the files in a folder and then the folder, as far as they are the program's own.
  void remove(const std::filesystem::path& path);

  /// Renames a file or a folder in the folder; make_way() for a file that is at `to`. Own files stay own.
  /// @throws IoError
  void move(const std::filesystem::path& from, const std::filesystem::path& to);

  /// The object for the innermost folder that contains the file; null if there is none.
  static OwnFiles* of(const std::filesystem::path& file);

  /// What gets the lines of make_way(): standard error, unless this is called.
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

  std::filesystem::path root_, given_;  // with and without links followed
  std::map<std::string, Entry> entries_;
  std::mutex mutex_;
};

/// Before a file is written at `file` other than by an AtomicFile: OwnFiles::make_way() of its folder, if there is one.
void make_way(const std::filesystem::path& file);
/// After it: OwnFiles::add().
void add_own_file(const std::filesystem::path& file);
/// Removes a file if a record says that it is the program's own. True if it has.
bool remove_own_file(const std::filesystem::path& file);

}  // namespace b3dgs
