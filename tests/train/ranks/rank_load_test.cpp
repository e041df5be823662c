// Figures of the ranks in the log, in the summary, and what is concluded from them.
#include "train/ranks/rank_load.h"

#include <gtest/gtest.h>

#include "core/check.h"

namespace b3dgs {
namespace {

TEST(RankLoad, ComparesTheBusiestRankWithTheMean) {
  RankLoad load(2);
  EXPECT_FALSE(load.take().has_value()) << "no step";
  load.add_step({30, 10}, {40, 0});
  load.add_step({10, 30}, {20, 20});
  const RankFigures figures = load.whole().value();
  EXPECT_EQ(figures.n_steps, 2);
  EXPECT_EQ(figures.entries, (std::vector<double>{20, 20})) << "means over steps hide it";
  EXPECT_DOUBLE_EQ(figures.busiest, (30 + 30) / 40.0);
  EXPECT_DOUBLE_EQ(figures.busiest_equal, (40 + 20) / 40.0);
  EXPECT_TRUE(figures.exchange_ms.empty()) << "nothing was timed";
  EXPECT_EQ(figures.wait_share(), 0);
}

TEST(RankLoad, AViewOfNothingIsEvenlyShared) {
  RankLoad load(2);
  load.add_step({0, 0}, {0, 0});
  EXPECT_EQ(load.whole()->busiest, 1);
}

TEST(RankLoad, TakesWhatHappenedSinceTheLastTime) {
  RankLoad load(2);
  load.add_step({4, 4}, {4, 4});
  load.set_totals({{100, 60, 1, 3, 10}, {60, 100, 1, 5, 12}});
  const RankFigures first = load.take().value();
  EXPECT_EQ(first.sent_bytes, (std::vector<double>{100, 60}));
  EXPECT_EQ(first.received_bytes, (std::vector<double>{60, 100}));
  EXPECT_EQ(first.exchange_ms, (std::vector<double>{3, 5}));
  EXPECT_EQ(first.wait_ms, (std::vector<double>{0, 2}));
  EXPECT_EQ(first.step_ms, 12);
  EXPECT_EQ(first.bytes_per_step(), 160);
  EXPECT_NEAR(first.wait_share(), 1 / 12.0, 1e-12);
  EXPECT_NEAR(first.exchange_share(), 4 / 12.0, 1e-12);

  load.add_step({4, 8}, {4, 8});
  load.add_step({4, 8}, {4, 8});
  load.set_totals({{120, 80, 3, 7, 30}, {80, 120, 3, 13, 32}});
  const RankFigures second = load.take().value();
  EXPECT_EQ(second.n_steps, 2);
  EXPECT_EQ(second.sent_bytes, (std::vector<double>{10, 10}));
  EXPECT_EQ(second.exchange_ms, (std::vector<double>{2, 4}));
  EXPECT_FALSE(load.take().has_value());
  EXPECT_EQ(load.whole()->n_steps, 3);
  EXPECT_NEAR(load.whole()->exchange_ms[1], 13 / 3.0, 1e-12);
}

TEST(RankLoad, SaysWhereTheTimeGoes) {
  RankLoad load(2);
  load.add_step({4, 4}, {4, 4});
  RankTotals first{1, 1, 2, 2, 20}, second{1, 1, 2, 4, 22};
  first.phase_ms = {4, 1, 0.5, 8, 0, 0.5, 6};
  second.phase_ms = {6, 1, 1, 8, 0, 2, 4};
  first.n_rounds = 3;
  second.n_rounds = 2;  // the times of the last one are not known there yet
  first.round_ms = 9;
  second.round_ms = 8;
  first.round_phase_ms = {3, 1.5, 4.5};
  second.round_phase_ms = {2, 2, 4};
  load.set_totals({first, second});
  const RankFigures figures = load.take().value();
  EXPECT_EQ(describe_steps(figures),
            "11.00 ms: project 2.50, record 0.50, splats 0.38, draw 4.00, sums 0.62, learn 2.50");
  EXPECT_EQ(figures.n_rounds, 2);
  EXPECT_EQ(describe_rounds(figures), "gather 1.0, plan 0.8, edit 1.8 ms each");
  const auto json = to_json(figures);
  EXPECT_EQ(json.at("phases_ms").at("project"), (std::vector<double>{2, 3}));
  EXPECT_EQ(json.at("round_ms"), (std::vector<double>{3, 4}));
  EXPECT_EQ(json.at("round_phases_ms").at("edit"), (std::vector<double>{1.5, 2}));

  load.add_step({4, 4}, {4, 4});
  load.set_totals({first, second});
  const RankFigures later = load.take().value();
  EXPECT_EQ(describe_steps(later) + describe_rounds(later), "") << "nothing was timed since";
  EXPECT_FALSE(to_json(later).contains("rounds"));
}

TEST(RankLoad, HasNoTimesUntilAllRanksHaveSome) {
  RankLoad load(2);
  load.add_step({4, 4}, {4, 4});
  load.set_totals({{1, 1, 1, 3, 10}, {1, 1, 0, 0, 0}});
  EXPECT_TRUE(load.whole()->exchange_ms.empty());
  EXPECT_FALSE(to_json(*load.whole()).contains("step_ms"));
}

TEST(RankLoad, SaysWhatRanksAreWorthInALine) {
  RankFigures figures;
  figures.n_steps = 5;
  figures.entries = {1, 1};
  figures.busiest = 1.07;
  figures.busiest_equal = 1.214;
  figures.sent_bytes = figures.received_bytes = {4.05e6, 4.05e6};
  EXPECT_EQ(describe(figures), "busiest 1.07 x the mean (1.21 x in equal parts), exchanged 8.1 MB per step");
  figures.exchange_ms = {1, 1.6};
  figures.wait_ms = {0, 0.6};
  figures.step_ms = 10;
  EXPECT_EQ(describe(figures), "busiest 1.07 x the mean (1.21 x in equal parts), waits 3 %, exchanged 8.1 MB per step");
}

std::string advice(double exchange_ms, double step_ms) {
  RankLoad load(2);
  load.add_step({4, 4}, {4, 4});
  load.set_totals({{1, 1, 10, 10 * exchange_ms, 10 * step_ms}, {1, 1, 10, 10 * exchange_ms, 10 * step_ms}});
  EXPECT_FALSE(load.advise(11, "GPU").has_value()) << "too early";
  const std::string text = load.advise(10, "GPU").value_or("");
  EXPECT_FALSE(load.advise(10, "GPU").has_value()) << "once";
  return text;
}

TEST(RankLoad, SaysIfOneProcessWouldBeAboutAsFast) {
  EXPECT_EQ(advice(6.1, 10), "exchange takes 61 % of a step; one GPU would be about as fast (see docs/distributed.md)");
  EXPECT_EQ(advice(1, 10), "") << "alone, a step would take 18 instead of 10";
}

TEST(RankLoad, RefusesAnotherNumberOfRanks) {
  RankLoad load(3);
  EXPECT_THROW(load.add_step({1, 2}, {1, 2}), LogicError);
}

}  // namespace
}  // namespace b3dgs
