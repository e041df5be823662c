#include "adaptive/load_statistics.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "core/check.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

template <class Count>
LoadStatistics of(const std::vector<Count>& values) {
  return load_statistics(values.data(), static_cast<std::int64_t>(values.size()));
}

/// Returns the Gini coefficient: the mean absolute difference of all pairs, divided by twice the mean.
double gini_of_pairs(const std::vector<std::int64_t>& values) {
  double differences = 0, total = 0;
  for (const std::int64_t a : values) {
    total += static_cast<double>(a);
    for (const std::int64_t b : values) differences += static_cast<double>(std::abs(a - b));
  }
  const auto n = static_cast<double>(values.size());
  return total > 0 ? differences / (2 * n * total) : 0;
}

void expect_as_sorted(std::vector<std::int64_t> values) {
  const LoadStatistics found = of(values);
  EXPECT_NEAR(found.gini, gini_of_pairs(values), 1e-12);
  std::sort(values.begin(), values.end());
  const auto at = [&](double share) {
    return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
  };
  EXPECT_EQ(found.n, static_cast<std::int64_t>(values.size()));
  EXPECT_EQ(found.min, values.front());
  EXPECT_EQ(found.median, at(0.5));
  EXPECT_EQ(found.p90, at(0.9));
  EXPECT_EQ(found.p99, at(0.99));
  EXPECT_EQ(found.max, values.back());
  double total = 0;
  for (const std::int64_t value : values) total += static_cast<double>(value);
  EXPECT_NEAR(found.mean, total / static_cast<double>(values.size()), 1e-9 * (1 + found.mean));
  for (std::size_t bin = 0; bin < found.log2_bins.size(); ++bin) {
    const double low = bin == 0 ? 0 : std::pow(2, bin - 1.0), high = bin == 0 ? 1 : std::pow(2, bin);
    const auto inside = std::count_if(values.begin(), values.end(), [&](std::int64_t value) {
      return static_cast<double>(value) >= low && static_cast<double>(value) < high;
    });
    EXPECT_EQ(found.log2_bins[bin], inside) << "bin " << bin;
  }
  EXPECT_GT(found.log2_bins.back(), 0) << "ends with the bin of the maximum";
}

TEST(LoadStatistics, AgreeWithSortingEverything) {
  std::mt19937 random(3);
  for (const int n : {1, 2, 3, 10, 100, 777}) {
    for (const double spread : {0.0, 1.0, 4.0}) {
      std::lognormal_distribution<double> values(3, spread);
      std::vector<std::int64_t> list;
      for (int i = 0; i < n; ++i) list.push_back(static_cast<std::int64_t>(values(random)) * (i % 5 != 0));
      SCOPED_TRACE(testing::Message() << n << " values, spread " << spread);
      expect_as_sorted(list);
    }
  }
}

TEST(LoadStatistics, OfLargeCounts) {
  expect_as_sorted({3, 1, 3, 0, 40'000'000, 3});
  expect_as_sorted({65535, 65536, 65537, 0, 7'000'000});
}

TEST(LoadStatistics, OfEqualValuesAndOfASingleLoadedOne) {
  EXPECT_NEAR(of(std::vector<std::int32_t>(1000, 8)).gini, 0, 1e-12);
  std::vector<std::int32_t> lonely(1000, 0);
  lonely[123] = 50;
  EXPECT_NEAR(of(lonely).gini, 0.999, 1e-12);
  EXPECT_EQ(of(lonely).p99, 0);
  EXPECT_EQ(of(std::vector<std::int32_t>(10, 0)).gini, 0);
  EXPECT_EQ(of(std::vector<std::int32_t>(10, 0)).log2_bins, (std::vector<std::int64_t>{10}));
}

TEST(LoadStatistics, OfNothingAreZero) {
  const LoadStatistics none = of(std::vector<std::int64_t>{});
  EXPECT_EQ(none.n, 0);
  EXPECT_EQ(none.max, 0);
  EXPECT_TRUE(none.log2_bins.empty());
}

TEST(LoadStatistics, PutPowersOfTwoIntoTheUpperBin) {
  EXPECT_EQ(of(std::vector<std::int32_t>{0, 1, 2, 3, 4, 7, 8}).log2_bins, (std::vector<std::int64_t>{1, 1, 2, 2, 1}));
}

TEST(LoadStatistics, RejectNegativeCounts) {
  EXPECT_TRUE(test::fails_with<LogicError>({"-4"}, [] { of(std::vector<std::int32_t>{1, -4}); }));
}

TEST(LoadStatistics, AsJsonHaveTheNamesOfTheLog) {
  const nlohmann::ordered_json json = to_json(of(std::vector<std::int64_t>{1, 3}));
  EXPECT_EQ(json.dump(), R"({"min":1,"median":1,"p90":1,"p99":1,"max":3,"mean":2.0,"gini":0.25,"log2_bins":[0,1,1]})");
}

}  // namespace
}  // namespace b3dgs
