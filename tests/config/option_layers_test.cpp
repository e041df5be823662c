// Tests presets, strategy defaults, and which value wins if several set an option.
#include "config/option_layers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "config/original_options.h"
#include "config/presets.h"
#include "config/train_options.h"
#include "core/files/atomic_file.h"
#include "support/expect_error.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Words = std::vector<std::string>;

GivenOptions given(const Words& words, const std::string& config_file = "") {
  CommandLine line("train", "Trains.");
  line.add(TrainConfig{}, "Training");
  EXPECT_TRUE(line.parse(words));
  return given_options(line, config_file);
}

Words joined(Words words, const Words& others) {
  words.insert(words.end(), others.begin(), others.end());
  return words;
}

TrainConfig resolved(const Words& words) {
  return resolve_options(given(words)).config;
}

const OptionRow& row_named(const std::vector<OptionRow>& rows, const std::string& name) {
  for (const OptionRow& row : rows) {
    if (row.name == name) return row;
  }
  throw InputError("no row " + name);
}

/// Returns a step count scaled as documented, computed in a different way than the code does.
int nearest_step(double steps) {
  const int below = static_cast<int>(steps);
  return std::max(1, steps - below >= 0.5 ? below + 1 : below);
}

TEST(OriginalOptions, AreAcceptedAndSayThatTheyHaveNoEffect) {
  CommandLine line("train", "");
  line.add(TrainConfig{}, "Training");
  add_original_options(line, OriginalScript::kTrain);
  ASSERT_TRUE(line.parse({"--debug", "--port", "6010", "--optimizer_type", "default", "--seed", "3"}));
  EXPECT_EQ(describe_original_options(line.given(), OriginalScript::kTrain),
            (Words{"--debug has no effect: only the original 3DGS code has it",
                   "--port 6010 has no effect: the page of a training is at --view PORT"}));
  EXPECT_EQ(given_options(line, ""), (GivenOptions{{"seed", 3}}));
  EXPECT_EQ(line.help_all().find("debug_from"), std::string::npos) << "not listed";
}

TEST(OriginalOptions, OfRenderAndMetricsAreAcceptedToo) {
  CommandLine line("render", "");
  add_original_options(line, OriginalScript::kModel);
  ASSERT_TRUE(line.parse({"--eval", "--skip_test", "-i", "images", "--data_device", "cpu", "--debug"}));
  EXPECT_EQ(
      describe_original_options(line.given(), OriginalScript::kModel),
      (Words{"--skip_test has no effect: choose views with render --path test|train and eval --split test|train",
             "--eval has no effect: the training's setting is used",
             "--images images has no effect: the training's setting is used",
             "--data_device cpu has no effect: photographs fill up to half of the free GPU memory, then host memory",
             "--debug has no effect: only the original 3DGS code has it"}));
}

TEST(GivenOptions, MustBeAnObject) {
  const test::TempDir temp;
  const std::string path = (temp / "config.json").string();
  for (const char* text : {"[1]", "3", "\"seed\"", "null"}) {
    write_file(path, text);
    EXPECT_TRUE(test::fails_with<InputError>({"not a JSON object", path}, [&] { given({}, path); })) << text;
  }
}

TEST(Presets, HaveARowForEveryName) {
  ASSERT_EQ(presets().size(), std::size(kPresetNames));
  for (std::size_t i = 0; i < presets().size(); ++i) EXPECT_STREQ(presets()[i].name, kPresetNames[i]);
  EXPECT_TRUE(presets()[0].values.empty()) << "inria changes nothing";
}

TEST(Presets, EveryRowNamesOptionsWithValuesInRange) {
  const std::set<std::string> not_allowed{"source_path", "model_path", "images",       "device", "seed",
                                          "preset",      "eval",       "steps_scaler", "batch"};
  for (const std::vector<OptionRow>* rows : {&presets(), &strategy_defaults()}) {
    for (const OptionRow& row : *rows) {
      const GivenOptions& values = row.values;
      TrainConfig config;
      EXPECT_NO_THROW(config_from_json(config, values, row.name)) << row.name;
      for (const auto& [name, value] : values.items()) {
        EXPECT_EQ(not_allowed.count(name), 0u) << row.name << " " << name;
        EXPECT_TRUE(config_to_json(config).contains(name)) << row.name << " " << name << ": no primary name";
      }
      EXPECT_FALSE(rows == &strategy_defaults() && values.contains("strategy")) << row.name;
    }
  }
}

TEST(Presets, StrategiesWithDefaultsExist) {
  for (const OptionRow& row : strategy_defaults()) {
    const bool exists = one_of<Strategy>().allows(row.name);
    EXPECT_TRUE(exists || row.values.empty()) << row.name;
    if (!exists || row.values.empty()) continue;
    const TrainConfig config = resolved({"--preset", "inria", "--strategy", row.name});
    const GivenOptions& values = row.values;
    for (const auto& [name, value] : values.items()) {
      EXPECT_EQ(config_to_json(config).at(name), value) << row.name << " " << name;
      if (name == "iterations") continue;  // if given, it turns --max_epochs off
      const std::string given_value = value.is_string() ? value.get<std::string>() : value.dump();
      EXPECT_TRUE(config_differences(
                      config, resolved({"--preset", "inria", "--strategy", row.name, "--" + name + "=" + given_value}))
                      .empty());
    }
  }
}

TEST(Presets, AllButOriginalAndDefaultHaveIterationsAndEndTheirScheduleWithin) {
  const auto check = [](const std::string& option, const OptionRow& row) {
    EXPECT_TRUE(row.values.contains("iterations")) << row.name << ": a schedule to scale";
    const TrainConfig config = resolved({option, row.name});
    EXPECT_LE(config.densify_until_iter, config.iterations) << row.name;
    EXPECT_LT(config.densify_from_iter, config.densify_until_iter) << row.name;
    EXPECT_TRUE(config.lr_final_scale == 1 || config.lr_decay_from_iter < config.iterations) << row.name;
    EXPECT_EQ(config.position_lr_max_steps, config.iterations) << row.name;
  };
  for (std::size_t i = 1; i < presets().size(); ++i) check("--preset", presets()[i]);
  for (const OptionRow& row : strategy_defaults()) check("--strategy", row);
}

TEST(Presets, HelpAndPageShowEveryValue) {
  const std::string help = presets_help(), page = presets_markdown();
  for (const OptionRow& row : presets()) {
    EXPECT_NE(page.find(std::string("- `") + row.name + "`: "), std::string::npos) << page;
    for (const auto& [name, value] : row.values.items()) {
      EXPECT_NE(help.find(" " + name + " " + option_value_text(value)), std::string::npos) << help;
      EXPECT_NE(page.find("| `--" + name + "` |"), std::string::npos) << page;
    }
  }
}

TEST(OptionLayers, OriginalIsTrainConfig) {
  EXPECT_TRUE(config_differences(TrainConfig{}, resolved({"--preset", "inria"})).empty());
}

TEST(OptionLayers, ThePresetIsQualityUnlessItOrAStrategyIsGiven) {
  EXPECT_TRUE(config_differences(resolved({"--preset", "quality"}), resolved({})).empty());
  EXPECT_EQ(resolved({}).densify_until_iter, 16000) << "the schedule of budget, scaled to 24,000 iterations";
  EXPECT_EQ(resolved({"--iterations", "12000"}).densify_until_iter, 8000) << "half of its schedule";
  EXPECT_EQ(resolved({"--preset", "fast", "--strategy", "default"}).densify_until_iter, 3000) << "a fifth of 15,000";
  for (const char* strategy : {"default", "mcmc"}) {
    EXPECT_TRUE(
        config_differences(resolved({"--preset", "inria", "--strategy", strategy}), resolved({"--strategy", strategy}))
            .empty());
  }
  const TrainConfig fast = resolved({"--preset", "fast", "--strategy", "mcmc"});
  EXPECT_EQ(fast.preset, "fast");
  EXPECT_EQ(fast.iterations, 6000);
  EXPECT_EQ(fast.densify_until_iter, 5000) << "the schedule of mcmc, scaled to 6000 iterations";
}

TEST(OptionLayers, AStrategyThatIsThePresetsOwnChangesNothing) {
  EXPECT_TRUE(config_differences(resolved({}), resolved({"--strategy", "budget"})).empty());
  EXPECT_TRUE(
      config_differences(resolved({"--iterations", "900"}), resolved({"--strategy", "budget", "--iterations", "900"}))
          .empty());
  EXPECT_TRUE(config_differences(resolved({"--preset", "fast"}), resolved({"--preset", "fast", "--strategy", "budget"}))
                  .empty());
  EXPECT_EQ(resolved({"--preset", "inria", "--strategy", "budget"}).gaussians_per_pixel, 1.5);
}

TEST(OptionLayers, WhatDiffersFromThePresetIsWhatWasGiven) {
  const auto changed = [](const Words& words) {
    const TrainConfig config = resolved(words);
    return config_differences(preset_options(config), config);
  };
  for (const char* preset : kPresetNames) EXPECT_EQ(changed({"--preset", preset}), Words{}) << preset;
  EXPECT_EQ(changed({}), Words{});
  EXPECT_EQ(changed({"--strategy", "mcmc"}), Words{});
  EXPECT_EQ(changed({"--preset", "fast", "--iterations", "300"}), Words{"iterations: 6000 -> 300"});
  EXPECT_EQ(changed({"--iterations", "300", "--opacity_lr", "0.5"}),
            (Words{"iterations: 24000 -> 300", "opacity_lr: 0.05 -> 0.5"}));
  TrainConfig limited = resolved({});
  limit_epochs(limited, 21, given({}));
  EXPECT_EQ(config_differences(preset_options(limited), limited), Words{"iterations: 24000 -> 3528"});
}

TEST(OptionLayers, GivenOptionsOverrideThePreset) {
  const GivenOptions fast = row_named(presets(), "fast").values;
  const TrainConfig config = resolved({"--preset", "fast"});
  for (const auto& [name, value] : fast.items()) EXPECT_EQ(config_to_json(config).at(name), value) << name;
  const TrainConfig other = resolved({"--preset", "fast", "--densify_until_iter", "1234"});
  EXPECT_EQ(other.densify_until_iter, 1234);
  EXPECT_EQ(other.iterations, config.iterations);
  // A value that equals TrainConfig's still counts as given.
  EXPECT_EQ(resolved({"--preset", "fast", "--sh_increase_interval", "1000"}).sh_increase_interval, 1000);
}

TEST(OptionLayers, TheCommandLineOverridesTheConfigFileWhichOverridesThePreset) {
  const test::TempDir folder;
  const std::string file = (folder.path() / "options.json").string();
  write_file(file, R"({"max-steps": 1000, "preset": "fast", "opacity_lr": 0.5})");
  const TrainConfig config = resolve_options(given({"--opacity_lr", "0.25"}, file)).config;
  EXPECT_EQ(config.preset, "fast");
  EXPECT_EQ(config.iterations, 1000);
  EXPECT_EQ(config.opacity_lr, 0.25);
}

TEST(OptionLayers, ErrorsNameTheOption) {
  EXPECT_TRUE(test::fails_with<InputError>({"--preset (expected one of inria, fast, quality, best"}, [&] {
    resolved({"--preset", "better"});
  }));
  EXPECT_TRUE(test::fails_with<InputError>({"--iterations (expected at least 1"}, [&] {
    resolved({"--preset", "fast", "--iterations", "0"});
  }));
  EXPECT_TRUE(test::fails_with<InputError>({"--steps_scaler (expected above 0"}, [&] {
    resolved({"--steps_scaler", "0"});
  }));
}

TEST(Schedule, OptionsCountedInIterationsAreMarked) {
  const TrainConfig config;
  visit_fields(config, [](const Option& option, const auto& value, const auto&, const char* help) {
    using Value = std::decay_t<decltype(value)>;
    const bool is_whole = std::is_same_v<Value, int> || std::is_same_v<Value, std::vector<int>>;
    const std::string name(option.name);
    const auto has = [&](const char* word) { return name.find(word) != std::string::npos; };
    if (name == "kernel_check_interval") return;  // the paper's value, whatever the schedule
    const bool is_in_steps =
        is_whole && (has("iter") || has("interval") || has("steps") || has("until") || has("epoch"));
    EXPECT_EQ(option.steps != Steps::kNone, is_in_steps) << name << ": " << help;
  });
}

TEST(Schedule, OfOriginalDoesNotFollowIterations) {
  for (const Words& words : {Words{"--preset", "inria"}, Words{"--strategy", "default"}}) {
    const TrainConfig config = resolved(joined(words, {"--iterations", "10000"}));
    EXPECT_EQ(config_differences(TrainConfig{}, config), Words{"iterations: 30000 -> 10000"});
  }
}

TEST(Schedule, OfAPresetOrStrategyFollowsIterations) {
  for (const Words& words : {Words{"--preset", "fast"}, Words{"--preset", "quality"}, Words{"--strategy", "mcmc"},
                             Words{"--strategy", "budget"}, Words{"--preset", "fast", "--strategy", "mcmc"},
                             Words{"--preset", "inria", "--strategy", "mcmc"}}) {
    SCOPED_TRACE(testing::PrintToString(words));
    const TrainConfig base = resolved(words);
    for (const int iterations : {10000, 333}) {
      const TrainConfig config =
          resolved(joined(words, {"--iterations", std::to_string(iterations), "--densify_until_iter", "77"}));
      const double scale = static_cast<double>(iterations) / base.iterations;
      EXPECT_EQ(config.iterations, iterations);
      EXPECT_EQ(config.densify_until_iter, 77) << "was given";
      EXPECT_EQ(config.position_lr_max_steps, iterations);
      EXPECT_EQ(config.sh_increase_interval, nearest_step(base.sh_increase_interval * scale));
      EXPECT_EQ(config.densify_from_iter, nearest_step(base.densify_from_iter * scale)) << "also TrainConfig's own";
      EXPECT_EQ(config.test_iterations, base.test_iterations) << "no part of the schedule";
      EXPECT_EQ(config.opacity_lr, base.opacity_lr);
    }
  }
}

TEST(Schedule, StepsScalerMultipliesAllAndIsAppliedOnce) {
  const TrainConfig half = resolved({"--preset", "inria", "--steps_scaler", "0.5", "--densify_until_iter", "101"});
  EXPECT_EQ(half.steps_scaler, 1) << "a stored config must not be scaled again";
  EXPECT_EQ(half.iterations, 15000);
  EXPECT_EQ(half.densify_until_iter, 51) << "given, and rounded to the nearest";
  EXPECT_EQ(half.test_iterations, (std::vector<int>{3500, 15000}));
  EXPECT_EQ(half.lr_decay_from_iter, 0) << "0 stays 0";
  EXPECT_EQ(half.max_gaussians, TrainConfig{}.max_gaussians);
  EXPECT_EQ(half.threads, TrainConfig{}.threads);
  const TrainConfig tiny = resolved({"--preset", "inria", "--steps_scaler", "1e-9"});
  EXPECT_EQ(tiny.iterations, 1);
  EXPECT_EQ(tiny.densify_from_iter, 1);
  EXPECT_EQ(resolved({"--preset", "inria", "--iterations", "2147483647"}).iterations, std::numeric_limits<int>::max());
  const TrainConfig both = resolved({"--preset", "fast", "--iterations", "10000", "--steps_scaler", "2"});
  EXPECT_EQ(both.iterations, 20000);
  EXPECT_EQ(both.position_lr_max_steps, 20000);
}

TEST(Schedule, ProductsOfStepsScalerThatDoNotFitAreRefused) {
  for (const Words& words :
       {Words{"--iterations", "3", "--steps_scaler", "1e300"}, Words{"--iterations", "3", "--steps_scaler", "1e9"},
        Words{"--steps_scaler", "1e9"}, Words{"--save_iterations", "2147483647", "--steps_scaler", "2"}}) {
    EXPECT_TRUE(test::fails_with<InputError>({"2147483647", "smaller --steps_scaler"}, [&] { resolved(words); }))
        << testing::PrintToString(words);
  }
  TrainConfig config = resolved({});
  EXPECT_TRUE(test::fails_with<InputError>({"--iterations 3 is to be multiplied by 1e+300"}, [&] {
    apply_at_resume(config, given({"--iterations", "3", "--steps_scaler", "1e300"}));
  }));
}

TEST(GivenMaxEpochs, IsOffIfIterationsAreGivenWithoutIt) {
  EXPECT_EQ(resolved({}).max_epochs, 400);
  EXPECT_EQ(resolved({"--strategy", "budget"}).max_epochs, 400);
  for (const Words& words : {Words{"--preset", "inria"}, Words{"--strategy", "mcmc"}, Words{"--iterations", "24000"},
                             Words{"--strategy", "budget", "--max_steps", "30000"}, Words{"--max_epochs", "0"},
                             Words{"--steps_scaler", "2", "--iterations", "500"}}) {
    EXPECT_EQ(resolved(words).max_epochs, 0) << testing::PrintToString(words);
  }
  EXPECT_EQ(resolved({"--iterations", "9000", "--max_epochs", "50"}).max_epochs, 50);
  EXPECT_EQ(resolved({"--steps_scaler", "0.1"}).max_epochs, 40);
  EXPECT_TRUE(
      test::fails_with<InputError>({"--max_epochs (expected at least 0"}, [&] { resolved({"--max_epochs=-1"}); }));
}

TEST(GivenMaxEpochs, AtResumeFollowsTheSameRules) {
  TrainConfig started = resolved({});
  limit_epochs(started, 21, given({}));
  TrainConfig config = started;
  apply_at_resume(config, given({}));
  EXPECT_TRUE(config_differences(started, config).empty());
  apply_at_resume(config, given({"--iterations", "20000"}));
  EXPECT_EQ(config.max_epochs, 0);
  EXPECT_EQ(config.iterations, 20000);
  EXPECT_EQ(config.densify_until_iter, started.densify_until_iter);
  config = started;
  apply_at_resume(config, given({"--max_epochs", "50", "--steps_scaler", "2"}));
  EXPECT_EQ(config.max_epochs, 100);
  EXPECT_EQ(config.iterations, started.iterations);
  // As in `b3dgs train` at a resume, only the end changes.
  EXPECT_LT(limit_epochs(config, 21, config_to_json(config)), 1);
  EXPECT_EQ(config.iterations, 2100);
  EXPECT_EQ(config.densify_until_iter, started.densify_until_iter);
}

TEST(GivenMaxEpochs, OfOlderFilesIsOff) {
  nlohmann::ordered_json older = config_to_json(resolved({}));
  older.erase("max_epochs");
  TrainConfig config;
  config_from_json(config, older, "config.json");
  EXPECT_EQ(limit_epochs(config, 1, GivenOptions::object()), 1);
  EXPECT_EQ(config.iterations, 24000);
}

TEST(ResumedOptions, TheSameCommandLineChangesNothing) {
  for (const Words& words : {Words{}, Words{"--max_epochs", "5"}, Words{"--max_epochs", "8", "--steps_scaler", "0.5"},
                             Words{"--preset", "fast"}, Words{"--preset", "fast", "--iterations", "10000"},
                             Words{"--preset", "quality", "--iterations", "9", "--steps_scaler", "0.3", "--eval"},
                             Words{"--steps_scaler", "0.3", "--iterations", "1000"}}) {
    const TrainConfig started = resolved(words);
    TrainConfig config = started;
    apply_at_resume(config, given(words));
    EXPECT_TRUE(config_differences(started, config).empty()) << testing::PrintToString(words);
  }
}

TEST(ResumedOptions, GivenOptionsChangeAndOthersKeepTheCheckpointsValues) {
  TrainConfig config = resolved({"--preset", "fast"});
  const int max_steps = config.position_lr_max_steps;
  apply_at_resume(config, given({"--iterations", "12000"}));
  EXPECT_EQ(config.preset, "fast");
  EXPECT_EQ(config.iterations, 12000);
  EXPECT_EQ(config.position_lr_max_steps, max_steps);
  TrainConfig original;
  EXPECT_TRUE(test::fails_with<InputError>({"was started with --preset inria"}, [&] {
    apply_at_resume(original, given({"--preset", "fast"}));
  }));
}

TEST(ResumedOptions, ThoseWithoutEffectAreNamed) {
  TrainConfig config = resolved({"--preset", "fast", "--max_gaussians", "500"});
  const TrainConfig started = config;
  EXPECT_EQ(apply_at_resume(config, given({"--gaussians_per_pixel", "30", "--steps_scaler", "2"})),
            (Words{"--gaussians_per_pixel 30 has no effect: the limit is --max_gaussians 500; change that",
                   "--steps_scaler 2 has no effect: when resuming, it multiplies only options given with it"}));
  EXPECT_TRUE(config_differences(started, config).empty());
  EXPECT_TRUE(apply_at_resume(config, given({"--max_gaussians", "0", "--gaussians_per_pixel", "30", "--steps_scaler",
                                             "2", "--iterations", "9"}))
                  .empty());
  EXPECT_EQ(config.gaussians_per_pixel, 30);
  EXPECT_EQ(config.iterations, 18);
}

TEST(DescribeOptions, NamesPresetAndWhereValuesAreFrom) {
  EXPECT_EQ(describe_options(resolve_options(given({"-s", "scene", "-m", "model", "--preset", "inria"}))),
            Words{"options     preset inria, strategy default"});
  EXPECT_EQ(describe_options(resolve_options(given({"--preset", "inria", "--iterations", "7000"})))[0],
            "options     preset inria, strategy default, schedule of 30,000 iterations, whatever --iterations");
  EXPECT_EQ(describe_options(resolve_options(given({"--preset", "inria", "--steps_scaler", "0.5"})))[0],
            "options     preset inria, strategy default, all numbers of iterations x 0.5");
  EXPECT_EQ(describe_options(resolve_options(given({"-s", "scene"})))[0],
            "options     preset quality, strategy budget");
  const Words lines = describe_options(
      resolve_options(given({"--preset", "fast", "--eval", "--iterations", "10000", "--culling", "square"})));
  std::string text;
  for (const std::string& line : lines) {
    text += line + "\n";
    EXPECT_LE(line.size(), 100u) << line;
  }
  EXPECT_EQ(text.rfind("options     preset fast, ", 0), 0u) << text;
  EXPECT_NE(text.find("its schedule x 1.667 for --iterations\n"), std::string::npos) << text;
  EXPECT_EQ(text.find("position_lr_max_steps"), std::string::npos) << "config.json has these: " << text;
  EXPECT_NE(text.find("\n  given     eval on, iterations 10000, culling square\n"), std::string::npos) << text;
  OptionLayers layers = resolve_options();
  layers.epoch_scale = limit_epochs(layers.config, 21, layers.given);
  EXPECT_EQ(describe_options(layers)[0],
            "options     preset quality, strategy budget, schedule x 0.147 for --max_epochs");
}

}  // namespace
}  // namespace b3dgs
