#include "core/files/atomic_file.h"

#include <fcntl.h>
#include <ftw.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fstream>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <system_error>
#include <vector>

#include "core/check.h"
#include "core/descriptor.h"
#include "core/files/folders.h"
#include "core/files/own_files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr const char *kTemporaryPrefix = ".b3dgs-", *kTemporarySuffix = ".tmp";

// Returns " (No space left on device); free some disk space". `what` describes the operation that failed.
std::string with_remedy(int error, const std::string& what = "") {
  const std::string reason = " (" + what + std::strerror(error) + ")";
  if (error == ENOSPC || error == EDQUOT) return reason + "; free some disk space";
  if (error == EFBIG) return reason + "; raise the limit on file sizes (ulimit -f) or use another disk";
  return reason;
}

/// Returns whether it is removed.
bool remove_if_left_behind(const char* path, const std::string& name, const struct stat& status) {
  constexpr std::time_t kOneDay = 86400;  // s
  unsigned space = 0, number = 0;
  int process = 0, length = 0;
  const std::string pattern = std::string(kTemporaryPrefix) + "%u-%d-%u" + kTemporarySuffix + "%n";
  const bool fits = std::sscanf(name.c_str(), pattern.c_str(), &space, &process, &number, &length) == 3;
  if (!fits || length != static_cast<int>(name.size()) || process <= 0) return false;
  // This process has no file open here, so a file with its ID is from an earlier process with the same ID. It may have
  // a WorkFolder.
  const bool is_left = space == process_space()
                           ? process == ::getpid() ? S_ISREG(status.st_mode) : ::kill(process, 0) != 0 && errno == ESRCH
                           : std::time(nullptr) - status.st_mtime > kOneDay;
  return is_left && remove_tree(path);
}

int remove_entry_if_left_behind(const char* path, const struct stat* status, int type, FTW* place) {
  const bool is_any = type == FTW_F || type == FTW_D;
  const bool is_removed = is_any && remove_if_left_behind(path, path + place->base, *status);
  return is_removed && type == FTW_D ? FTW_SKIP_SUBTREE : FTW_CONTINUE;
}

/// Removes files that killed processes left in a folder, but not below it. Runs once for each folder, before this
/// process has a file open there.
void clean_once(const fs::path& folder) {
  static std::mutex mutex;
  static std::set<fs::path> cleaned;
  const std::lock_guard lock(mutex);
  if (!cleaned.insert(real_path(folder)).second) return;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    const std::string name = it->path().filename().string();
    struct stat status {};
    if (name.rfind(kTemporaryPrefix, 0) != 0 || ::lstat(it->path().c_str(), &status) != 0) continue;
    const bool is_any = S_ISREG(status.st_mode) || S_ISDIR(status.st_mode);
    if (is_any) remove_if_left_behind(it->path().c_str(), name, status);
  }
}

// A rename is durable once the folder is synced. Some network file systems cannot sync folders and return EINVAL.
void sync_folder(const fs::path& folder, const std::string& target) {
  const Descriptor file(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!file) io_error("cannot open the folder of ", target, " to sync it (", std::strerror(errno), ")");
  if (::fsync(file.fd()) == 0 || errno == EINVAL || errno == ENOTSUP) return;
  io_error("cannot sync the folder of ", target, " (", std::strerror(errno), ")");
}

// A new folder is durable once its parent is synced.
void create_folders(const fs::path& folder, const std::string& target) {
  std::vector<fs::path> parents;  // of new folders
  std::error_code error;
  fs::path path = fs::absolute(folder).lexically_normal();
  for (; !fs::exists(path, error) && path.has_relative_path(); path = path.parent_path()) {
    if (path.has_filename()) parents.push_back(path.parent_path());
  }
  if (!fs::is_directory(path, error)) make_way(path);  // moves a user's file aside if a folder is needed there
  fs::create_directories(folder, error);
  if (error) {
    const std::string purpose = target == folder.string() ? "" : ", needed for " + target;
    io_error("cannot create folder: ", folder.string(), purpose, with_remedy(error.value()));
  }
  for (const fs::path& parent : parents) {
    if (::access(parent.c_str(), R_OK) == 0) sync_folder(parent, target);  // syncing needs read permission
  }
}

}  // namespace

unsigned process_space() {
  static const unsigned space = [] {
    std::string text;
    std::getline(std::ifstream("/proc/sys/kernel/random/boot_id"), text);
    struct stat pids {};
    if (::stat("/proc/self/ns/pid", &pids) == 0) text += std::to_string(pids.st_ino);
    return static_cast<unsigned>(std::hash<std::string>{}(text));
  }();
  return space;
}

fs::path temporary_name(const fs::path& folder) {
  static std::atomic<unsigned> counter{0};
  return folder / (kTemporaryPrefix + std::to_string(process_space()) + "-" + std::to_string(::getpid()) + "-" +
                   std::to_string(counter.fetch_add(1)) + kTemporarySuffix);
}

AtomicFile::AtomicFile(fs::path target) : target_(std::move(target)) {
  const fs::path folder = target_.has_parent_path() ? target_.parent_path() : fs::path(".");
  create_folders(folder, target_.string());
  clean_once(folder);
  do {  // a killed process with the same ID may have left a file with this name
    temporary_ = temporary_name(folder);
    removed_by_signal_.emplace(temporary_);
    // The usual mode of a new file: 0666 without the bits of the umask.
    file_ = ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  } while (file_ < 0 && (errno == EEXIST || errno == EINTR));
  if (file_ < 0) io_error("cannot write ", target_.string(), with_remedy(errno));
}

AtomicFile::~AtomicFile() {
  if (file_ >= 0) ::close(file_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicFile::write(const void* data, std::size_t bytes) {
  rewrite(size_, data, bytes);
  size_ += bytes;
}

void AtomicFile::rewrite(std::uint64_t offset, const void* data, std::size_t bytes) {
  B3DGS_CHECK(file_ >= 0, target_.string(), " is written after commit()");
  const char* from = static_cast<const char*>(data);
  for (std::size_t left = bytes; left > 0;) {
    const ssize_t written = ::pwrite(file_, from, left, static_cast<off_t>(offset));
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) {
      const int failed = written < 0 ? errno : ENOSPC;
      std::error_code none;
      const char* kept = fs::exists(target_, none) ? "; the existing file is unchanged" : "";
      io_error("cannot write ", target_.string(), with_remedy(failed, std::to_string(bytes) + " bytes: "), kept);
    }
    from += written;
    offset += static_cast<std::uint64_t>(written);
    left -= static_cast<std::size_t>(written);
  }
}

void AtomicFile::commit() {
  B3DGS_CHECK(file_ >= 0, target_.string(), " is committed twice");
  int failed = 0;
  while (::fsync(file_) != 0) {
    if (errno == EINTR) continue;
    if (errno != EINVAL && errno != ENOTSUP) failed = errno;  // these two: the file system cannot sync it
    break;
  }
  if (::close(file_) != 0 && failed == 0 && errno != EINTR) failed = errno;
  file_ = -1;
  if (failed) io_error("cannot write ", target_.string(), with_remedy(failed));
  const fs::path folder = temporary_.parent_path();
  {
    // To another process, the file would be the user's after rename() and before it is recorded.
    std::optional<FolderTurn> turn;
    if (const OwnFiles* const own = OwnFiles::of(target_)) turn.emplace(own->root(), FolderTurn::IfLocked::kGoOn);
    make_way(target_);
    if (::rename(temporary_.c_str(), target_.c_str()) != 0) {
      io_error("cannot replace ", target_.string(), with_remedy(errno));
    }
    temporary_.clear();
    removed_by_signal_.reset();
    add_own_file(target_);
  }
  sync_folder(folder, target_.string());
}

void write_file(const fs::path& path, std::string_view content) {
  AtomicFile file(path);
  file.write(content);
  file.commit();
}

void require_writable(const fs::path& file, std::string_view remedy) {
  std::error_code error;
  if (fs::is_directory(file, error)) {
    input_error("cannot write ", file.string(), " (expected a file, found a folder); ", remedy);
  }
  fs::path folder = fs::absolute(file).parent_path();
  // A file of the user's where a folder is needed will be moved aside.
  while ((!fs::exists(folder, error) || (!fs::is_directory(folder, error) && OwnFiles::of(folder) != nullptr)) &&
         folder.has_relative_path()) {
    folder = folder.parent_path();
  }
  const fs::path probe = temporary_name(folder);
  const RemovedBySignal removed_by_signal(probe);
  const Descriptor opened(::open(probe.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
  const int failed = errno;
  if (opened) {
    ::unlink(probe.c_str());
  } else if (failed != EEXIST) {
    input_error("cannot write ", file.string(), " (expected a folder where files can be made, found ", folder.string(),
                ": ", std::strerror(failed), "); ", remedy);
  }
}

void create_folder(const fs::path& folder) {
  create_folders(folder, folder.string());
}

void remove_unfinished_files(const fs::path& folder) {
  constexpr int kOpenFolders = 16;
  ::nftw(folder.c_str(), remove_entry_if_left_behind, kOpenFolders, FTW_PHYS | FTW_ACTIONRETVAL);
}

}  // namespace b3dgs
