#include "scene/atomic_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <string>
#include <system_error>

#include "check.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

// A short name of its own: the target's name may already have the greatest length that the file system allows.
fs::path temporary_name(const fs::path& folder) {
  static std::atomic<unsigned> counter{0};
  return folder / (".b3dgs-" + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1)) + ".tmp");
}

// A rename is on disk once the folder is. Some network file systems cannot sync a folder, and say EINVAL.
void sync_folder(const fs::path& folder, const fs::path& target) {
  const int file = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (file < 0) io_error(target.string(), ": cannot open its folder to sync it: ", std::strerror(errno));
  const int failed = ::fsync(file) != 0 && errno != EINVAL && errno != ENOTSUP ? errno : 0;
  ::close(file);
  if (failed) io_error(target.string(), ": cannot sync its folder: ", std::strerror(failed));
}

}  // namespace

AtomicFile::AtomicFile(fs::path target) : target_(std::move(target)) {
  const fs::path folder = target_.has_parent_path() ? target_.parent_path() : fs::path(".");
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) io_error(target_.string(), ": cannot create the folder ", folder.string(), ": ", error.message());
  do {  // a file left by a killed process with the same id may have the name
    temporary_ = temporary_name(folder);
    // 0666 less the umask, as any other new file.
    file_ = ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  } while (file_ < 0 && (errno == EEXIST || errno == EINTR));
  if (file_ < 0) io_error(target_.string(), ": cannot write in ", folder.string(), ": ", std::strerror(errno));
}

AtomicFile::~AtomicFile() {
  if (file_ >= 0) ::close(file_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicFile::write(const void* data, std::size_t bytes) {
  B3DGS_CHECK(file_ >= 0, target_.string(), " is written after commit()");
  const char* from = static_cast<const char*>(data);
  std::size_t left = bytes;
  while (left > 0) {
    const ssize_t written = ::write(file_, from, left);
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) {
      const char* reason = written < 0 ? std::strerror(errno) : "nothing was accepted";
      io_error(target_.string(), ": cannot write ", bytes, " bytes: ", reason, "; the file was left as it was");
    }
    from += written;
    left -= static_cast<std::size_t>(written);
  }
}

void AtomicFile::commit() {
  B3DGS_CHECK(file_ >= 0, target_.string(), " is committed twice");
  int failed = 0;
  while (::fsync(file_) != 0) {
    if (errno == EINTR) continue;
    if (errno != EINVAL && errno != ENOTSUP) failed = errno;  // those two: not a file that can be synced
    break;
  }
  if (::close(file_) != 0 && failed == 0 && errno != EINTR) failed = errno;
  file_ = -1;
  if (failed) io_error(target_.string(), ": cannot finish writing: ", std::strerror(failed));
  if (::rename(temporary_.c_str(), target_.c_str()) != 0) {
    io_error(target_.string(), ": cannot be replaced: ", std::strerror(errno));
  }
  const fs::path folder = temporary_.parent_path();
  temporary_.clear();
  sync_folder(folder, target_);
}

void write_file(const fs::path& path, std::string_view content) {
  AtomicFile file(path);
  file.write(content);
  file.commit();
}

}  // namespace b3dgs
