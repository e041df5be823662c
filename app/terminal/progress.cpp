#include "app/terminal/progress.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <iostream>

#include "core/print.h"

namespace b3dgs {
namespace {

constexpr double kRedrawSeconds = 0.1;
constexpr double kPlainLineSeconds = 10;
constexpr int kPlainLineIterations = 500;
constexpr int kBarColumns = 22;
constexpr int kBarFromColumns = 100;  // narrower terminals show the numbers only

}  // namespace

double steady_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

StatusLine::StatusLine(std::ostream& out, int columns, bool quiet, Clock clock)
    : out_(out), columns_(columns), quiet_(quiet), clock_(std::move(clock)), last_shown_s_(clock_()) {}

StatusLine StatusLine::for_stderr(bool quiet) {
  winsize size{};
  const bool is_terminal = isatty(STDERR_FILENO) != 0;
  const bool has_size = is_terminal && ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0;
  return StatusLine(std::cerr, has_size ? size.ws_col : is_terminal ? 80 : 0, quiet);
}

StatusLine::~StatusLine() {
  clear();
}

void StatusLine::show(const std::string& text, bool now) {
  if (quiet_) return;
  const double time_s = clock_();
  if (!now && time_s - last_shown_s_ < (is_terminal() ? kRedrawSeconds : kPlainLineSeconds)) return;
  last_shown_s_ = time_s;
  if (!is_terminal()) {
    out_ << text << '\n' << std::flush;
    return;
  }
  shown_ = text.substr(0, static_cast<std::size_t>(columns_ - 1));  // a full line would wrap
  out_ << '\r' << shown_ << "\x1b[K" << std::flush;
}

void StatusLine::print(const std::string& line) {
  const std::string status = shown_;
  clear();
  out_ << line << '\n' << std::flush;
  if (!status.empty()) show(status, true);
}

void StatusLine::clear() {
  if (shown_.empty()) return;
  out_ << "\r\x1b[K" << std::flush;
  shown_.clear();
}

std::string format_bar(double share, int columns) {
  const int inside = std::max(1, columns - 2);
  const int filled = std::clamp(static_cast<int>(share * inside), 0, inside);
  std::string bar(static_cast<std::size_t>(filled), '=');
  if (filled < inside) bar += '>';
  bar.resize(static_cast<std::size_t>(inside), ' ');
  return "[" + bar + "]";
}

std::string format_train_progress(const TrainProgress& progress, double iterations_per_second,
                                  const std::optional<Eta>& eta) {
  const double percent = progress.iterations > 0 ? 100.0 * progress.iteration / progress.iterations : 0;
  std::string text = print_to_string("%3.0f%%  %d/%d", std::floor(percent), progress.iteration, progress.iterations);
  if (iterations_per_second > 0) {
    text += print_to_string(iterations_per_second < 10 ? "  %.1f it/s" : "  %.0f it/s", iterations_per_second);
  }
  if (eta) text += (eta->is_lower_bound ? "  ETA > " : "  ETA ") + format_duration(eta->seconds);
  text += print_to_string("  loss %.4f  ", progress.loss) + format_count(progress.n_gaussians) + " Gaussians";
  if (progress.held_at > 0) text += " (held: GPU memory)";
  return text + "  " + progress.activity;
}

ProgressFn show_loading(StatusLine& status) {
  return [&status](const std::string& stage, std::size_t done, std::size_t total) {
    const bool is_complete = total > 0 && done >= total;
    std::string text = stage;
    if (total > 0) text += " " + std::to_string(done) + "/" + std::to_string(total);
    if (status.is_terminal() && total > 0) {
      text = format_bar(static_cast<double>(done) / static_cast<double>(total), kBarColumns) + " " + text;
    }
    status.show(text, is_complete);
  };
}

TrainProgressView::TrainProgressView(StatusLine& status, const TrainConfig& config)
    : status_(status),
      history_({config.iterations, config.densify_from_iter, config.densify_until_iter, config.max_gaussians}) {}

void TrainProgressView::operator()(const TrainProgress& progress) {
  history_.add({progress.iteration, progress.elapsed_s, progress.n_gaussians, progress.view_scale});
  if (last_line_ == 0) last_line_ = progress.iteration;  // of a resumed training
  const bool is_due =
      progress.iteration >= last_line_ + kPlainLineIterations || progress.iteration == progress.iterations;
  const bool is_step = progress.activity == "training";
  const bool now = status_.is_terminal() ? !is_step : is_step && is_due && progress.iteration != last_line_;
  if (now) last_line_ = progress.iteration;

  std::string text = format_train_progress(progress, history_.iterations_per_second(), history_.estimate());
  if (status_.columns() >= kBarFromColumns) {
    text = format_bar(static_cast<double>(progress.iteration) / std::max(1, progress.iterations), kBarColumns) + text;
  }
  status_.show(text, now);
}

}  // namespace b3dgs
