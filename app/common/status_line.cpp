#include "app/common/status_line.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <iostream>
#include <utility>

namespace b3dgs {
namespace {

constexpr double kRedrawSeconds = 0.1;
constexpr double kPlainLineSeconds = 10;

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

StatusLine StatusLine::silent() {
  static std::ostream nowhere(nullptr);
  return StatusLine(nowhere, 0, /*quiet=*/true);
}

StatusLine::~StatusLine() {
  clear();
}

void StatusLine::show(const std::string& text, bool now) {
  if (quiet_) return;
  const double time_s = clock_();
  if (!now && time_s - last_shown_s_ < (is_terminal() ? kRedrawSeconds : kPlainLineSeconds)) return;
  last_shown_s_ = time_s;
  const std::string line = detail::one_line(text);
  if (!is_terminal()) {
    out_ << line + '\n' << std::flush;  // one write, so that errors of other ranks do not get into the line
    return;
  }
  shown_ = line.substr(0, static_cast<std::size_t>(columns_ - 1));  // a full line would wrap
  out_ << '\r' + shown_ + "\x1b[K" << std::flush;
}

void StatusLine::print(const std::string& line) {
  const std::string status = shown_;
  clear();
  out_ << line + '\n' << std::flush;
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

ProgressFn show_loading(StatusLine& status) {
  return [&status](const std::string& stage, std::size_t done, std::size_t total) {
    const bool begins = done == 0, is_complete = total > 0 && done >= total;
    std::string text = stage;
    if (total > 0) text += " " + std::to_string(done) + "/" + std::to_string(total);
    if (status.is_terminal() && total > 0) {
      text = format_bar(static_cast<double>(done) / static_cast<double>(total), kBarColumns) + " " + text;
    }
    status.show(text, begins || is_complete);  // the first step may take long
  };
}

Scene open_scene(const SceneOptions& options, StatusLine& status, const ProgressFn& on_loading) {
  Scene scene = load_scene(options, on_loading ? on_loading : show_loading(status));
  status.clear();
  for (const std::string& warning : scene.warnings) status.warn(warning);
  return scene;
}

}  // namespace b3dgs
