// Parsing of --configs.
#include "app/compare/compare_config.h"

#include <gtest/gtest.h>

#include "config/train_options.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

/// Treats all values of `base` as given.
std::vector<Configuration> parse(const std::string& text, const TrainConfig& base) {
  return parse_configurations(text, base, config_to_json(base));
}

TEST(CompareConfig, AnEntryIsAKernelOrOptions) {
  TrainConfig base;
  base.iterations = 123;
  const auto entries = parse("naive,shared-memory+culling=square,mine:opacity-lr=0.5+random_background=true", base);
  ASSERT_EQ(entries.size(), 3u);
  EXPECT_EQ(entries[0].name, "naive");
  EXPECT_EQ(entries[0].config.kernel, "naive");
  EXPECT_EQ(entries[0].config.iterations, 123);
  EXPECT_EQ(entries[1].name, "shared-memory+culling=square");
  EXPECT_EQ(entries[1].config.kernel, "shared-memory");
  EXPECT_EQ(entries[1].config.culling, Culling::kSquare);
  EXPECT_EQ(entries[2].name, "mine");
  EXPECT_EQ(entries[2].config.opacity_lr, 0.5);
  EXPECT_TRUE(entries[2].config.random_background);
  EXPECT_EQ(entries[2].config.kernel, base.kernel);
  EXPECT_TRUE(parse("a:no-antialiasing=false,naive", base)[0].config.antialiasing) << "a negated flag";
  EXPECT_EQ(parse("naive,early:save_iterations=1000/7000", base)[1].config.save_iterations,
            (std::vector<int>{1000, 7000}))
      << "commas separate configurations";
  const auto often = parse("naive,fast:published+kernel_check_interval=200", base);
  EXPECT_EQ(often[1].config.kernel, "published");
  EXPECT_EQ(often[1].config.kernel_check_interval, 200);
  EXPECT_EQ(parse("a:naive,b:naive", base).size(), 2u) << "training the same twice measures the run-to-run variation";
}

TEST(CompareConfig, NaiveKernelsSelectsTheOptionsClosestToTheOriginalTrainer) {
  const auto entries = parse("naive-kernels,b:naive-kernels+kernel=dynamic", TrainConfig{});
  EXPECT_EQ(entries[0].config.kernel, "naive");
  EXPECT_EQ(entries[0].config.culling, Culling::kSquare);
  EXPECT_EQ(entries[1].config.kernel, "dynamic") << "later parts override earlier ones";
  EXPECT_EQ(entries[1].config.culling, Culling::kSquare);
}

TEST(CompareConfig, PaperStandsForTheTwoConfigurationsOfThePaper) {
  const auto names_and_kernels = [](const std::vector<Configuration>& entries) {
    std::string text;
    for (const Configuration& own : entries)
      text += own.name + ": " + own.config.kernel + " " + name_of(own.config.culling) + "\n";
    return text;
  };
  const std::string pair = "naive-kernels: naive square\npublished: published square\n";
  EXPECT_EQ(names_and_kernels(parse("paper", TrainConfig{})), pair);
  EXPECT_EQ(names_and_kernels(parse("adaptive,paper,sub-tile", TrainConfig{})),
            "adaptive: adaptive ellipse\n" + pair + "sub-tile: sub-tile ellipse\n");
  EXPECT_TRUE(test::fails_with<InputError>({"naive-kernels occurs twice"},
                                           [] { parse("naive-kernels,paper", TrainConfig{}); }));
}

TEST(CompareConfig, FewPhotographsLimitEachConfigurationByItsMaxEpochs) {
  const GivenOptions given{{"densify_until_iter", 16000}};
  const auto entries = parse_configurations(
      "quality:preset=quality,balanced:preset=inria+strategy=budget,fast:preset=fast,"
      "all:iterations=24000,given:opacity_reset_interval=2400,off:max_epochs=0",
      resolve_options(given).config, given, 21);
  std::vector<int> iterations;
  for (const Configuration& entry : entries) iterations.push_back(entry.config.iterations);
  EXPECT_EQ(iterations, (std::vector<int>{3528, 3528, 3528, 24000, 3528, 24000}));
  EXPECT_EQ(entries[0].config.opacity_reset_interval, 350);
  EXPECT_EQ(350 % entries[0].config.densification_interval, 0) << "resets follow a round of growth";
  EXPECT_EQ(entries[0].config.densify_until_iter, 16000) << "given for all";
  EXPECT_EQ(entries[4].config.opacity_reset_interval, 2400) << "its own option";
  EXPECT_EQ(parse_configurations("a:naive,b:naive", resolve_options(given).config, given)[0].config.iterations, 24000)
      << "the scene is not known yet";
}

TEST(CompareConfig, PresetsApplyBelowWhatIsGiven) {
  const GivenOptions given{{"opacity_lr", 0.5}, {"densify_until_iter", 321}};
  const TrainConfig base = resolve_options(given).config;
  const auto entries = parse_configurations(
      "inria:preset=inria,fast:preset=fast,short:preset=fast+iterations=70+opacity_lr=0.25", base, given);
  const TrainConfig original = resolve_options({{"preset", "inria"}}).config;
  EXPECT_EQ(entries[0].config.iterations, original.iterations);
  EXPECT_EQ(entries[0].config.opacity_lr, 0.5) << "given for all";
  const TrainConfig fast = resolve_options({{"preset", "fast"}}).config;
  EXPECT_EQ(entries[1].config.iterations, fast.iterations);
  EXPECT_EQ(entries[1].config.position_lr_max_steps, fast.position_lr_max_steps);
  EXPECT_EQ(entries[1].config.opacity_lr, 0.5) << "given for all";
  EXPECT_EQ(entries[1].config.densify_until_iter, 321);
  EXPECT_EQ(entries[2].config.iterations, 70);
  EXPECT_EQ(entries[2].config.position_lr_max_steps, 70) << "the preset's schedule follows";
  EXPECT_EQ(entries[2].config.opacity_lr, 0.25);
}

TEST(CompareConfig, SeparatesOptionsOfTheKernelFromOthers) {
  const auto entries = parse("naive,adaptive+kernel_check_interval=200,naive-kernels,again:naive", TrainConfig{});
  const DifferingOptions kernels = differing_options(entries[0].config, entries[1].config);
  EXPECT_EQ(kernels.kernel, (std::vector<std::string>{"kernel", "kernel_check_interval"}));
  EXPECT_TRUE(kernels.others.empty());
  EXPECT_EQ(differing_options(entries[0].config, entries[2].config).others, (std::vector<std::string>{"culling"}));
  EXPECT_TRUE(differing_options(entries[0].config, entries[3].config).empty());
}

TEST(CompareConfig, TheBaselineCanBeRepeated) {
  const auto entries = parse("mine:naive+culling=square,adaptive", TrainConfig{});
  const Configuration again = repeat_baseline(entries);
  EXPECT_EQ(again.name, "mine_again");
  EXPECT_TRUE(differing_options(again.config, entries[0].config).empty());
  EXPECT_TRUE(test::fails_with<InputError>(
      {"naive_again", "--noise"}, [] { repeat_baseline(parse("naive,naive_again:adaptive", TrainConfig{})); }));
}

TEST(CompareConfig, RejectsInvalidEntriesWithAReason) {
  const auto expect_rejected = [](const std::string& text, const std::string& reason) {
    EXPECT_TRUE(test::fails_with<InputError>({reason}, [&] { parse(text, TrainConfig{}); })) << text;
  };
  expect_rejected("naive,naiv", "--configs naiv: unknown configuration \"naiv\" (expected naive, dynamic");
  expect_rejected("naive,naiv", "or option=value); did you mean naive?");
  expect_rejected("naive,fast", "did you mean preset=fast?");
  expect_rejected("naive", "needs at least two configurations");
  expect_rejected("naive,naive", "occurs twice");
  expect_rejected("naive,", "empty part");
  expect_rejected("naive,combined+", "empty part");
  expect_rejected("naive,combined+culing=square", "did you mean culling?");
  expect_rejected("naive,combined+culling_mode=square", "did you mean culling?");
  expect_rejected("naive,combined+culling=round",
                  "--configs combined+culling=round: invalid value for --culling (expected one of");
  expect_rejected("naive,combined+seed=3", "must be the same for all");
  expect_rejected("naive,combined+s=1", "source_path must be the same for all");
  expect_rejected("naive,combined+data_factor=3", "must be the same for all");
  for (const char* read_once : {"masks=none", "invert_masks=true", "mask_mode=segment", "host_memory_gb=2"}) {
    expect_rejected(std::string("naive,other:naive+") + read_once, "must be the same for all configurations");
  }
  expect_rejected("naive,init_ply=/tmp/x.ply", "cannot be a folder name");
  expect_rejected("naive,../x:combined",
                  "cannot be a folder name; name it with letters, digits, _ - . + = instead: "
                  "NAME:combined");
  expect_rejected("naive,compare.json:combined", "is the name of a file that the comparison writes");
  expect_rejected("report.html:naive,combined", "is the name of a file that the comparison writes");
  expect_rejected("a:naive,a:combined", "a occurs twice; rename one of them: NAME:combined");
  for (const char* other : {"seeed=3", "help=1", "data=foo"}) {
    expect_rejected(std::string("naive,combined+") + other, "; see b3dgs train --help-all");
  }
}

}  // namespace
}  // namespace b3dgs
