#include "report/train_report.h"

#include <algorithm>
#include <cmath>

#include "config/option_layers.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/print.h"
#include "core/text.h"
#include "report/report_sections.h"

namespace b3dgs {
namespace {

/// "1 h 2 min", "12 min 3 s" or "4.21 s"
std::string time_text(double seconds) {
  if (seconds < 60) return format_seconds(seconds, seconds);
  const long long total = std::llround(seconds);
  return total < 3600 ? print_to_string("%lld min %lld s", total / 60, total % 60)
                      : print_to_string("%lld h %lld min", total / 3600, total / 60 % 60);
}

/// The last point with an evaluation on test views, or null.
const LogPoint* last_evaluation(const TrainHistory& history) {
  for (auto point = history.points.rbegin(); point != history.points.rend(); ++point) {
    if (point->test_psnr) return &*point;
  }
  return nullptr;
}

/// ", PSNR 27.31 dB on test views"; without test views, of the training views that are shown; "" if neither was
/// evaluated.
std::string quality_text(const TrainConfig& config, const TrainHistory& history, const RunInfo& info) {
  if (const LogPoint* evaluated = last_evaluation(history)) {
    std::string text = print_to_string(", PSNR %.2f dB on %stest views", *evaluated->test_psnr,
                                       config.train_test_exp ? "the right half of " : "");
    if (evaluated->iteration < history.last_iteration()) {
      text += " at iteration " + format_count(evaluated->iteration);
    }
    return text;
  }
  if (info.held_out || info.previews.empty()) return "";
  double mean = 0;
  for (const Preview& preview : info.previews) mean += preview.psnr / static_cast<double>(info.previews.size());
  return print_to_string(", PSNR %.2f dB on %zu training %s", mean, info.previews.size(),
                         info.previews.size() == 1 ? "view" : "views");
}

std::string headline(const TrainConfig& config, const TrainHistory& history, const RunInfo& info) {
  const std::string scene = scene_name(config.source_path);
  if (history.points.empty()) return scene + ": no iterations logged yet";
  const LogPoint& last = history.points.back();
  std::string text = scene + ": ";
  text += last.iteration < config.iterations
              ? "not finished, " + format_count(last.iteration) + " of " + format_count(config.iterations) +
                    " iterations in " + time_text(last.elapsed_s)
              : "trained in " + time_text(last.elapsed_s);
  text += quality_text(config, history, info);
  return last.count ? text + ", " + format_count(*last.count) + " Gaussians" : text;
}

/// The number of Gaussians was limited by memory or by an option; "" if it was not.
std::string limit_text(const TrainHistory& history) {
  if (history.holds.empty() || history.points.empty()) return "";
  const HoldEvent& hold = history.holds.back();
  if (history.points.back().count.value_or(0) > hold.count) return "";
  return html::paragraph("From iteration " + format_count(hold.iteration) +
                         " on, the number of Gaussians was limited to " + format_count(hold.count) + " (" +
                         hold.reason + ").");
}

/// "" if the test views show no overfitting.
std::string overfitting_text(const TrainHistory& history) {
  const std::optional<Overfitting> found = find_overfitting(history);
  if (!found) return "";
  return html::paragraph("Overfitting: after iteration " + format_count(found->iteration) +
                         print_to_string(", PSNR on the test views was %.2f dB higher", found->lost) +
                         " than at the last evaluation. With few photographs, a lower --max_epochs or fewer Gaussians "
                         "(a lower --gaussians_per_pixel, or --max_gaussians) may help; if things move, mask them. "
                         "See docs/recipes.md, Few photographs.");
}

std::string floaters_paragraph(const TrainHistory& history) {
  const std::string text = floaters_text(history);
  return text.empty() ? ""
                      : html::paragraph("Gaussians that may be floaters: " + text + ". See docs/recipes.md, Floaters.");
}

std::string quality_section(const TrainConfig& config, const LabeledRun& run) {
  const std::vector<ChartSeries> psnr = curves({run}, &LogPoint::test_psnr);
  const std::string no_psnr = run.info.held_out ? "The test views have not been evaluated yet."
                                                : "No test views were held out (--eval does that), so there is no PSNR "
                                                  "over the iterations.";
  return (psnr.empty() ? html::paragraph(no_psnr, "soft")
                       : curve_figure({"PSNR", "dB", "PSNR, mean over the test views.", false}, psnr)) +
         overfitting_text(run.history) +
         curve_figure({"SSIM", "", "SSIM, mean over the test views.", false}, curves({run}, &LogPoint::test_ssim)) +
         curve_figure({"Loss", "", "Training loss, running average over steps."}, curves({run}, &LogPoint::loss)) +
         curve_figure({"Gaussians", "", "Number of Gaussians."}, count_curves({run})) + limit_text(run.history) +
         floaters_paragraph(run.history) + (config.train_test_exp ? html::paragraph(kMeasuredHalf, "soft") : "");
}

/// 0 if GPU memory was not measured.
std::int64_t gpu_peak_bytes(const TrainHistory& history) {
  std::int64_t peak = 0;
  for (const LogPoint& point : history.points) peak = std::max(peak, point.gpu_peak_bytes.value_or(0));
  return peak;
}

std::string time_and_memory_section(const LabeledRun& run) {
  const double elapsed_s = run.history.points.empty() ? 0 : run.history.points.back().elapsed_s;
  std::string text = "Training took " + time_text(elapsed_s) +
                     ", including density control, the upload of photographs and timing checks of kernels. Reading the "
                     "scene (" +
                     time_text(run.info.reading_s) + ") and evaluation, saving and checkpoints (" +
                     time_text(run.info.output_s) + ") are not included.";
  if (const std::int64_t peak = gpu_peak_bytes(run.history); peak > 0) {
    text += " GPU memory peaked at " + format_bytes(peak) + ", not counting the CUDA context.";
  }
  return html::paragraph(text) + stage_section({run});
}

std::vector<html::Row> settings(const ModelFolder& folder, const TrainConfig& config) {
  std::vector<html::Row> rows{{"source scene", config.source_path}};
  if (const std::string photographs = photographs_text(folder); !photographs.empty()) {
    rows.push_back({"resolution", photographs});
  }
  const std::string changed = changed_options(preset_options(config), config);
  const std::string preset = "--preset " + config.preset + ", --strategy " + config.strategy;
  rows.push_back({"options", changed.empty() ? "those of " + preset : changed + "; otherwise those of " + preset});
  return rows;
}

}  // namespace

std::string floaters_text(const TrainHistory& history) {
  if (history.floaters.empty() || history.floaters.back().iteration < history.last_iteration()) return "";
  const FloaterEvent& found = history.floaters.back();
  return format_count(found.unseen) + " in no training view, " + format_count(found.one_view) + " in one only, " +
         format_count(found.close) + " close to a camera, " + format_count(found.large) + " large in an image";
}

std::string limit_text(const TrainHistory& history, std::int64_t limit) {
  constexpr double kNearly = 0.95;
  const LogPoint *most = nullptr, *last = nullptr;
  for (const LogPoint& point : history.points) {
    if (!point.count) continue;
    last = &point;
    if (most == nullptr || *point.count > *most->count) most = &point;
  }
  const double nearly = kNearly * static_cast<double>(limit);
  if (limit == 0 || last == nullptr || static_cast<double>(*last->count) >= nearly) return "";
  const std::string there_were = format_count(*most->count) + " after iteration " + format_count(most->iteration);
  if (static_cast<double>(*most->count) < nearly) {
    return "the limit of " + format_count(limit) + " was not reached: at most " + there_were;
  }
  return "of " + there_were + ", those that hardly contribute were removed";
}

std::optional<Overfitting> find_overfitting(const TrainHistory& history) {
  constexpr double kClear = 0.2;  // dB; PSNR also goes up and down where it has no trend
  const LogPoint* const last = last_evaluation(history);
  const LogPoint* best = last;
  for (const LogPoint& point : history.points) {
    if (point.test_psnr && *point.test_psnr > *best->test_psnr) best = &point;
  }
  if (last == nullptr || *best->test_psnr - *last->test_psnr <= kClear) return std::nullopt;
  return Overfitting{best->iteration, *best->test_psnr, *best->test_psnr - *last->test_psnr};
}

std::filesystem::path write_train_report(const ModelFolder& folder) {
  const TrainConfig config = folder.read_config();
  const TrainHistory history = read_train_log(folder.log());
  const RunInfo info = read_run_info(folder);
  const LabeledRun run{scene_name(config.source_path), history, info, 0};
  std::string body = html::section("Photographs and renders", preview_section({run}));
  if (history.points.empty()) {
    body += html::paragraph("train.jsonl has no entries yet, so there are no curves.");
  } else {
    body += html::section("Quality", quality_section(config, run)) +
            html::section("Time and memory", time_and_memory_section(run));
  }
  body += html::section("Scene, options and machine", settings_section(settings(folder, config), info.machine)) +
          html::folded_section("Load: Gaussians per tile and per pixel", load_section(history)) +
          html::folded_section("Kernels: which were used, and why", kernel_section(history)) +
          html::folded_section("Words", words_section());
  const std::filesystem::path path = folder.root() / "report.html";
  write_file(path, html::page("Training of " + scene_name(config.source_path), headline(config, history, info), body));
  return path;
}

}  // namespace b3dgs
