#include "core/text.h"

#include <gtest/gtest.h>

#include <array>
#include <cstdio>

namespace b3dgs {
namespace {

/// Returns the word as a shell reads it.
std::string read_by_shell(const std::string& word) {
  std::FILE* pipe = popen(("printf %s " + word).c_str(), "r");
  std::string text;
  std::array<char, 256> part{};
  while (const std::size_t n = std::fread(part.data(), 1, part.size(), pipe)) text.append(part.data(), n);
  EXPECT_EQ(pclose(pipe), 0);
  return text;
}

TEST(ShellQuote, LeavesPlainPathsAsTheyAre) {
  EXPECT_EQ(shell_quote("out/garden_2/checkpoints/iteration_30.b3dgs"), "out/garden_2/checkpoints/iteration_30.b3dgs");
  EXPECT_EQ(shell_quote("/data/a-b+c,d=1:2"), "/data/a-b+c,d=1:2");
}

TEST(ShellQuote, AShellReadsTheWordBack) {
  for (const std::string word : {"scenes/Objekt Müller", "it's", "$HOME", "a;b", "`id`", "\"quoted\"", "a\\b", "*", "~",
                                 "(1)", "a\nb", "'", "#1", "a&b|c<d>e", "!1", "{a,b}", "[x]?"}) {
    EXPECT_NE(shell_quote(word), word);
    EXPECT_EQ(read_by_shell(shell_quote(word)), word);
  }
  EXPECT_EQ(shell_quote(""), "''");
}

}  // namespace
}  // namespace b3dgs
