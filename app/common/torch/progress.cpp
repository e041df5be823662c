#include "app/common/torch/progress.h"

#include <algorithm>
#include <cmath>

namespace b3dgs {
namespace {

constexpr int kPlainLineIterations = 500;
constexpr int kBarFromColumns = 100;  // narrower terminals show only the numbers

}  // namespace

void Eta::add(int iteration, double elapsed_s) {
  constexpr int kWindow = 100;  // iterations, a round of density control
  if (first_ >= 0 && iteration <= last_) return;
  if (first_ < 0) {
    first_ = iteration;
  } else {
    const double n = iteration - last_, seconds = std::max(0.0, elapsed_s - last_s_);
    const double share = std::min(1.0, n / std::min(iteration - first_, kWindow));  // at first, the plain mean
    seconds_per_iteration_ += share * (seconds / n - seconds_per_iteration_);
  }
  last_ = iteration;
  last_s_ = elapsed_s;
}

double Eta::iterations_per_second() const {
  return seconds_per_iteration_ > 0 ? 1 / seconds_per_iteration_ : 0;
}

std::optional<double> Eta::seconds_left() const {
  if (last_ == first_) return std::nullopt;
  return std::max(0, iterations_ - last_) * seconds_per_iteration_;
}

std::string format_train_progress(const TrainProgress& progress, double iterations_per_second,
                                  std::optional<double> seconds_left) {
  const double percent = progress.iterations > 0 ? 100.0 * progress.iteration / progress.iterations : 0;
  std::string text = print_to_string("%3.0f%%  %d/%d", std::floor(percent), progress.iteration, progress.iterations);
  if (iterations_per_second > 0) {
    text += print_to_string(iterations_per_second < 10 ? "  %.1f it/s" : "  %.0f it/s", iterations_per_second);
  }
  if (seconds_left) text += "  ETA " + format_duration(*seconds_left);
  text += print_to_string("  loss %.4f  ", progress.loss) + format_count(progress.n_gaussians) + " Gaussians";
  if (progress.count_cap > 0) text += " (capped: GPU memory)";
  return text + "  " + progress.activity;
}

TrainHooks hooks_for(StatusLine& status, const std::string& label) {
  TrainHooks hooks;
  hooks.on_message = [&status, label](const std::string& message) {
    if (!status.is_quiet()) status.print(label + message);
  };
  hooks.on_warning = [&status, label](const std::string& message) { status.warn(label + message); };
  hooks.on_loading = show_loading(status);
  return hooks;
}

TrainProgressView::TrainProgressView(StatusLine& status, const TrainConfig& config)
    : status_(status), eta_(config.iterations) {}

void TrainProgressView::operator()(const TrainProgress& progress) {
  eta_.add(progress.iteration, progress.elapsed_s);
  if (last_line_ == 0) last_line_ = progress.iteration;  // a resumed training
  const bool is_due =
      progress.iteration >= last_line_ + kPlainLineIterations || progress.iteration == progress.iterations;
  const bool is_step = progress.activity == "training";
  const bool now = status_.is_terminal() ? !is_step : is_step && is_due && progress.iteration != last_line_;
  if (now) last_line_ = progress.iteration;

  std::string text = format_train_progress(progress, eta_.iterations_per_second(), eta_.seconds_left());
  if (status_.columns() >= kBarFromColumns) {
    text = format_bar(static_cast<double>(progress.iteration) / std::max(1, progress.iterations), kBarColumns) + text;
  }
  status_.show(text, now);
}

}  // namespace b3dgs
