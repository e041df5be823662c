// Text of report sections for synthetic histories.
#include "report/report_sections.h"

#include <gtest/gtest.h>

namespace b3dgs {
namespace {

KernelCheckEvent check_at(int iteration, const std::string& before, const std::string& after) {
  KernelCheckEvent check;
  check.iteration = iteration;
  check.pass = "forward";
  check.times_ms = {{"combined", 1.25}, {"shared-memory", 1.5}};
  check.spread_ms = {{"combined", 0.125}};
  check.views = 4;
  check.before = before;
  check.after = after;
  check.reason = "shared-memory takes longer";
  return check;
}

TEST(KernelSection, BeginsWithDisabledKernels) {
  TrainHistory history;
  history.checks = {check_at(1, "combined", "combined")};
  history.checks[0].disabled = {"shared-memory"};
  history.checks[0].reason = "shared-memory is disabled: its image differs";
  const std::string section = kernel_section(history);
  EXPECT_EQ(section.find("<p>shared-memory was disabled: its image differs (iteration 1, forward pass).</p>"), 0u)
      << section.substr(0, 200);
}

TEST(KernelSection, ShowsTheCostOfTimingChecks) {
  TrainHistory history;
  history.checks = {check_at(1, "combined", "combined")};
  history.points.emplace_back().elapsed_s = 10;
  history.checks[0].cost_ms = 20;
  EXPECT_NE(kernel_section(history).find("The timing check took 20 ms (0.200 % of the training time)"),
            std::string::npos)
      << kernel_section(history);
  history.checks[0].warm_up_ms = 125;
  EXPECT_NE(kernel_section(history).find("took another 125 ms (1.25 % of the training time)"), std::string::npos)
      << kernel_section(history);
}

TEST(KernelSection, ShowsSpreadAndViewsOfEveryTimingCheck) {
  TrainHistory history;
  history.checks = {check_at(1, "combined", "combined"), check_at(1000, "combined", "shared-memory")};
  const std::string section = kernel_section(history);
  EXPECT_NE(section.find("<td>1</td><td>forward</td><td>combined 1.250 (0.125), shared-memory 1.500</td><td>4</td>"
                         "<td>combined</td>"),
            std::string::npos)
      << section;
  EXPECT_NE(section.find("<td>from combined to shared-memory</td>"), std::string::npos);
  EXPECT_EQ(section.find("disabled"), std::string::npos);
  EXPECT_NE(kernel_section(TrainHistory{}).find("No kernels were timed"), std::string::npos);
}

TEST(KernelSection, ShowsKernelsChangedByAResume) {
  TrainHistory history;
  for (int iteration = 10; iteration <= 100; iteration += 10) {
    LogPoint& point = history.points.emplace_back();
    point.iteration = iteration;
    point.kernel = iteration <= 40 ? "combined" : "naive";
  }
  history.checks = {check_at(1, "combined", "combined")};
  const std::string section = kernel_section(history);
  EXPECT_NE(section.find("<td>combined</td><td>1 to 40</td><td>timing check</td>"), std::string::npos) << section;
  EXPECT_NE(section.find("<td>naive</td><td>41 to 100</td><td>resumed with another --kernel</td>"), std::string::npos)
      << section;
  history.checks.clear();
  EXPECT_NE(kernel_section(history).find("<td>naive</td><td>41 to 100</td>"), std::string::npos)
      << "also without any timing check";
  for (LogPoint& point : history.points) point.kernel = "segmented";
  EXPECT_NE(kernel_section(history).find("All iterations used the forward kernel segmented."), std::string::npos);
}

TEST(CurveFigure, DrawsNoChartOfASinglePoint) {
  const Quantity psnr{"PSNR", "dB", "PSNR, mean over the test views."};
  EXPECT_EQ(curve_figure(psnr, {}), "");
  EXPECT_EQ(curve_figure(psnr, {{"garden", {{60, 21.5}}}}), "<p>PSNR: 21.5 dB (iteration 60).</p>\n");
  EXPECT_EQ(curve_figure(psnr, {{"naive", {{60, 21.5}}}, {"adaptive", {{60, 21.75}}}}),
            "<p>PSNR: naive 21.5 dB, adaptive 21.8 dB (iteration 60).</p>\n");
  const std::string chart = curve_figure(psnr, {{"garden", {{60, 21.5}, {120, 23}}}});
  EXPECT_NE(chart.find("<polyline"), std::string::npos) << chart;
  EXPECT_NE(chart.find("PSNR, mean over the test views."), std::string::npos) << chart;
}

TEST(LoadSection, DrawsNoChartOfASingleMeasurement) {
  TrainHistory history;
  const LoadFigures load{0, 30, 400, 2000, 9000, 90, 0.75, {}};
  history.loads = {{10, load, {}, {}}};
  EXPECT_EQ(load_section(history),
            "<p>Gaussians per tile at iteration 10: median 30, 90th percentile 400, 99th percentile 2,000, maximum "
            "9,000. Gini coefficient (0 = evenly distributed, 1 = maximally uneven): 0.750 at iteration 10.</p>\n");
  history.loads.push_back({20, load, {}, {}});
  EXPECT_NE(load_section(history).find("<polygon"), std::string::npos) << "two measurements make a chart";
}

TEST(ChangedOptions, AreThoseThatDifferFromTheDefaults) {
  EXPECT_EQ(changed_options(TrainConfig{}, TrainConfig{}), "");
  TrainConfig config;
  config.source_path = "/scenes/garden";
  config.device = "cpu";
  config.eval = true;
  config.test_iterations = {10, 20};
  EXPECT_EQ(changed_options(TrainConfig{}, config), "eval true, test_iterations 10 20")
      << "scene and device are shown elsewhere";
}

}  // namespace
}  // namespace b3dgs
