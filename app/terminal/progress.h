// What the user sees while something runs: one line that is redrawn on a terminal, and now and then a plain line
// elsewhere.
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

/// Seconds from any fixed moment.
using Clock = std::function<double()>;
double steady_seconds();

/// A stream with a status line at its end. Without a terminal the status is printed as a line of its own, at most every
/// 10 seconds unless asked for.
class StatusLine {
 public:
  /// `columns` is the width of the terminal, 0 if there is none; `quiet` shows no status, only print()ed lines.
  StatusLine(std::ostream& out, int columns, bool quiet, Clock clock = steady_seconds);
  /// For standard error, with its terminal's width.
  static StatusLine for_stderr(bool quiet);
  ~StatusLine();

  bool is_quiet() const { return quiet_; }
  bool is_terminal() const { return columns_ > 0; }
  int columns() const { return columns_; }

  /// Shows `text`; `now` also where it is too early for the next one.
  void show(const std::string& text, bool now = false);
  /// A line that stays, above the status.
  void print(const std::string& line);
  /// Likewise, with "warning: " before it; also where quiet.
  void warn(const std::string& line) { print("warning: " + line); }
  /// Takes the status away.
  void clear();

 private:
  std::ostream& out_;
  int columns_;
  bool quiet_;
  Clock clock_;
  double last_shown_s_;
  std::string shown_;  // on the terminal now
};

/// "[=====>    ]", `columns` wide in all.
std::string format_bar(double share, int columns);
/// "  37%  740/2000  6.1 it/s  ETA 3:27  loss 0.0412  84,120 Gaussians  densifying"
std::string format_train_progress(const TrainProgress& progress, double iterations_per_second,
                                  const std::optional<Eta>& eta);

/// For load_scene().
ProgressFn show_loading(StatusLine& status);

/// For TrainHooks::on_progress.
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
