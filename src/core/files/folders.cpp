#include "core/files/folders.h"

#include <fcntl.h>
#include <ftw.h>
#include <stdlib.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>

#include "core/check.h"
#include "core/files/atomic_file.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

std::string host_name() {
  std::array<char, HOST_NAME_MAX + 1> name{};
  return ::gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "";
}

/// Returns the command line of a process on this machine.
std::string command_of(int process) {
  constexpr std::size_t kMost = 200;
  std::ifstream file("/proc/" + std::to_string(process) + "/cmdline", std::ios::binary);
  std::string command{std::istreambuf_iterator<char>(file), {}};  // words, each with a zero byte
  std::replace(command.begin(), command.end(), '\0', ' ');
  command.resize(command.find_last_not_of(' ') + 1);
  return command.size() > kMost ? command.substr(0, kMost) + "..." : command;
}

/// The file `lock` has the ID of the process that locks the folder, its host name and its process_space(), because
/// containers may have equal names.
[[noreturn]] void refuse(const fs::path& folder, int lock, const std::string& kind) {
  std::array<char, HOST_NAME_MAX + 32> text{};
  const ssize_t bytes = ::pread(lock, text.data(), text.size() - 1, 0);
  std::istringstream words(bytes > 0 ? text.data() : "");
  std::string holder = "another process", command, host;
  if (int process = 0; words >> process && process > 0) {
    holder = "process " + std::to_string(process);
    unsigned space = 0;
    words >> host >> space;
    if (host == host_name() && space == process_space()) {
      command = command_of(process);
    } else if (!host.empty()) {
      holder += " on " + host;
    }
  }
  input_error(kind, " in use: ", folder.string(), " (by ", holder, command.empty() ? "" : ": " + command,
              "); wait until it ends, or choose another folder", kind == "model folder" ? " with -m" : "");
}

/// Returns whether the open file is still the one at `path`. The previous owner removes it before releasing the lock.
bool is_at(int file, const fs::path& path) {
  struct stat own {
  }, there{};
  return ::fstat(file, &own) == 0 && ::stat(path.c_str(), &there) == 0 && own.st_ino == there.st_ino &&
         own.st_dev == there.st_dev;
}

}  // namespace

FolderLock::FolderLock(const fs::path& folder, const char* kind) : path_(folder / ".b3dgs-lock") {
  std::error_code error;  // ignored: create_folder() reports it
  is_new_ = !fs::exists(folder, error);
  create_folder(folder);
  do {
    file_ = Descriptor(::open(path_.c_str(), O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0666));
    if (!file_) io_error("cannot write to folder: ", folder.string(), " (", std::strerror(errno), ")");
    int failed = 0;
    while (::flock(file_.fd(), LOCK_EX | LOCK_NB) != 0 && (failed = errno) == EINTR) {
    }
    if (failed == EWOULDBLOCK) refuse(folder, file_.fd(), kind);
  } while (!is_at(file_.fd(), path_));
  const std::string process = detail::concat(::getpid(), " ", host_name(), " ", process_space(), "\n");
  // This text is only for error messages, so a full disk is ignored here.
  if (::ftruncate(file_.fd(), 0) != 0 || ::write(file_.fd(), process.data(), process.size()) < 0) errno = 0;
  remove_unfinished_files(folder);
  own_files_.emplace(folder);
}

FolderLock::~FolderLock() {
  ::unlink(path_.c_str());
  file_.close();
  std::error_code error;  // ignored: usually the folder is not empty
  if (is_new_) fs::remove(path_.parent_path(), error);
}

void make_absolute(std::string& path) {
  if (!path.empty()) path = std::filesystem::absolute(path).lexically_normal().string();
}

bool remove_tree(const std::filesystem::path& path) {
  constexpr int kOpenFolders = 16;
  const auto remove_entry = [](const char* entry, const struct stat*, int, FTW*) { return std::remove(entry); };
  struct stat status;
  if (::lstat(path.c_str(), &status) != 0) return true;
  return ::nftw(path.c_str(), remove_entry, kOpenFolders, FTW_DEPTH | FTW_PHYS) == 0;
}

WorkFolder::WorkFolder(const std::filesystem::path& parent) {
  do {  // the name may be taken, as that of an AtomicFile
    path_ = temporary_name(parent);
    removed_by_signal_.emplace(path_);
  } while (::mkdir(path_.c_str(), 0700) != 0 && errno == EEXIST);
  if (std::error_code none; !fs::is_directory(path_, none)) {
    io_error("cannot create a folder in ", parent.string(), ": ", std::strerror(errno));
  }
}

WorkFolder::~WorkFolder() {
  remove_tree(path_);
}

}  // namespace b3dgs
