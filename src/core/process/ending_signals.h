// SIGINT, SIGTERM and SIGHUP while other programs run for this one.
#pragma once

namespace b3dgs {

/// While one exists, SIGINT, SIGTERM and SIGHUP do not end this process. Signals that it ignored stay ignored. Handlers
/// that it had are called as before. Where there was none, the signal is raised again at the end of the last
/// EndingSignals, so that the process ends as it would have. Any thread may create one.
class EndingSignals {
 public:
  EndingSignals();
  ~EndingSignals();
  EndingSignals(const EndingSignals&) = delete;
  EndingSignals& operator=(const EndingSignals&) = delete;

  /// The last signal that came while any EndingSignals existed; 0 if none did.
  int received() const;
};

}  // namespace b3dgs
