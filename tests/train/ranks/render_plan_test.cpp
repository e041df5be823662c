// Tests which rank renders which view.
#include "multi/render_plan.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

namespace b3dgs {
namespace {

using Work = std::vector<std::int64_t>;
using Ranks = std::vector<int>;

/// Returns the renderers of views whose work is known.
Ranks counted_renderers(const Work& work, int n_ranks) {
  RenderPlan plan(n_ranks);
  std::vector<std::int32_t> views;
  for (const std::int64_t w : work) {
    views.push_back(static_cast<std::int32_t>(views.size()));
    plan.set_work(views.back(), w);
  }
  return plan.renderers(views);
}

/// Returns the work of each rank.
Work work_of_ranks(const Ranks& renderers, const Work& work, int n_ranks) {
  Work sums(static_cast<std::size_t>(n_ranks));
  for (std::size_t v = 0; v < renderers.size(); ++v) sums[static_cast<std::size_t>(renderers[v])] += work[v];
  return sums;
}

TEST(RenderPlan, GivesTheLargestViewToTheIdlestRank) {
  EXPECT_EQ(counted_renderers({1, 9, 2, 3}, 2), (Ranks{1, 0, 1, 1}));
  EXPECT_EQ(work_of_ranks({1, 0, 1, 1}, {1, 9, 2, 3}, 2), (Work{9, 6}));
}

TEST(RenderPlan, EqualWorkIsDealtInTurn) {
  EXPECT_EQ(counted_renderers({7, 7, 7, 7, 7}, 2), (Ranks{0, 1, 0, 1, 0}));
  EXPECT_EQ(counted_renderers({0, 0, 0, 0}, 2), (Ranks{0, 1, 0, 1})) << "views of nothing";
}

TEST(RenderPlan, EachRankGetsOneOfAsManyViews) {
  EXPECT_EQ(counted_renderers({1, 100, 3}, 3), (Ranks{0, 1, 2}));
  EXPECT_EQ(counted_renderers({1, 100}, 3), (Ranks{0, 1}));
}

TEST(RenderPlan, RanksDifferByAtMostAView) {
  std::mt19937 random(3);
  for (int round = 0; round < 200; ++round) {
    const int n_ranks = 2 + round % 4;
    Work work(static_cast<std::size_t>(n_ranks + 1 + round % 20));
    for (std::int64_t& w : work) w = 1 + static_cast<std::int64_t>(random() % 1000);
    const Work loads = work_of_ranks(counted_renderers(work, n_ranks), work, n_ranks);
    const auto [least, most] = std::minmax_element(loads.begin(), loads.end());
    EXPECT_LE(*most - *least, *std::max_element(work.begin(), work.end()));
  }
}

TEST(RenderPlan, TakesAsManyViewsAtATimeAsRanksHaveRoomFor) {
  EXPECT_EQ(views_at_a_time(350000, 2000000, 2), 10u) << "five for each";
  EXPECT_EQ(views_at_a_time(1900000, 2000000, 8), 8u);
  EXPECT_EQ(views_at_a_time(1e8, 2000000, 8), 8u) << "one for each is the least";
  EXPECT_GE(views_at_a_time(0, 2000000, 2), 32u) << "all views of a step";
}

TEST(RenderPlan, ViewsWithoutACountAreExpectedToBeAverage) {
  RenderPlan plan(2);
  EXPECT_EQ(plan.renderers({4, 5, 6}), (Ranks{0, 1, 0})) << "nothing is known";
  plan.set_work(1, 10);
  plan.set_work(2, 30);
  // View 9 counts as 20, so rank 0 gets 30, and rank 1 gets 20 and then 10.
  EXPECT_EQ(plan.renderers({1, 9, 2}), (Ranks{1, 1, 0}));
  plan.set_work(1, 100);
  EXPECT_EQ(plan.renderers({1, 9, 2}), (Ranks{0, 1, 1})) << "the last count of a view";
}

}  // namespace
}  // namespace b3dgs
