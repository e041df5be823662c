// Requests to stop a command early: Ctrl-C, SIGTERM, or the stop button of the live view.
#pragma once

#include <atomic>

namespace b3dgs {

/// Returns the signal that requested a stop, or 0.
const std::atomic<int>& stop_signal();

/// From now on, the first SIGINT or SIGTERM makes training write a checkpoint and stop. A second one, at least half a
/// second later, ends the program immediately.
void catch_stop_signals();

/// Acts like the first Ctrl-C, regardless of the number of calls.
void request_stop();

}  // namespace b3dgs
