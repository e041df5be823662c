// Which configurations a comparison is told to train.
#include "compare/compare_config.h"

#include <gtest/gtest.h>

#include "support/expect_error.h"

namespace b3dgs {
namespace {

TEST(CompareConfig, AnEntryIsAKernelOrOptions) {
  TrainConfig base;
  base.iterations = 123;
  const auto entries =
      parse_configurations("naive,shared-memory+culling=square,mine:opacity-lr=0.5+random_background=true", base);
  ASSERT_EQ(entries.size(), 3u);
  EXPECT_EQ(entries[0].name, "naive");
  EXPECT_EQ(entries[0].config.kernel, "naive");
  EXPECT_EQ(entries[0].config.iterations, 123);
  EXPECT_EQ(entries[1].name, "shared-memory+culling=square");
  EXPECT_EQ(entries[1].config.kernel, "shared-memory");
  EXPECT_EQ(entries[1].config.culling, "square");
  EXPECT_EQ(entries[2].name, "mine");
  EXPECT_EQ(entries[2].config.opacity_lr, 0.5);
  EXPECT_TRUE(entries[2].config.random_background);
  EXPECT_EQ(entries[2].config.kernel, base.kernel);
  const auto paper = parse_configurations("naive,paper:kernel_candidates=combined/shared-memory", base);
  EXPECT_EQ(paper[1].config.kernel_candidates, (std::vector<std::string>{"combined", "shared-memory"}))
      << "commas separate configurations";
  EXPECT_EQ(parse_configurations("a:naive,b:naive", base).size(), 2u) << "one against itself measures the noise";
}

TEST(CompareConfig, OriginalIsWhatComesNearestToTheOriginalTrainer) {
  const auto entries = parse_configurations("original,b:original+kernel=paper,c:paper+culling=square", TrainConfig{});
  const TrainConfig& original = entries[0].config;
  EXPECT_EQ(original.kernel, "naive");
  EXPECT_EQ(original.backward_kernel, "per-pixel");
  EXPECT_EQ(original.culling, "square");
  EXPECT_EQ(original.tile, "16x16");
  EXPECT_EQ(entries[1].config.kernel, "paper") << "what stands later wins";
  EXPECT_EQ(entries[1].config.tile, "16x16");
  EXPECT_EQ(entries[2].config.backward_kernel, TrainConfig{}.backward_kernel);
  EXPECT_EQ(forward_candidates(entries[2].config), (std::vector<std::string>{"combined", "shared-memory"}));
}

TEST(CompareConfig, TellsOptionsOfTheForwardKernelFromOthers) {
  const auto entries =
      parse_configurations("naive,adaptive+kernel_policy=tracking,original,again:naive", TrainConfig{});
  const DifferingOptions kernels = differing_options(entries[0].config, entries[1].config);
  EXPECT_EQ(kernels.forward_kernel, (std::vector<std::string>{"kernel", "kernel_policy"}));
  EXPECT_TRUE(kernels.others.empty());
  EXPECT_EQ(differing_options(entries[0].config, entries[2].config).others,
            (std::vector<std::string>{"backward_kernel", "tile", "culling"}));
  EXPECT_TRUE(differing_options(entries[0].config, entries[3].config).empty());
}

TEST(CompareConfig, TheBaselineCanBeTrainedOnceMore) {
  const auto entries = parse_configurations("mine:naive+tile=16x8,adaptive", TrainConfig{});
  const Configuration again = repeat_baseline(entries);
  EXPECT_EQ(again.name, "mine_again");
  EXPECT_TRUE(differing_options(again.config, entries[0].config).empty());
  EXPECT_TRUE(test::fails_with<InputError>({"naive_again", "--noise"}, [] {
    repeat_baseline(parse_configurations("naive,naive_again:adaptive", TrainConfig{}));
  }));
}

TEST(CompareConfig, BadEntriesAreRefusedWithAReason) {
  const auto expect_refused = [](const std::string& text, const std::string& reason) {
    EXPECT_TRUE(test::fails_with<InputError>({reason}, [&] { parse_configurations(text, TrainConfig{}); })) << text;
  };
  expect_refused("naive,naiv", "invalid value for --kernel (expected one of naive");
  expect_refused("naive", "takes at least two");
  expect_refused("naive,naive", "occurs twice");
  expect_refused("naive,", "an empty part");
  expect_refused("naive,combined+", "an empty part");
  expect_refused("naive,combined+culing=square", "did you mean culling?");
  expect_refused("naive,combined+tile_width=8", "did you mean tile?");
  expect_refused("naive,combined+culling=round", "invalid value for --culling (expected one of");
  expect_refused("naive,combined+seed=3", "has to be the same for all");
  expect_refused("naive,combined+max_steps=3", "has to be the same for all");
  expect_refused("naive,init_ply=/tmp/x.ply", "cannot name a folder");
  expect_refused("naive,../x:combined",
                 "cannot name a folder; give it a name of letters, digits, _ - . + = instead: "
                 "NAME:combined");
  expect_refused("a:naive,a:combined", "a occurs twice; give one another name: NAME:combined");
  expect_refused("naive,combined+seeed=3", "b3dgs train --help lists them");
}

}  // namespace
}  // namespace b3dgs
