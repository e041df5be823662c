// docs/options.md and the help texts of all commands.
#include <gtest/gtest.h>

#include <sstream>

#include "app/common/commands.h"
#include "core/options/command_line.h"
#include "support/files.h"
#include "support/run_program.h"

namespace b3dgs {
namespace {

using test::Outcome;
using test::run_b3dgs;
using Words = std::vector<std::string>;

/// Returns the first line in which two texts differ.
std::string first_difference(const std::string& found, const std::string& expected) {
  std::istringstream a(found), b(expected);
  std::string line_a, line_b;
  for (int n = 1;; ++n) {
    const bool has_a = static_cast<bool>(std::getline(a, line_a)), has_b = static_cast<bool>(std::getline(b, line_b));
    if (!has_a && !has_b) return "none";
    if (has_a != has_b || line_a != line_b) {
      return "line " + std::to_string(n) + ": \"" + (has_a ? line_a : "") + "\", expected \"" + (has_b ? line_b : "") +
             "\"";
    }
  }
}

std::vector<Words> all_commands() {
  std::vector<Words> commands;
  for (const CommandName& command : kCommandNames) commands.push_back({command.name});
  commands.push_back({"bench", "step"});
  commands.push_back({"bench", "sweep"});
  return commands;
}

std::string joined(const Words& words) {
  return words.size() == 1 ? words[0] : words[0] + " " + words[1];
}

TEST(OptionsPage, IsUpToDate) {
  const Outcome page = run_b3dgs({"help-markdown"});
  ASSERT_EQ(page.exit_code, 0) << page.err;
  const std::string stored = test::read_bytes(B3DGS_SOURCE "/docs/options.md");
  EXPECT_TRUE(stored == page.out) << "docs/options.md is out of date; run scripts/update_options.sh; first difference: "
                                  << first_difference(stored, page.out);
}

TEST(OptionsPage, HasASectionForEveryCommandAndNoTableTwice) {
  const std::string page = run_b3dgs({"help-markdown"}).out;
  for (const Words& words : all_commands()) {
    EXPECT_NE(page.find("\n## b3dgs " + joined(words) + "\n"), std::string::npos) << joined(words);
  }
  const std::string row = "\n| `--position_lr_init` |";
  ASSERT_NE(page.find(row), std::string::npos);
  EXPECT_EQ(page.find(row), page.rfind(row)) << "compare and bench step refer to train";
  EXPECT_NE(page.find("\nSame as for `b3dgs train`.\n"), std::string::npos);
}

TEST(Help, OfTrainListsTheLiveView) {
  const Outcome help = run_b3dgs({"train", "--help"});
  EXPECT_NE(help.out.find("\n      --view"), std::string::npos) << help.out;
}

TEST(Help, IsShortForEveryCommandAndNamesAnExample) {
  for (Words words : all_commands()) {
    const std::string name = joined(words);
    words.emplace_back("--help");
    const Outcome help = run_b3dgs(words);
    EXPECT_EQ(help.exit_code, 0) << help.err;
    std::istringstream lines(help.out);
    std::size_t n_options = 0;
    for (std::string line; std::getline(lines, line);) {
      n_options += line.rfind("      --", 0) == 0 || (line.rfind("  -", 0) == 0 && line.find(", --") == 4);
      EXPECT_LE(line.size(), 120u) << line;
    }
    EXPECT_GE(n_options, 1u) << help.out;
    EXPECT_LE(n_options, CommandLine::kMaxShortHelp) << help.out;
    EXPECT_NE(help.out.find("\nUsage: b3dgs " + name + " "), std::string::npos) << help.out;
    EXPECT_NE(help.out.find("\nExample: b3dgs " + name + " "), std::string::npos) << help.out;
    EXPECT_NE(help.out.find("\nb3dgs " + name + " --help-all "), std::string::npos) << help.out;
    words.back() = "--help-all";
    const Outcome all = run_b3dgs(words);
    EXPECT_EQ(all.exit_code, 0) << all.err;
    EXPECT_GE(all.out.size() + 200, help.out.size());
  }
}

}  // namespace
}  // namespace b3dgs
