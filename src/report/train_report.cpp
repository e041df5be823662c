#include "report/train_report.h"

#include <algorithm>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/print.h"
#include "core/text.h"
#include "report/html_report.h"
#include "report/report_sections.h"
#include "report/train_log_reader.h"

namespace b3dgs {
namespace {

/// The last line that has been evaluated, or null.
const LogPoint* last_evaluation(const TrainHistory& history) {
  for (auto point = history.points.rbegin(); point != history.points.rend(); ++point) {
    if (point->test_psnr) return &*point;
  }
  return nullptr;
}

std::string headline(const TrainConfig& config, const TrainHistory& history) {
  const int done = history.last_iteration();
  std::string text = scene_name(config.source_path) + ": ";
  if (done < config.iterations) text += "not finished, " + format_count(done) + " of ";
  text += format_count(config.iterations) + " iterations";
  if (const LogPoint* evaluated = last_evaluation(history)) {
    text += print_to_string(", PSNR %.2f dB", *evaluated->test_psnr);
    if (evaluated->test_ssim) text += print_to_string(", SSIM %.4f", *evaluated->test_ssim);
    if (evaluated->iteration < done) text += " at " + format_count(evaluated->iteration);
  }
  if (history.points.empty()) return text;
  const LogPoint& last = history.points.back();
  if (last.count) text += ", " + format_count(*last.count) + " Gaussians";
  if (!history.holds.empty() && last.count.value_or(0) <= history.holds.back().count) {
    const HoldEvent& hold = history.holds.back();
    text += " (held at " + format_count(hold.count) + ": " + hold.reason + ")";
  }
  return text + ", " + format_duration(last.elapsed_s) + " of training";
}

std::string times(const TrainHistory& history, const RunInfo& record) {
  const double elapsed_s = history.points.empty() ? 0 : history.points.back().elapsed_s;
  return detail::concat("Training took ", format_seconds(elapsed_s, elapsed_s),
                        " with densification, optimizer, uploads and kernel checks. Reading the scene (",
                        format_seconds(record.reading_s, 0), ") and evaluation, saving and checkpoints (",
                        format_seconds(record.output_s, 0), ") are not in it.");
}

/// The largest of all runs, or 0.
std::int64_t gpu_peak_bytes(const TrainHistory& history) {
  std::int64_t peak = 0;
  for (const LogPoint& point : history.points) peak = std::max(peak, point.gpu_peak_bytes.value_or(0));
  return peak;
}

std::string curve_figure(const std::string& title, const std::string& y_label, bool from_zero,
                         const std::vector<ChartSeries>& series, const std::string& caption) {
  LineChart chart{title, "iteration", y_label};
  chart.from_zero = from_zero;
  chart.series = series;
  chart.height = 220;
  return html::figure(draw(chart), caption);
}

std::string course(const LabeledRun& run) {
  std::string body = curve_figure("Loss over the training", "loss", true, curves({run}, &LogPoint::loss),
                                  "Loss, running average over steps.");
  const std::vector<ChartSeries> psnr = curves({run}, &LogPoint::test_psnr);
  if (psnr.empty()) {
    body += html::paragraph("No view was held out (--eval) or none evaluated yet: there is no PSNR.", "soft");
  } else if (psnr[0].points.size() > 1) {
    body += curve_figure("PSNR over the training", "PSNR, dB", false, psnr, "PSNR, mean over the test views.");
  }
  return body + curve_figure("Number of Gaussians over the training", "Gaussians", true, count_curves({run}),
                             "Number of Gaussians.");
}

}  // namespace

std::filesystem::path write_train_report(const ModelFolder& folder) {
  const TrainConfig config = folder.read_config();
  const TrainHistory history = read_train_log(folder.log());
  const RunInfo record = read_run_info(folder);
  const LabeledRun run{scene_name(config.source_path), history, record, 0};
  std::string body = html::paragraph(times(history, record), "soft");
  body += history.points.empty() ? html::paragraph("train.jsonl holds no line yet: there are no curves.")
                                 : html::section("Course", course(run));
  body += html::section("Time by stage", stage_section({run}));
  body += html::section("Kernels", kernel_section(history));
  body += html::section("Load", load_section(history));
  body += html::section("Pictures", preview_section({run}));
  std::vector<html::Row> facts{{"seed", std::to_string(config.seed)},
                               {"kernel", config.kernel},
                               {"SH degree", std::to_string(config.sh_degree)}};
  if (const std::int64_t peak = gpu_peak_bytes(history); peak > 0) {
    facts.push_back({"GPU memory", format_gigabytes(peak) + " at most, besides the CUDA context"});
  }
  body += html::section("Machine and settings", machine_section(record.machine, facts));
  const std::filesystem::path path = folder.root() / "report.html";
  write_file(path, html::page("Training of " + scene_name(config.source_path), headline(config, history), body));
  return path;
}

}  // namespace b3dgs
