#include "core/files/own_files.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <set>
#include <sstream>
#include <system_error>
#include <thread>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct Registry {
  std::mutex mutex;
  std::vector<OwnFiles*> folders;
  std::function<void(const std::string& line)> report;
};

Registry& registry() {
  static Registry one;
  return one;
}

/// Folders that this process has locked or given up to lock, and the mutex of the thread that may change them.
struct Turns {
  std::recursive_mutex mutex;
  std::set<fs::path> held, given_up;
  std::chrono::milliseconds longest_wait{60'000};
};

Turns& turns() {
  static Turns one;
  return one;
}

void report(const std::string& line) {
  std::unique_lock lock(registry().mutex);
  const auto to = registry().report;
  lock.unlock();
  if (to) return to(line);
  std::fprintf(stderr, "warning: %s\n", line.c_str());
}

/// Resolves links in the path of the folder, but not a link in the last name.
fs::path resolved(const fs::path& path) {
  const fs::path absolute = fs::absolute(path).lexically_normal();
  const fs::path file = absolute.has_filename() ? absolute : absolute.parent_path();
  return real_path(file.parent_path()) / file.filename();
}

std::optional<struct stat> status_of(const fs::path& file) {
  struct stat status {};
  if (::lstat(file.c_str(), &status) != 0) return std::nullopt;
  return status;
}

std::int64_t time_of(const struct stat& status) {
  return std::int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec;
}

/// Returns whether a file also exists elsewhere as a hard link.
bool has_copies(const struct stat& status) {
  return S_ISREG(status.st_mode) && status.st_nlink > 1;
}

/// Returns a name in one line, with "\n" and "\\" escaped.
std::string escaped(const std::string& name) {
  std::string text;
  for (const char c : name) text += c == '\\' ? "\\\\" : c == '\n' ? "\\n" : std::string(1, c);
  return text;
}

std::string unescaped(const std::string& text) {
  std::string name;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool is_escape = text[i] == '\\' && i + 1 < text.size();
    if (is_escape) ++i;
    name += is_escape && text[i] == 'n' ? '\n' : text[i];
  }
  return name;
}

}  // namespace

fs::path previous_name(const fs::path& path) {
  const std::string previous = path.string() + ".previous";
  fs::path free = previous;
  for (int i = 2; status_of(free); ++i) free = previous + "." + std::to_string(i);
  return free;
}

fs::path real_path(const fs::path& path) {
  fs::path there = fs::absolute(path).lexically_normal(), missing;
  for (;; there = there.parent_path()) {
    char* const real = ::realpath(there.c_str(), nullptr);
    if (real != nullptr) {
      const fs::path found = missing.empty() ? fs::path(real) : real / missing;
      std::free(real);
      return found;
    }
    if (!there.has_relative_path()) return path;
    if (there.has_filename()) missing = missing.empty() ? there.filename() : there.filename() / missing;
  }
}

FolderTurn::FolderTurn(const fs::path& folder, IfLocked if_locked) : thread_turn_(turns().mutex) {
  const fs::path root = real_path(folder);
  const bool has_given_up = turns().given_up.count(root) > 0 && if_locked == IfLocked::kGoOn;
  if (turns().held.count(root) > 0) return;
  const std::chrono::milliseconds wait = has_given_up ? std::chrono::milliseconds{} : turns().longest_wait;
  if (lock_record(root / OwnFiles::kRecord, wait)) {
    turns().given_up.erase(root);
  } else {
    const std::string fault = detail::concat("folder in use: ", root.string(), " (another process holds the lock of ",
                                             OwnFiles::kRecord, ")");
    if (if_locked == IfLocked::kFail) io_error(fault, "; end that process, or wait for it");
    if (turns().given_up.insert(root).second) report(fault + "; going on without it");
  }
  turns().held.insert(root);
  root_ = root;
}

FolderTurn::~FolderTurn() {
  if (!root_.empty()) turns().held.erase(root_);
}

void FolderTurn::set_longest_wait(std::chrono::milliseconds wait) {
  const std::lock_guard lock(turns().mutex);
  turns().longest_wait = wait;
}

bool FolderTurn::lock_record(const fs::path& record, std::chrono::milliseconds wait) {
  using Clock = std::chrono::steady_clock;
  constexpr std::chrono::milliseconds kPause{5};
  for (const auto end = Clock::now() + wait;; std::this_thread::sleep_for(kPause)) {
    file_ = Descriptor(::open(record.c_str(), O_RDWR | O_CREAT | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0666));
    if (!file_) return true;
    const bool is_locked = ::flock(file_.fd(), LOCK_EX | LOCK_NB) == 0;
    if (!is_locked && errno != EWOULDBLOCK && errno != EINTR) return true;
    struct stat own {};
    const auto there = status_of(record);
    const bool is_there = ::fstat(file_.fd(), &own) == 0 && there && own.st_ino == there->st_ino &&
                          own.st_dev == there->st_dev;  // otherwise it was replaced meanwhile
    if (is_locked && is_there && !has_copies(own)) return true;
    if (is_locked && is_there) {
      try {  // a copy of the folder by hard links keeps the record as it is
        write_file(record, read_whole_file(record));
      } catch (const Error&) {
        return true;
      }
    }
    if (Clock::now() >= end) {
      file_.close();
      return false;
    }
  }
}

OwnFiles::OwnFiles(const fs::path& folder) : root_(real_path(folder)), given_(fs::absolute(folder).lexically_normal()) {
  read_record();
  const std::lock_guard lock(registry().mutex);
  registry().folders.push_back(this);
}

void OwnFiles::read_record() {
  entries_.clear();
  std::string text;
  try {
    text = read_file_if_there(root_ / kRecord).value_or("");
  } catch (const InputError&) {  // all files are then the user's
  }
  std::istringstream file(text);
  for (std::string line; std::getline(file, line);) {
    // "SIZE TIME KIND NAME", where kind is "f", "g" for a growing file, or "-" for a removed one.
    std::istringstream words(line);
    Entry entry;
    std::string kind;
    if (!(words >> entry.bytes >> entry.changed >> kind) || words.get() != ' ') continue;
    std::string name;
    std::getline(words, name);
    entry.is_growing = kind == "g";
    if (kind == "-") entries_.erase(unescaped(name));
    if (kind == "f" || kind == "g") entries_[unescaped(name)] = entry;
  }
}

OwnFiles::~OwnFiles() {
  const std::lock_guard lock(registry().mutex);
  auto& folders = registry().folders;
  folders.erase(std::remove(folders.begin(), folders.end(), this), folders.end());
}

std::string OwnFiles::name_of(const fs::path& file) const {
  const auto below = [](const fs::path& path, const fs::path& folder) {
    const fs::path name = path.lexically_relative(folder);
    return name.empty() || *name.begin() == ".." || *name.begin() == "." ? "" : name.string();
  };
  const std::string name = below(resolved(file), root_);
  // A link in the folder may lead out of it. Files that are written through the link are tracked here nevertheless.
  return name.empty() ? below(fs::absolute(file).lexically_normal(), given_) : name;
}

bool OwnFiles::is_recorded(const std::string& name) const {
  const auto entry = entries_.find(name);
  if (entry == entries_.end()) return false;
  const auto status = status_of(root_ / name);
  if (!status || !S_ISREG(status->st_mode)) return false;
  const auto bytes = static_cast<std::uintmax_t>(status->st_size);
  if (entry->second.is_growing) return bytes >= entry->second.bytes;
  return bytes == entry->second.bytes && time_of(*status) == entry->second.changed;
}

bool OwnFiles::is_own(const std::string& name) {
  if (is_recorded(name)) return true;
  if (!status_of(root_ / name)) return false;
  read_record();  // another process may have written the file since, such as an evaluation during a training
  return is_recorded(name);
}

bool OwnFiles::is_own(const fs::path& file) {
  const std::lock_guard lock(mutex_);
  return is_own(name_of(file));
}

/// Appends to the log of own files. A null `entry` means removed. If a failure loses a line, the file counts as the
/// user's, which is safe.
void OwnFiles::record(const std::string& name, const Entry* entry) {
  const Entry values = entry != nullptr ? *entry : Entry{};
  const char* kind = entry == nullptr ? "-" : values.is_growing ? "g" : "f";
  const std::string line = detail::concat(values.bytes, " ", values.changed, " ", kind, " ", escaped(name), "\n");
  entries_.erase(name);
  if (entry != nullptr) entries_.emplace(name, values);
  const Descriptor file(
      ::open((root_ / kRecord).c_str(), O_WRONLY | O_CREAT | O_APPEND | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0666));
  struct stat status {};
  if (!file || ::fstat(file.fd(), &status) != 0 || has_copies(status)) return;
  if (::write(file.fd(), line.data(), line.size()) < 0) return;
}

void OwnFiles::add(const fs::path& file, bool is_growing) {
  const std::string name = name_of(file);
  if (name.empty() || !status_of(root_ / name)) return;
  const FolderTurn turn(root_, FolderTurn::IfLocked::kGoOn);
  const std::lock_guard lock(mutex_);
  const auto status = status_of(root_ / name);
  if (!status) return;
  const Entry entry{static_cast<std::uintmax_t>(status->st_size), time_of(*status), is_growing};
  record(name, &entry);
}

void OwnFiles::make_way(const fs::path& file) {
  const std::string name = name_of(file);
  const fs::path place = root_ / name;
  if (name.empty() || !status_of(place)) return;
  fs::path free;
  {
    const FolderTurn turn(root_, FolderTurn::IfLocked::kGoOn);
    const std::lock_guard lock(mutex_);
    if (!status_of(place) || is_own(name)) return;
    free = previous_name(place);
    std::error_code error;
    fs::rename(place, free, error);
    if (error) {
      io_error(file.string(), " was not written by this program, and cannot be moved to ", free.string(), ": ",
               error.message());
    }
    if (entries_.count(name) > 0) record(name, nullptr);
  }
  report(file.string() + " was not written by this program, or was changed since; it is kept as " +
         free.filename().string());
}

void OwnFiles::remove_known(const fs::path& path) {
  const auto status = status_of(path);
  if (!status) return;
  if (!S_ISDIR(status->st_mode)) {
    const std::string name = name_of(path);
    if (is_own(name) && ::unlink(path.c_str()) == 0) record(name, nullptr);
    return;
  }
  std::vector<fs::path> inside;
  std::error_code error;
  for (fs::directory_iterator it(path, error), end; !error && it != end; it.increment(error)) {
    inside.push_back(it->path());
  }
  for (const fs::path& entry : inside) remove_known(entry);
  ::rmdir(path.c_str());  // fails if something is left
}

void OwnFiles::remove(const fs::path& path) {
  if (name_of(path).empty() || !status_of(path)) return;
  const FolderTurn turn(root_, FolderTurn::IfLocked::kGoOn);
  const std::lock_guard lock(mutex_);
  remove_known(path);
}

void OwnFiles::move(const fs::path& from, const fs::path& to) {
  const FolderTurn turn(root_, FolderTurn::IfLocked::kGoOn);
  make_way(to);
  const std::lock_guard lock(mutex_);
  const std::string old_name = name_of(from), new_name = name_of(to);
  std::error_code error;
  fs::rename(from, to, error);
  if (error) io_error(from.string(), ": cannot be moved to ", to.string(), ": ", error.message());
  std::vector<std::pair<std::string, Entry>> moved;
  for (const auto& [name, entry] : entries_) {
    if (name == old_name || name.compare(0, old_name.size() + 1, old_name + "/") == 0) moved.emplace_back(name, entry);
  }
  for (const auto& [name, entry] : moved) {
    record(name, nullptr);
    if (!new_name.empty()) record(new_name + name.substr(old_name.size()), &entry);
  }
}

OwnFiles* OwnFiles::of(const fs::path& file) {
  if (file.filename() == kRecord) return nullptr;
  const std::lock_guard lock(registry().mutex);
  OwnFiles* innermost = nullptr;
  for (OwnFiles* folder : registry().folders) {
    const bool is_inner = innermost == nullptr || folder->root_.native().size() > innermost->root_.native().size();
    if (is_inner && !folder->name_of(file).empty()) innermost = folder;
  }
  return innermost;
}

void OwnFiles::set_reporter(std::function<void(const std::string& line)> to) {
  const std::lock_guard lock(registry().mutex);
  registry().report = std::move(to);
}

void make_way(const fs::path& file) {
  if (OwnFiles* own = OwnFiles::of(file)) own->make_way(file);
}

void add_own_file(const fs::path& file) {
  if (OwnFiles* own = OwnFiles::of(file)) own->add(file);
}

bool remove_own_file(const fs::path& file) {
  OwnFiles* own = OwnFiles::of(file);
  if (own == nullptr || !own->is_own(file)) return false;
  own->remove(file);
  return true;
}

}  // namespace b3dgs
