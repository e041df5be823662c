// Disks on which files cannot be written.
#pragma once

#include <sys/mount.h>
#include <sys/resource.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <string>

namespace b3dgs::test {

/// Limits the size of files written by this process, to simulate a full disk.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limited{bytes, before_.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &limited);
  }
  ~FileSizeLimit() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_{};
  void (*handler_)(int);
};

/// A file system in memory, if this user may mount one.
class SmallDisk {
 public:
  SmallDisk(const std::filesystem::path& folder, const char* options, unsigned long flags = 0) : folder_(folder) {
    std::filesystem::create_directories(folder);
    if (::mount("none", folder.c_str(), "tmpfs", flags, options) != 0) fault_ = std::strerror(errno);
  }
  ~SmallDisk() {
    if (fault_.empty()) ::umount2(folder_.c_str(), MNT_DETACH);
  }
  const std::string& fault() const { return fault_; }

 private:
  std::filesystem::path folder_;
  std::string fault_;
};

}  // namespace b3dgs::test
