#include "core/process/ending_signals.h"

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstddef>
#include <mutex>

namespace b3dgs {
namespace {

constexpr std::array kSignals{SIGINT, SIGTERM, SIGHUP};

std::mutex users_mutex;
int users = 0;
std::array<struct sigaction, kSignals.size()> before;  // written only while our handler is not installed
std::atomic<int> last_signal{0};
static_assert(std::atomic<int>::is_always_lock_free);

bool is(const struct sigaction& action, void (*handler)(int)) {
  return (action.sa_flags & SA_SIGINFO) == 0 && action.sa_handler == handler;
}

extern "C" void note_signal(int signal, siginfo_t* info, void* context) {
  const int saved_errno = errno;
  last_signal = signal;
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    if (kSignals[i] != signal || is(before[i], SIG_DFL)) continue;
    if ((before[i].sa_flags & SA_SIGINFO) != 0) {
      before[i].sa_sigaction(signal, info, context);
    } else {
      before[i].sa_handler(signal);
    }
  }
  errno = saved_errno;
}

}  // namespace

EndingSignals::EndingSignals() {
  const std::lock_guard lock(users_mutex);
  if (users++ > 0) return;
  last_signal = 0;
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    sigaction(kSignals[i], nullptr, &before[i]);
    if (is(before[i], SIG_IGN)) continue;
    struct sigaction action {};
    action.sa_sigaction = note_signal;
    action.sa_flags = SA_SIGINFO;
    sigemptyset(&action.sa_mask);
    sigaction(kSignals[i], &action, nullptr);
  }
}

EndingSignals::~EndingSignals() {
  const std::lock_guard lock(users_mutex);
  if (--users > 0) return;
  bool ends_process = false;
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    if (!is(before[i], SIG_IGN)) sigaction(kSignals[i], &before[i], nullptr);
    ends_process = ends_process || (is(before[i], SIG_DFL) && kSignals[i] == last_signal);
  }
  if (ends_process) std::raise(last_signal);
}

int EndingSignals::received() const {
  return last_signal;
}

}  // namespace b3dgs
