#include "core/stop_signals.h"

#include <dirent.h>
#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>

namespace b3dgs {
namespace {

constexpr std::array kStopSignals{SIGINT, SIGTERM, SIGHUP};

// More than are ever written at once. Beyond that, a signal leaves files behind, which AtomicFile removes later.
std::array<std::atomic<char*>, 1024> removed_paths;
std::atomic<bool> has_ended_by_signal{false};
static_assert(std::atomic<char*>::is_always_lock_free && std::atomic<bool>::is_always_lock_free);

// From here on, only functions that a signal handler may call. No memory is allocated.

bool is_dots(const char* name) {
  return std::strcmp(name, ".") == 0 || std::strcmp(name, "..") == 0;
}

void remove_at(int folder, const char* name) {
  if (::unlinkat(folder, name, 0) == 0 || (errno != EISDIR && errno != EPERM)) return;
  const int inside = ::openat(folder, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  if (inside < 0) return;
  alignas(dirent64) std::array<char, 4096> buffer;
  for (ssize_t bytes = 0; (bytes = ::getdents64(inside, buffer.data(), buffer.size())) > 0;) {
    for (ssize_t at = 0; at < bytes;) {
      const auto* const entry = reinterpret_cast<const dirent64*>(buffer.data() + at);
      if (!is_dots(entry->d_name)) remove_at(inside, entry->d_name);
      at += entry->d_reclen;
    }
  }
  ::close(inside);
  ::unlinkat(folder, name, AT_REMOVEDIR);
}

void set_handler(int signal, void (*handler)(int)) {
  struct sigaction action {};
  action.sa_handler = handler;
  sigemptyset(&action.sa_mask);
  sigaction(signal, &action, nullptr);
}

bool is_ignored(int signal) {
  struct sigaction action {};
  return sigaction(signal, nullptr, &action) == 0 && action.sa_handler == SIG_IGN;
}

}  // namespace

extern "C" void end_by_signal(int signal) {
  has_ended_by_signal = true;
  for (std::atomic<char*>& slot : removed_paths) {
    if (const char* const path = slot.exchange(nullptr)) remove_at(AT_FDCWD, path);
  }
  set_handler(signal, SIG_DFL);
  sigset_t only;  // the signal is blocked while its handler runs
  sigemptyset(&only);
  sigaddset(&only, signal);
  pthread_sigmask(SIG_UNBLOCK, &only, nullptr);
  ::raise(signal);
  ::_exit(128 + signal);  // process 1, as in a container, does not end by a signal of its own
}

void handle_stop_signals(void (*handler)(int)) {
  for (const int signal : kStopSignals) {
    if (!is_ignored(signal)) set_handler(signal, handler);
  }
}

void end_by_stop_signals() {
  handle_stop_signals(end_by_signal);
}

RemovedBySignal::RemovedBySignal(const std::filesystem::path& path) {
  char* const copy = ::strdup(path.c_str());
  for (std::size_t i = 0; i < removed_paths.size() && slot_ < 0; ++i) {
    char* none = nullptr;
    if (removed_paths[i].compare_exchange_strong(none, copy)) slot_ = static_cast<int>(i);
  }
  if (slot_ < 0) std::free(copy);
  while (has_ended_by_signal) ::pause();  // files written from now on would remain
}

RemovedBySignal::~RemovedBySignal() {
  if (slot_ >= 0) std::free(removed_paths[static_cast<std::size_t>(slot_)].exchange(nullptr));
}

}  // namespace b3dgs
