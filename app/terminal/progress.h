// Progress output: on a terminal, one line that is redrawn; elsewhere, occasional plain lines.
#pragma once

#include <chrono>
#include <functional>
#include <iosfwd>
#include <string>

#include "app/terminal/eta.h"
#include "core/text.h"
#include "scene/scene.h"
#include "train/trainer.h"

namespace b3dgs {

/// Seconds since an arbitrary fixed moment.
using Clock = std::function<double()>;
double steady_seconds();

/// An output stream with a status line below the output. Without a terminal, the status is printed as a line of its
/// own, at most every 10 seconds unless requested.
class StatusLine {
 public:
  /// `columns` is the width of the terminal, 0 if there is none. If `quiet`, only lines from print() are shown.
  StatusLine(std::ostream& out, int columns, bool quiet, Clock clock = steady_seconds);
  /// A status line on standard error.
  static StatusLine for_stderr(bool quiet);
  ~StatusLine();

  bool is_quiet() const { return quiet_; }
  bool is_terminal() const { return columns_ > 0; }
  int columns() const { return columns_; }

  /// Shows `text`, unless the last status was shown too recently and `now` is false.
  void show(const std::string& text, bool now = false);
  /// Prints a permanent line above the status.
  void print(const std::string& line);
  /// Prints "warning: LINE", even if quiet.
  void warn(const std::string& line) { print("warning: " + line); }
  /// Removes the status.
  void clear();

 private:
  std::ostream& out_;
  int columns_;
  bool quiet_;
  Clock clock_;
  double last_shown_s_;
  std::string shown_;  // on the terminal
};

/// "[=====>    ]", `columns` wide.
std::string format_bar(double share, int columns);
/// "  37%  740/2000  6.1 it/s  ETA 3:27  loss 0.0412  84,120 Gaussians  densifying"
std::string format_train_progress(const TrainProgress& progress, double iterations_per_second,
                                  const std::optional<Eta>& eta);

/// Shows the progress of load_scene().
ProgressFn show_loading(StatusLine& status);

/// Shows the progress of training; a callback for TrainHooks::on_progress.
class TrainProgressView {
 public:
  TrainProgressView(StatusLine& status, const TrainConfig& config);
  void operator()(const TrainProgress& progress);

 private:
  StatusLine& status_;
  EtaHistory history_;
  int last_line_ = 0;  // iteration
};

}  // namespace b3dgs
