// Progress output: on a terminal, one line that is redrawn; elsewhere, occasional plain lines.
#pragma once

#include <functional>
#include <iosfwd>
#include <string>

#include "core/check.h"
#include "scene/scene.h"

namespace b3dgs {

/// Returns seconds since an arbitrary fixed moment.
using Clock = std::function<double()>;
double steady_seconds();

/// An output stream with a status line below the output. Without a terminal, the status is printed as a separate line,
/// at most every 10 seconds unless requested. Use print() or warn() for output meanwhile, or it mixes with the status.
class StatusLine {
 public:
  /// `columns` is the width of the terminal, 0 if there is none. If `quiet`, only lines from print() are shown.
  StatusLine(std::ostream& out, int columns, bool quiet, Clock clock = steady_seconds);
  /// Makes a status line on standard error.
  static StatusLine for_stderr(bool quiet);
  /// Makes a status line that shows nothing, not even lines from print() and warn().
  static StatusLine silent();
  ~StatusLine();

  bool is_quiet() const { return quiet_; }
  bool is_terminal() const { return columns_ > 0; }
  int columns() const { return columns_; }

  /// Shows `text`, unless the last status was shown too recently and `now` is false.
  void show(const std::string& text, bool now = false);
  /// Prints a permanent line above the status.
  void print(const std::string& line);
  /// Prints "warning: LINE", even if quiet.
  void warn(const std::string& line) { print("warning: " + detail::one_line(line)); }
  /// Removes the status.
  void clear();

 private:
  std::ostream& out_;
  int columns_;
  bool quiet_;
  Clock clock_;
  double last_shown_s_;
  std::string shown_;  // text on the terminal
};

inline constexpr int kBarColumns = 22;
/// Returns "[=====>    ]", `columns` wide.
std::string format_bar(double share, int columns);

/// Shows the progress of load_scene().
ProgressFn show_loading(StatusLine& status);

/// Calls load_scene() and shows its progress and warnings. `on_loading` replaces show_loading().
Scene open_scene(const SceneOptions& options, StatusLine& status, const ProgressFn& on_loading = {});

}  // namespace b3dgs
