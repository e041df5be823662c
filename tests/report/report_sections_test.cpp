// What sections of a report say, over invented histories.
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

TEST(KernelSection, RefusedCandidatesStandFirst) {
  TrainHistory history;
  history.checks = {check_at(1, "combined", "combined")};
  history.checks[0].refused = {"shared-memory"};
  history.checks[0].reason = "shared-memory is disabled: its image differs";
  const std::string section = kernel_section(history);
  EXPECT_EQ(section.find("<p>shared-memory was refused: its image differs (iteration 1, forward pass).</p>"), 0u)
      << section.substr(0, 200);
}

TEST(KernelSection, TellsWhatChecksAndTheirWarmUpTook) {
  TrainHistory history;
  history.checks = {check_at(1, "combined", "combined")};
  history.points.emplace_back().elapsed_s = 10;
  history.checks[0].cost_ms = 20;
  EXPECT_NE(
      kernel_section(history).find("The check took 20 ms, 0.200 % of the training time, which it is part of.</p>"),
      std::string::npos)
      << kernel_section(history);
  history.checks[0].warm_up_ms = 125;
  EXPECT_NE(kernel_section(history).find("took 125 ms more (1.25 %), which is training time too."), std::string::npos)
      << kernel_section(history);
}

TEST(KernelSection, ShowsEveryCheckWithSpreadAndViews) {
  TrainHistory history;
  history.checks = {check_at(1, "combined", "combined"), check_at(1000, "combined", "shared-memory")};
  const std::string section = kernel_section(history);
  EXPECT_NE(section.find("<td>1</td><td>forward</td><td>combined 1.250 (0.125), shared-memory 1.500</td><td>4</td>"
                         "<td>combined</td>"),
            std::string::npos)
      << section;
  EXPECT_NE(section.find("<td>from combined to shared-memory</td>"), std::string::npos);
  EXPECT_EQ(section.find("refused"), std::string::npos);
  EXPECT_NE(kernel_section(TrainHistory{}).find("No kernels were timed"), std::string::npos);
}

TEST(KernelSection, ShowsAKernelThatAResumeChanged) {
  TrainHistory history;
  for (int iteration = 10; iteration <= 100; iteration += 10) {
    LogPoint& point = history.points.emplace_back();
    point.iteration = iteration;
    point.kernel = iteration <= 40 ? "combined" : "naive";
  }
  history.checks = {check_at(1, "combined", "combined")};
  const std::string section = kernel_section(history);
  EXPECT_NE(section.find("<td>combined</td><td>1 to 40</td><td>by a check</td>"), std::string::npos) << section;
  EXPECT_NE(section.find("<td>naive</td><td>41 to 100</td><td>by a resume with another --kernel</td>"),
            std::string::npos)
      << section;
  history.checks.clear();
  EXPECT_NE(kernel_section(history).find("<td>naive</td><td>41 to 100</td>"), std::string::npos)
      << "without any check too";
  for (LogPoint& point : history.points) point.kernel = "segmented";
  EXPECT_NE(kernel_section(history).find("The forward kernel was segmented all the time."), std::string::npos);
}

}  // namespace
}  // namespace b3dgs
