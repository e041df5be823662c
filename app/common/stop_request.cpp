#include "app/common/stop_request.h"

#include <csignal>
#include <cstdint>
#include <ctime>

#include "core/stop_signals.h"

namespace b3dgs {
namespace {

std::atomic<int> asked_to_stop{0};
std::atomic<std::int64_t> asked_at_ms{0};

std::int64_t now_ms() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);  // async-signal-safe
  return std::int64_t{now.tv_sec} * 1000 + now.tv_nsec / 1000000;
}

/// timeout(1) and some batch systems signal both the program and its process group, so two signals in quick succession
/// are one request. A later second signal stops the program immediately.
extern "C" void ask_to_stop(int signal) {
  constexpr std::int64_t kOneRequestMs = 500;
  int none = 0;
  if (asked_to_stop.compare_exchange_strong(none, signal)) {
    asked_at_ms = now_ms();
  } else if (asked_at_ms > 0 && now_ms() - asked_at_ms > kOneRequestMs) {
    end_by_signal(signal);
  }
}

}  // namespace

const std::atomic<int>& stop_signal() {
  return asked_to_stop;
}

void catch_stop_signals() {
  handle_stop_signals(ask_to_stop);
}

void request_stop() {
  int none = 0;  // two requests do not mean an immediate stop
  if (asked_to_stop.compare_exchange_strong(none, SIGINT)) asked_at_ms = now_ms();
}

}  // namespace b3dgs
