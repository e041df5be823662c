// Tests that names from files cannot control a terminal.
#include <gtest/gtest.h>

#include <string>

#include "core/check.h"

namespace b3dgs {
namespace {

using detail::has_control_characters;
using detail::one_line;
using namespace std::string_literals;

TEST(OneLine, ReplacesWhatCouldControlATerminal) {
  for (const std::string& control :
       {"\x1b"s, "\n"s, "\0"s, "\x7f"s, "\xc2\x80"s, "\xc2\x9b"s, "\xc2\x9d"s, "\xc2\x9f"s, "\xe2\x80\xa8"s,
        "\xe2\x80\xa9"s, "\xe2\x80\xaa"s, "\xe2\x80\xae"s, "\xe2\x81\xa6"s, "\xe2\x81\xa9"s}) {
    const std::string name = "caf\xc3\xa9 " + control + "x.png";
    EXPECT_EQ(one_line(name), "caf\xc3\xa9 ?x.png") << testing::PrintToString(control);
    EXPECT_TRUE(has_control_characters(name)) << testing::PrintToString(control);
  }
}

TEST(OneLine, KeepsTextInUtf8) {
  // The neighbours of the refused ranges, and the limits of each length.
  const std::string text =
      " ~\xc2\xa0\xc3\xa9\xdf\xbf\xe0\xa0\x80\xe2\x80\xa7\xe2\x80\xaf\xe2\x81\xa5\xe2\x81\xaa\xed\x9f\xbf\xee\x80\x80"
      "\xef\xbf\xbf\xf0\x90\x80\x80\xf4\x8f\xbf\xbf";
  EXPECT_EQ(one_line(text), text);
  EXPECT_FALSE(has_control_characters(text));
  EXPECT_EQ(one_line(""), "");
}

TEST(OneLine, ReplacesEachByteThatIsNotUtf8) {
  EXPECT_EQ(one_line("caf\xe9_00.png"), "caf?_00.png");
  EXPECT_FALSE(has_control_characters("caf\xe9_00.png")) << "Latin-1";
  EXPECT_EQ(one_line("\x93\xfa\x96\x7b.png"), "???{.png");
  EXPECT_FALSE(has_control_characters("\x93\xfa\x96\x7b.png")) << "Shift-JIS";
  EXPECT_EQ(one_line("\xc3"), "?");
  EXPECT_EQ(one_line("\xe2\x80"), "??");
  EXPECT_EQ(one_line("\xc0\x9b"), "??") << "overlong";
  EXPECT_EQ(one_line("\xe0\x82\x9b"), "???") << "overlong";
  EXPECT_EQ(one_line("\xed\xa0\x80"), "???") << "a surrogate";
  EXPECT_EQ(one_line("\xf4\x90\x80\x80"), "????") << "above U+10FFFF";
  EXPECT_EQ(one_line("\xff\xfe"), "??");
}

}  // namespace
}  // namespace b3dgs
