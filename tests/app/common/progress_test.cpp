// Progress output on a terminal and elsewhere.
#include "app/common/torch/progress.h"

#include <gtest/gtest.h>

#include <sstream>

namespace b3dgs {
namespace {

TEST(Format, Durations) {
  EXPECT_EQ(format_duration(0), "0:00");
  EXPECT_EQ(format_duration(59.6), "1:00");
  EXPECT_EQ(format_duration(207), "3:27");
  EXPECT_EQ(format_duration(3723), "1:02:03");
}

TEST(Format, SizesOfMemoryAndFiles) {
  EXPECT_EQ(format_bytes(0), "0.0 kB");
  EXPECT_EQ(format_bytes(1234), "1.2 kB");
  EXPECT_EQ(format_bytes(1000000), "1.0 MB");
  EXPECT_EQ(format_bytes(23400000), "23.4 MB");
  EXPECT_EQ(format_bytes(1000000000), "1.00 GB");
  EXPECT_EQ(format_bytes(139000000000), "139.00 GB");
}

TEST(Format, Counts) {
  EXPECT_EQ(format_count(0), "0");
  EXPECT_EQ(format_count(999), "999");
  EXPECT_EQ(format_count(1000), "1,000");
  EXPECT_EQ(format_count(1234567), "1,234,567");
  EXPECT_EQ(format_count(-1234), "-1,234");
  EXPECT_EQ(format_count(-123), "-123");
}

TEST(Format, Bars) {
  EXPECT_EQ(format_bar(0, 12), "[>         ]");
  EXPECT_EQ(format_bar(0.5, 12), "[=====>    ]");
  EXPECT_EQ(format_bar(1, 12), "[==========]");
  EXPECT_EQ(format_bar(7, 12), "[==========]");
}

TEST(Format, TrainProgress) {
  TrainProgress progress;
  progress.iteration = 740;
  progress.iterations = 2000;
  progress.loss = 0.0412;
  progress.n_gaussians = 84120;
  progress.activity = "densifying";
  EXPECT_EQ(format_train_progress(progress, 6.1, 207),
            " 37%  740/2000  6.1 it/s  ETA 3:27  loss 0.0412  84,120 Gaussians  densifying");
  EXPECT_EQ(format_train_progress(progress, 120, std::nullopt),
            " 37%  740/2000  120 it/s  loss 0.0412  84,120 Gaussians  densifying");
  progress.count_cap = 84200;
  EXPECT_EQ(format_train_progress(progress, 120, 207),
            " 37%  740/2000  120 it/s  ETA 3:27  loss 0.0412  84,120 Gaussians (capped: GPU memory)  densifying");
}

TEST(StatusLine, OnATerminalOneLineIsRedrawnAndCut) {
  double now = 0;
  std::ostringstream out;
  StatusLine status(out, 10, false, [&] { return now; });
  now = 1;
  status.show("0123456789abc");
  EXPECT_EQ(out.str(), "\r012345678\x1b[K");
  now = 1.01;
  status.show("too early");
  EXPECT_EQ(out.str(), "\r012345678\x1b[K");
  status.show("now", true);
  EXPECT_EQ(out.str(), "\r012345678\x1b[K\rnow\x1b[K");
}

TEST(StatusLine, OnATerminalMessagesAreAboveTheStatus) {
  std::ostringstream out;
  StatusLine status(out, 80, false, [] { return 0.0; });
  status.show("status", true);
  out.str("");
  status.print("message");
  EXPECT_EQ(out.str(), "\r\x1b[Kmessage\n\rstatus\x1b[K");
}

TEST(StatusLine, ElsewhereALineEveryTenSeconds) {
  double now = 0;
  std::ostringstream out;
  StatusLine status(out, 0, false, [&] { return now; });
  for (; now < 35; now += 1) status.show("at " + std::to_string(static_cast<int>(now)));
  EXPECT_EQ(out.str(), "at 10\nat 20\nat 30\n");
}

TEST(ShowLoading, AStageIsNamedWhenItBeginsAndWhenItEnds) {
  std::ostringstream out;
  StatusLine status(out, 0, false, [] { return 0.0; });
  const ProgressFn progress = show_loading(status);
  progress("matching", 0, 0);
  for (const std::size_t done : {0, 1, 2, 3}) progress("copying", done, 3);
  EXPECT_EQ(out.str(), "matching\ncopying 0/3\ncopying 3/3\n");
}

TEST(StatusLine, QuietShowsMessagesOnly) {
  std::ostringstream out;
  StatusLine status(out, 0, true, [] { return 100.0; });
  status.show("status", true);
  status.print("message");
  EXPECT_EQ(out.str(), "message\n");
}

TEST(TrainProgressView, ElsewhereALineEvery500IterationsAndAtTheEnd) {
  std::ostringstream out;
  StatusLine status(out, 0, false, [] { return 0.0; });
  TrainConfig config;
  config.iterations = 1200;
  TrainProgressView view(status, config);
  for (int i = 1; i <= 1200; ++i) {
    TrainProgress progress;
    progress.iteration = i;
    progress.iterations = 1200;
    progress.elapsed_s = 0.01 * i;
    progress.activity = "training";
    view(progress);
  }
  std::istringstream lines(out.str());
  std::vector<std::string> starts;
  for (std::string line; std::getline(lines, line);) starts.push_back(line.substr(0, line.find("  100 it/s")));
  EXPECT_EQ(starts, (std::vector<std::string>{" 41%  501/1200", " 83%  1001/1200", "100%  1200/1200"}));
}

TEST(ShowLoading, ElsewhereEndsWithOneLine) {
  std::ostringstream out;
  StatusLine status(out, 0, false, [] { return 0.0; });
  const ProgressFn progress = show_loading(status);
  for (std::size_t i = 1; i <= 50; ++i) progress("reading images", i, 50);
  EXPECT_EQ(out.str(), "reading images 50/50\n");
}

}  // namespace
}  // namespace b3dgs
