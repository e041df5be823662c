// Reads train.jsonl. Fields missing from a line stay empty and damaged lines are skipped, so that a report can always
// be written.
#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

namespace b3dgs {

/// A line without "event": the state of training after `iteration`.
struct LogPoint {
  int iteration = 0;
  double elapsed_s = 0;  // training time since iteration 0
  std::optional<double> loss, ms, test_psnr, test_ssim, test_sharpness;
  std::optional<std::int64_t> count, gpu_peak_bytes;
  std::string kernel;                                                   // "" if the line does not name it
  nlohmann::ordered_json stages_ms = nlohmann::ordered_json::object();  // mean per step; empty if not timed

  /// Calls field(key, member) for each quantity that reports draw over the iterations. The key is that of train.jsonl,
  /// and of the curves in the data of the pages and in compare.json.
  template <class Point, class Field>
  static void visit_curves(Point& point, Field&& field) {
    field("iteration", point.iteration);
    field("elapsed_s", point.elapsed_s);
    field("ms", point.ms);
    field("loss", point.loss);
    field("count", point.count);
    field("test_psnr", point.test_psnr);
    field("test_ssim", point.test_ssim);
    field("test_sharpness", point.test_sharpness);
    field("kernel", point.kernel);
  }
};

struct TrainHistory {
  std::vector<LogPoint> points;  // ascending by iteration
  /// Lines with "event" by its value, each kind an array in the order of the file. All members listed in
  /// train_log_reader.cpp exist and have the right type.
  nlohmann::ordered_json events = no_events();

  int last_iteration() const { return points.empty() ? 0 : points.back().iteration; }
  static nlohmann::ordered_json no_events();
};

/// Returns whether an event "kernel_check" changed the kernel.
bool switches_kernel(const nlohmann::ordered_json& check);

/// A kernel that was in use from iteration from + 1 to until.
struct KernelPeriod {
  std::string kernel;
  int from = 0, until = 0;
};

/// Splits the training by kernel, as named by log lines and checks; empty if none names a kernel.
std::vector<KernelPeriod> kernel_periods(const TrainHistory& history);

TrainHistory parse_train_log(std::istream& lines);

/// Returns an empty history if the file does not exist.
TrainHistory read_train_log(const std::filesystem::path& path);

}  // namespace b3dgs
