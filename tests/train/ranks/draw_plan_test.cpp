// Which rank draws which view.
#include "train/ranks/draw_plan.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <numeric>
#include <random>

namespace b3dgs {
namespace {

using Work = std::vector<std::int64_t>;
using Ranks = std::vector<int>;

TEST(DrawPlan, DealsViewsInTurnWithoutCounts) {
  EXPECT_EQ(equal_drawers(5, 2), (Ranks{0, 1, 0, 1, 0}));
  EXPECT_EQ(equal_drawers(2, 4), (Ranks{0, 1}));
  EXPECT_EQ(equal_drawers(0, 4), Ranks{});
}

TEST(DrawPlan, GivesTheLargestViewToTheIdlestRank) {
  EXPECT_EQ(counted_drawers({1, 9, 2, 3}, 2), (Ranks{1, 0, 1, 1}));
  EXPECT_EQ(work_of_ranks({1, 0, 1, 1}, {1, 9, 2, 3}, 2), (Work{9, 6}));
}

TEST(DrawPlan, EqualWorkIsDealtInTurn) {
  EXPECT_EQ(counted_drawers({7, 7, 7, 7, 7}, 2), equal_drawers(5, 2));
  EXPECT_EQ(counted_drawers({0, 0, 0, 0}, 2), equal_drawers(4, 2)) << "views of nothing";
}

TEST(DrawPlan, EachRankGetsOneOfAsManyViews) {
  EXPECT_EQ(counted_drawers({1, 100, 3}, 3), (Ranks{0, 1, 2}));
  EXPECT_EQ(counted_drawers({1, 100}, 3), (Ranks{0, 1}));
}

TEST(DrawPlan, RanksDifferByAtMostAView) {
  std::mt19937 random(3);
  for (int round = 0; round < 200; ++round) {
    const int n_ranks = 2 + round % 4;
    Work work(static_cast<std::size_t>(n_ranks + 1 + round % 20));
    for (std::int64_t& w : work) w = 1 + static_cast<std::int64_t>(random() % 1000);
    const Work loads = work_of_ranks(counted_drawers(work, n_ranks), work, n_ranks);
    const auto [least, most] = std::minmax_element(loads.begin(), loads.end());
    EXPECT_LE(*most - *least, *std::max_element(work.begin(), work.end()));
  }
}

TEST(DrawPlan, TakesAsManyViewsAtATimeAsRanksHaveRoomFor) {
  EXPECT_EQ(views_at_a_time(350000, 2000000, 2, true), 10u) << "five for each";
  EXPECT_EQ(views_at_a_time(4000000, 2000000, 2, true), 1u) << "half a view for each";
  EXPECT_EQ(views_at_a_time(1e8, 2000000, 2, true), 1u) << "more than fits: as few as possible";
  EXPECT_EQ(views_at_a_time(4000000, 2000000, 8, true), 4u) << "four views, each in two bands";
  EXPECT_EQ(views_at_a_time(2600000, 2000000, 8, true), 4u) << "each in two bands, rather than six in one or two";
  EXPECT_EQ(views_at_a_time(1900000, 2000000, 8, true), 8u) << "whole views";
  EXPECT_EQ(views_at_a_time(1e8, 2000000, 8, false), 8u) << "whole views: one for each rank";
  EXPECT_GE(views_at_a_time(0, 2000000, 2, true), 32u) << "all views of a step";
}

Ranks whole_drawers_of(const StepPlan& plan) {
  Ranks ranks;
  for (std::size_t v = 0; v < plan.size(); ++v) {
    EXPECT_EQ(plan[v].view, v);
    EXPECT_FALSE(plan[v].is_band());
    ranks.push_back(plan[v].rank);
  }
  return ranks;
}

std::vector<DrawPlan::PlannedView> views_of(const std::vector<std::int32_t>& indices) {
  std::vector<DrawPlan::PlannedView> views;
  for (const std::int32_t index : indices) views.push_back({index, 10});
  return views;
}

TEST(DrawPlan, ViewsWithoutACountAreExpectedToBeAverage) {
  DrawPlan plan(2);
  EXPECT_EQ(whole_drawers_of(plan.plan(0, views_of({4, 5, 6}), true)), (Ranks{0, 1, 0})) << "nothing is known";
  plan.set_work(1, 10);
  plan.set_work(2, 30);
  // View 9 counts as 20: 30 to rank 0, 20 and then 10 to rank 1.
  EXPECT_EQ(whole_drawers_of(plan.plan(3, views_of({1, 9, 2}), true)), (Ranks{1, 1, 0}));
}

TEST(DrawPlan, AStepKeepsItsAnswerUntilItIsForgotten) {
  DrawPlan plan(2);
  const auto views = views_of({0, 1, 2});
  const Ranks first = whole_drawers_of(plan.plan(6, views, true));
  plan.set_work(0, 1), plan.set_work(1, 1), plan.set_work(2, 100);
  EXPECT_EQ(whole_drawers_of(plan.plan(6, views, true)), first) << "it has been read ahead for";
  plan.forget_before(6);
  EXPECT_EQ(whole_drawers_of(plan.plan(6, views, true)), first) << "the step after iteration 6 is not before it";
  EXPECT_EQ(whole_drawers_of(plan.plan(9, views, true)), (Ranks{1, 1, 0}));
  plan.forget_before(9);
  EXPECT_EQ(whole_drawers_of(plan.plan(6, views, true)), (Ranks{1, 1, 0}));
}

TEST(DrawPlan, OtherViewsAreDecidedAnew) {
  DrawPlan plan(2);
  plan.plan(0, views_of({1, 2, 3}), true);
  EXPECT_EQ(plan.plan(0, views_of({1, 2, 7, 3}), true).size(), 4u);
}

std::vector<std::int32_t> edges(const Work& work, int n_bands) {
  std::vector<std::int32_t> edges;
  std::int32_t row = 0;
  for (const TileRowSpan& band : cut_rows(work, n_bands)) {
    EXPECT_EQ(band.begin, row) << "bands follow each other";
    row = band.end;
    edges.push_back(band.end);
  }
  EXPECT_EQ(edges.back(), TileRowSpan{}.end) << "no row is left out";
  edges.pop_back();
  return edges;
}

TEST(DrawPlan, CutsRowsAtEqualWork) {
  using Edges = std::vector<std::int32_t>;
  EXPECT_EQ(edges({1, 1, 1, 1, 1, 1}, 3), (Edges{2, 4}));
  EXPECT_EQ(edges({0, 0, 0, 0}, 2), Edges{2}) << "nothing is known";
  EXPECT_EQ(edges({8, 1, 1, 1, 1, 1, 1, 1, 1}, 2), Edges{1});
  EXPECT_EQ(edges({1, 1, 100, 1, 1}, 3), (Edges{2, 3})) << "at the nearest edges";
  EXPECT_EQ(edges({5}, 3), (Edges{0, 1})) << "more bands than rows";
  EXPECT_EQ(edges({}, 2), Edges{0});
}

/// The least work that the busiest of n_bands bands can have, by trying all cuts.
std::int64_t least_most(const std::vector<std::int64_t>& work, std::size_t begin, int n_bands) {
  std::int64_t own = 0, least = std::numeric_limits<std::int64_t>::max();
  for (std::size_t end = begin;; ++end) {
    if (n_bands > 1 || end == work.size()) {
      least = std::min(least, std::max(own, n_bands > 1 ? least_most(work, end, n_bands - 1) : 0));
    }
    if (end == work.size()) return least;
    own += work[end];
  }
}

TEST(DrawPlan, CutsRowsSoThatNoBandHasMoreWorkThanNeeded) {
  EXPECT_EQ(edges({1, 2, 9, 4, 1, 4}, 3), (std::vector<std::int32_t>{2, 3}))
      << "not at the edges nearest to equal parts";
  std::mt19937 random(1);
  for (int i = 0; i < 300; ++i) {
    std::vector<std::int64_t> work(random() % 9);
    for (std::int64_t& row : work) row = random() % 4 == 0 ? 0 : random() % 20;
    const int n_bands = 1 + static_cast<int>(random() % 5);
    std::int64_t most = 0;
    for (const TileRowSpan& band : cut_rows(work, n_bands)) {
      const auto end = std::min(static_cast<std::size_t>(band.end), work.size());
      most = std::max(most, std::accumulate(work.begin() + band.begin, work.begin() + static_cast<std::ptrdiff_t>(end),
                                            std::int64_t{0}));
    }
    EXPECT_EQ(most, least_most(work, 0, n_bands)) << "case " << i;
  }
}

TEST(DrawPlan, DividesViewsAmongMoreRanks) {
  DrawPlan plan(4);
  const StepPlan equal = plan.plan(0, {{3, 8}}, true);
  ASSERT_EQ(equal.size(), 4u);
  EXPECT_TRUE(is_banded(equal));
  for (int rank = 0; rank < 4; ++rank) EXPECT_EQ(equal[static_cast<std::size_t>(rank)].rows.begin, 2 * rank);
  plan.set_row_work(3, {10, 10, 10, 10, 0, 0, 0, 0});
  EXPECT_EQ(plan.plan(1, {{3, 8}}, true)[1].rows.begin, 1);
  EXPECT_EQ(plan.plan(2, {{3, 16}}, true)[1].rows.begin, 2) << "at twice the size";
  EXPECT_FALSE(is_banded(plan.plan(3, {{3, 8}}, false)));

  plan.set_row_work(5, {30, 30, 30, 30});  // three of four ranks
  const StepPlan two = plan.plan(4, {{3, 8}, {5, 4}}, true);
  ASSERT_EQ(two.size(), 4u);
  EXPECT_FALSE(two[0].is_band());
  for (std::size_t p = 0; p < 4; ++p) {
    EXPECT_EQ(two[p].view, p == 0 ? 0u : 1u);
    EXPECT_EQ(two[p].rank, static_cast<int>(p));
  }
}

TEST(DrawPlan, RanksWithoutARowDrawNothing) {
  DrawPlan plan(4);
  const StepPlan small = plan.plan(0, {{0, 2}}, true);
  for (const DrawnPart& part : small) EXPECT_LT(part.rows.begin, part.rows.end);
  EXPECT_LE(small.size(), 3u);
}

}  // namespace
}  // namespace b3dgs
