// The "Kernels" section of a report.
#include <algorithm>
#include <limits>
#include <map>
#include <utility>

#include "core/check.h"
#include "core/print.h"
#include "report/report_sections.h"

namespace b3dgs {
namespace {

std::string iteration_text(int iteration) {
  return format_tick(iteration, 1);
}

std::string candidate_figure(const TrainHistory& history, const std::string& pass) {
  std::vector<ChartSeries> series;
  std::vector<ChartEvent> events;
  for (const CandidateTimes& timed : history.candidate_times) {
    if (timed.pass != pass) continue;
    for (const auto& [name, ms] : timed.times_ms) {
      auto candidate =
          std::find_if(series.begin(), series.end(), [&name = name](const auto& s) { return s.name == name; });
      if (candidate == series.end()) {
        series.push_back({name, {}, static_cast<int>(series.size()), true});
        candidate = series.end() - 1;
      }
      candidate->points.push_back({static_cast<double>(timed.iteration), ms});
    }
  }
  for (const KernelCheckEvent& check : history.checks) {
    if (check.pass == pass && check.has_changed()) {
      events.push_back({static_cast<double>(check.iteration), "to " + check.after});
    }
  }
  const std::string name = "Time of the " + pass + " kernels";
  return curve_figure({name, "ms",
                       name + " over the training. At each point, all kernels were timed on the same views; a dashed "
                              "line marks a switch to another kernel."},
                      series, events, 280);
}

/// A kernel that was disabled points to a defect, so this comes before all times.
std::string disabled_kernels(const TrainHistory& history) {
  std::string body;
  for (const KernelCheckEvent& check : history.checks) {
    if (check.disabled.empty()) continue;
    std::string names;
    for (const std::string& name : check.disabled) names += (names.empty() ? "" : ", ") + name;
    // The reason may begin with "NAME is ...: ", which this sentence says already.
    std::string reason = check.reason;
    const std::size_t colon = reason.find(": ");
    if (colon != std::string::npos && reason.compare(0, names.size() + 4, names + " is ") == 0) {
      reason = reason.substr(colon + 2);
    }
    body +=
        html::paragraph(detail::concat(names, check.disabled.size() == 1 ? " was" : " were", " disabled: ", reason,
                                       " (iteration ", iteration_text(check.iteration), ", ", check.pass, " pass)."));
  }
  return body;
}

/// "combined 1.200 (0.030), shared-memory 1.100"
std::string times_and_spreads(const KernelCheckEvent& check) {
  std::string text;
  for (const auto& [name, ms] : check.times_ms) {
    text += (text.empty() ? "" : ", ") + print_to_string("%s %.3f", name.c_str(), ms);
    for (const auto& [timed, spread_ms] : check.spread_ms) {
      if (timed == name) text += print_to_string(" (%.3f)", spread_ms);
    }
  }
  return text.empty() ? "-" : text;
}

/// Table rows for kernels that changed because training was resumed with other options. `in_use`: kernel by pass.
std::vector<html::Row> changes_at(const ResumeEvent& resume, std::map<std::string, std::string>& in_use) {
  std::string reason = "resumed";
  for (std::size_t i = 0; i < resume.changed_options.size(); ++i) {
    reason += (i == 0 ? " with " : ", ") + resume.changed_options[i];
  }
  std::vector<html::Row> rows;
  for (const auto& [pass, kernel] :
       {std::pair("forward", resume.kernel), std::pair("backward", resume.backward_kernel)}) {
    const std::string before = std::exchange(in_use[pass], kernel);
    if (before.empty() || kernel.empty() || before == kernel) continue;
    rows.push_back({iteration_text(resume.iteration + 1), pass, "-", "-", "from " + before + " to " + kernel, reason});
  }
  return rows;
}

/// What the timing checks cost.
std::string cost_text(const TrainHistory& history) {
  double cost_ms = 0, warm_up_ms = 0;
  bool has_cost = false;
  for (const KernelCheckEvent& check : history.checks) {
    has_cost = has_cost || check.cost_ms;
    cost_ms += check.cost_ms.value_or(0);
    warm_up_ms += check.warm_up_ms.value_or(0);
  }
  const double elapsed_s = history.points.empty() ? 0 : history.points.back().elapsed_s;
  if (!has_cost || elapsed_s <= 0) return "";
  const auto with_share = [&](double ms) {
    return format_figure(ms) + " ms (" + format_figure(0.1 * ms / elapsed_s) + " % of the training time)";
  };
  std::string text = (history.checks.size() == 1 ? "The timing check took " : "The timing checks took ") +
                     with_share(cost_ms) + ", which the training time includes.";
  if (warm_up_ms > 0) {
    text += " Loading the kernels before their first check in each session took another " + with_share(warm_up_ms) +
            ", also included.";
  }
  return html::paragraph(text, "soft");
}

std::string check_table(const TrainHistory& history) {
  std::vector<html::Row> rows;
  std::map<std::string, std::string> in_use;  // kernel by pass
  auto resume = history.resumes.begin();
  const auto add_resumes_before = [&](int iteration) {
    for (; resume != history.resumes.end() && resume->iteration < iteration; ++resume) {
      const std::vector<html::Row> changes = changes_at(*resume, in_use);
      rows.insert(rows.end(), changes.begin(), changes.end());
    }
  };
  for (const KernelCheckEvent& check : history.checks) {
    add_resumes_before(check.iteration);
    in_use[check.pass] = check.after;
    rows.push_back({iteration_text(check.iteration), check.pass, times_and_spreads(check),
                    check.views ? std::to_string(*check.views) : "-",
                    check.has_changed() ? "from " + check.before + " to " + check.after : check.after, check.reason});
  }
  add_resumes_before(std::numeric_limits<int>::max());
  return html::table({"iteration", "pass", "median time, ms (spread over views)", "views", "kernel", "reason"}, rows,
                     html::Columns::kWords) +
         cost_text(history);
}

/// Which forward kernel ran in which iterations.
std::string kernels_in_use(const TrainHistory& history) {
  const std::vector<KernelPeriod> periods = kernel_periods(history);
  if (periods.empty()) return "";
  if (periods.size() == 1) return html::paragraph("All iterations used the forward kernel " + periods[0].kernel + ".");
  std::vector<html::Row> rows;
  for (std::size_t i = 0; i < periods.size(); ++i) {
    const KernelPeriod& period = periods[i];
    const bool is_by_check =
        std::any_of(history.checks.begin(), history.checks.end(), [&](const KernelCheckEvent& check) {
          return check.pass == "forward" && check.iteration == period.from + 1 && check.after == period.kernel;
        });
    rows.push_back({period.kernel, iteration_text(period.from + 1) + " to " + iteration_text(period.until),
                    is_by_check ? "timing check"
                    : i == 0    ? "start of the training"
                                : "resumed with another --kernel"});
  }
  return html::table({"forward kernel", "iterations", "selected by"}, rows, html::Columns::kWords);
}

}  // namespace

std::string kernel_section(const TrainHistory& history) {
  if (history.checks.empty() && history.candidate_times.empty()) {
    return kernels_in_use(history) +
           html::paragraph("No kernels were timed: the kernels were fixed by options.", "soft");
  }
  return disabled_kernels(history) + kernels_in_use(history) + candidate_figure(history, "forward") +
         candidate_figure(history, "backward") + (history.checks.empty() ? "" : check_table(history));
}

}  // namespace b3dgs
