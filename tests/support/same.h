// Compares files, or lists of numbers. A failure names the first difference, while EXPECT_EQ prints them whole and
// EXPECT_TRUE(a == b) prints "false". For tensors, use approx.h.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <iterator>

namespace b3dgs::test {

template <class Container>
testing::AssertionResult same(const Container& found, const Container& expected) {
  const auto [a, b] = std::mismatch(found.begin(), found.end(), expected.begin(), expected.end());
  if (a == found.end() && b == expected.end()) return testing::AssertionSuccess();
  const auto entry = [](const Container& of, const auto& at) {
    return at == of.end() ? "the end" : testing::PrintToString(*at).substr(0, 80);
  };
  return testing::AssertionFailure() << found.size() << " entries, expected " << expected.size()
                                     << "; first difference at " << std::distance(found.begin(), a) << ": "
                                     << entry(found, a) << ", expected " << entry(expected, b);
}

}  // namespace b3dgs::test
