#include "model/neighbors.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "core/check.h"
#include "core/parallel.h"

namespace b3dgs {
namespace {

// Reference implementation: all pairs, in double precision.
std::vector<double> brute_force(const std::vector<float>& p) {
  const std::size_t n = p.size() / 3;
  std::vector<double> result(n);
  for (std::size_t i = 0; i < n; ++i) {
    std::vector<double> squared;
    for (std::size_t j = 0; j < n; ++j) {
      if (i == j) continue;
      double sum = 0;
      for (int k = 0; k < 3; ++k) sum += (double{p[3 * i + k]} - p[3 * j + k]) * (double{p[3 * i + k]} - p[3 * j + k]);
      squared.push_back(sum);
    }
    std::sort(squared.begin(), squared.end());
    squared.resize(std::min<std::size_t>(3, squared.size()));
    double sum = 0;
    for (const double value : squared) sum += value;
    result[i] = std::max(1e-7, squared.empty() ? 0.0 : sum / static_cast<double>(squared.size()));
  }
  return result;
}

void expect_as_brute_force(const std::vector<float>& positions) {
  const std::vector<float> found = mean_squared_neighbor_distances(positions);
  const std::vector<double> expected = brute_force(positions);
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i)
    EXPECT_NEAR(found[i], expected[i], 1e-6 * expected[i]) << "point " << i;
}

// Returns points similar to LiDAR: a ground plane and walls with a spacing that grows a hundredfold, and duplicates.
std::vector<float> uneven_cloud(int n) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(0, 1);
  std::vector<float> p;
  for (int i = 0; i < n; ++i) {
    if (i % 10 == 9) {
      p.insert(p.end(), p.end() - 3, p.end());
      continue;
    }
    const float radius = std::exp(uniform(random) * 5 - 1), angle = uniform(random) * 6.2832f;
    p.push_back(radius * std::cos(angle));
    p.push_back(uniform(random) < 0.7f ? 0.0f : 3 * uniform(random));
    p.push_back(radius * std::sin(angle) + 1000);
  }
  return p;
}

TEST(Neighbors, FourCornersOfASquare) {
  // Two sides of 2 and a diagonal: (4 + 4 + 8) / 3.
  const auto d = mean_squared_neighbor_distances({0, 0, 0, 2, 0, 0, 0, 2, 0, 2, 2, 0});
  for (const float value : d) EXPECT_FLOAT_EQ(value, 16.0f / 3.0f);
}

TEST(Neighbors, UseFewerNeighborsInSmallClouds) {
  EXPECT_TRUE(mean_squared_neighbor_distances({}).empty());
  EXPECT_EQ(mean_squared_neighbor_distances({1, 2, 3}), std::vector<float>{1e-7f});
  EXPECT_EQ(mean_squared_neighbor_distances({0, 0, 0, 0, 3, 0}), (std::vector<float>{9, 9}));
}

TEST(Neighbors, DuplicatesAreAtDistanceZeroAndTheResultHasAFloor) {
  std::vector<float> same;
  for (int i = 0; i < 500; ++i) same.insert(same.end(), {1, 2, 3});
  for (const float value : mean_squared_neighbor_distances(same)) EXPECT_EQ(value, 1e-7f);
}

TEST(Neighbors, EqualBruteForceForEverySizeAroundTheLeafSize) {
  const std::vector<float> cloud = uneven_cloud(60);
  for (std::size_t n = 2; n <= 60; ++n) expect_as_brute_force({cloud.begin(), cloud.begin() + 3 * n});
}

TEST(Neighbors, EqualBruteForceOnAVeryUnevenCloud) {
  expect_as_brute_force(uneven_cloud(3000));
}

TEST(Neighbors, EqualBruteForceOnALatticeFullOfTies) {
  std::vector<float> lattice;
  for (int x = 0; x < 10; ++x)
    for (int y = 0; y < 10; ++y)
      for (int z = 0; z < 10; ++z) lattice.insert(lattice.end(), {1.0f * x, 1.0f * y, 1.0f * z});
  expect_as_brute_force(lattice);
}

TEST(Neighbors, DoNotDependOnTheNumberOfThreads) {
  const std::vector<float> cloud = uneven_cloud(20000);
  const int before = thread_count();
  set_thread_count(1);
  const auto one = mean_squared_neighbor_distances(cloud);
  set_thread_count(3);
  const auto three = mean_squared_neighbor_distances(cloud);
  set_thread_count(before);
  EXPECT_EQ(one, three);
}

TEST(Neighbors, RejectPositionsThatAreNotFinite) {
  EXPECT_THROW(mean_squared_neighbor_distances({0, 0, 0, NAN, 0, 0}), LogicError);
}

}  // namespace
}  // namespace b3dgs
