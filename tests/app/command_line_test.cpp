// Names, conversions and precedence on the command line, with the training options as an example.
#include "core/command_line.h"

#include <gtest/gtest.h>

#include "core/files/atomic_file.h"
#include "data_synth/synth_config.h"
#include "support/temp_dir.h"
#include "train/config/train_config.h"

namespace b3dgs {
namespace {

using Words = std::vector<std::string>;

TrainConfig parse(const Words& words) {
  CommandLine line("train", "Trains.");
  line.add(TrainConfig{}, "Training");
  TrainConfig config;
  EXPECT_TRUE(line.parse(words));
  line.apply(config);
  return config;
}

std::string complaint(const Words& words) {
  try {
    parse(words);
  } catch (const InputError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(CommandLine, LeavesDefaultsWhereNothingIsGiven) {
  EXPECT_TRUE(config_differences(TrainConfig{}, parse({})).empty());
}

TEST(CommandLine, TakesUnderscoresAndHyphensInNames) {
  EXPECT_EQ(parse({"--densify_grad_threshold", "0.001"}).densify_grad_threshold, 0.001);
  EXPECT_EQ(parse({"--densify-grad-threshold", "0.001"}).densify_grad_threshold, 0.001);
  EXPECT_EQ(parse({"--densify-grad_threshold=0.001"}).densify_grad_threshold, 0.001);
}

TEST(CommandLine, LeavesHyphensInValues) {
  EXPECT_EQ(parse({"--kernel", "gaussian-wise"}).kernel, "gaussian-wise");
  EXPECT_EQ(parse({"--model-path=out-of-band"}).model_path, "out-of-band");
}

TEST(CommandLine, TakesTheLettersOfTheOriginal) {
  const TrainConfig config = parse({"-s", "scene", "-m", "model", "-i", "images_4", "-r", "4", "-w"});
  EXPECT_EQ(config.source_path, "scene");
  EXPECT_EQ(config.model_path, "model");
  EXPECT_EQ(config.images, "images_4");
  EXPECT_EQ(config.resolution, 4);
  EXPECT_TRUE(config.white_background);
}

TEST(CommandLine, TakesANegativeNumberAfterALetter) {
  EXPECT_EQ(parse({"-r", "-1"}).resolution, -1);
}

TEST(CommandLine, TakesNamesOfOtherTrainers) {
  const TrainConfig config =
      parse({"--data_dir", "scene", "--data-factor", "2", "--max_steps", "7000", "--max-cap", "1000000"});
  EXPECT_EQ(config.source_path, "scene");
  EXPECT_EQ(config.resolution, 2);
  EXPECT_EQ(config.iterations, 7000);
  EXPECT_EQ(config.max_gaussians, 1000000);
}

TEST(CommandLine, EveryOptionAndEveryAliasIsAccepted) {
  const TrainConfig defaults;
  visit_fields(defaults, [](const Option& option, const auto& value, const auto&, const char*) {
    std::vector<std::string> names{std::string(option.name)};
    names.insert(names.end(), option.other.begin(), option.other.end());
    for (const std::string& name : names) {
      Words words{"--" + name};
      if constexpr (!std::is_same_v<std::decay_t<decltype(value)>, bool>) {
        const nlohmann::json json = value;
        words.push_back(json.is_string() ? json.get<std::string>() : json.is_array() ? "5" : json.dump());
        if (option.name == "kernel_candidates") words.back() = "naive,combined";
        if (words.back().empty()) words.back() = "x";
      }
      EXPECT_EQ(complaint(words), "accepted") << name;
    }
  });
}

TEST(CommandLine, TakesSeveralValuesForAList) {
  const TrainConfig config = parse({"--test_iterations", "10", "20", "30", "--seed", "5"});
  EXPECT_EQ(config.test_iterations, (std::vector<int>{10, 20, 30}));
  EXPECT_EQ(config.seed, 5);
}

TEST(CommandLine, TakesAListWithoutValuesAsEmpty) {
  EXPECT_TRUE(parse({"--test_iterations", "--seed", "5"}).test_iterations.empty());
  EXPECT_TRUE(parse({"--save_iterations"}).save_iterations.empty());
}

TEST(CommandLine, TakesAListOfNamesWithCommasOrSpaces) {
  const Words wanted{"naive", "gaussian-wise", "combined"};
  EXPECT_EQ(parse({"--kernel_candidates", "naive,gaussian-wise,combined"}).kernel_candidates, wanted);
  EXPECT_EQ(parse({"--kernel-candidates", "naive", "gaussian-wise", "combined", "--seed", "2"}).kernel_candidates,
            wanted);
  EXPECT_EQ(parse({"--kernel_candidates=naive,gaussian-wise,combined"}).kernel_candidates, wanted);
}

TEST(CommandLine, RefusesListsOfNamesThatAreNoChoice) {
  for (const char* value :
       {"combined", "combined,combined", "combined,fast", "combined,adaptive", ",", "combined,,naive"}) {
    const std::string found = complaint({"--kernel_candidates", value});
    EXPECT_NE(found.find("kernel_candidates must be at least 2 different ones of naive, dynamic"), std::string::npos)
        << value << ": " << found;
  }
  EXPECT_NE(complaint({"--kernel_policy", "eager"}).find("one of paper, tracking"), std::string::npos);
  EXPECT_NE(complaint({"--kernel_check_views", "2"}).find("at least 3"), std::string::npos);
  EXPECT_NE(complaint({"--kernel_check_interval", "0"}).find("at least 1"), std::string::npos);
  EXPECT_NE(complaint({"--kernel", "fastest"}).find("segmented, paper, adaptive"), std::string::npos);
  EXPECT_NE(complaint({"--backward_kernel", "naive"}).find("per-pixel, per-splat, adaptive"), std::string::npos);
}

TEST(CommandLine, FlagsCanBeTurnedOnAndOff) {
  EXPECT_TRUE(parse({"--eval"}).eval);
  EXPECT_TRUE(parse({"--eval", "true"}).eval);
  EXPECT_TRUE(parse({"--eval=true"}).eval);
  EXPECT_FALSE(parse({"--eval", "false"}).eval);
  EXPECT_FALSE(parse({"--eval", "--no-eval"}).eval);
  EXPECT_EQ(parse({"--eval", "--seed", "3"}).seed, 3);
}

TEST(CommandLine, TheLastOfTwoWins) {
  EXPECT_EQ(parse({"--iterations", "10", "--iterations", "20"}).iterations, 20);
}

TEST(CommandLine, AnUnknownOptionIsAnErrorThatNamesTheNearest) {
  EXPECT_EQ(complaint({"--iteratons", "5"}), "command line: unknown option --iteratons; did you mean --iterations?");
  EXPECT_EQ(complaint({"--iter=5"}), "command line: unknown option --iter; did you mean --iterations?");
  EXPECT_EQ(complaint({"--densify-untill-iter", "5"}),
            "command line: unknown option --densify_untill_iter; did you mean --densify_until_iter?");
  EXPECT_EQ(complaint({"--qqqqq"}), "command line: unknown option --qqqqq; see b3dgs train --help");
  EXPECT_EQ(complaint({"-x"}), "command line: unknown option -x; see b3dgs train --help");
}

TEST(CommandLine, AWordTooManyIsAnError) {
  EXPECT_EQ(complaint({"scene"}), "command line: unexpected argument \"scene\"");
}

TEST(CommandLine, MalformedValuesAreNamed) {
  EXPECT_EQ(complaint({"--iterations", "abc"}), "command line: iterations must be a whole number, found \"abc\"");
  EXPECT_EQ(complaint({"--iterations", "3e4"}), "command line: iterations must be a whole number, found \"3e4\"");
  EXPECT_EQ(complaint({"--iterations", "99999999999"}),
            "command line: iterations must be a whole number from -2147483648 to 2147483647, found \"99999999999\"");
  EXPECT_EQ(complaint({"--iterations", "1.5"}), "command line: iterations must be a whole number, found \"1.5\"");
  EXPECT_EQ(complaint({"--seed", "9223372036854775808"}),
            "command line: seed must be a whole number from -9223372036854775808 to 9223372036854775807, found "
            "\"9223372036854775808\"");
  EXPECT_EQ(complaint({"--test_iterations", "5", "1.9"}),
            "command line: test_iterations must be a whole number, found \"1.9\"");
  EXPECT_EQ(complaint({"--opacity_lr", "0.1x"}), "command line: opacity_lr must be a number, found \"0.1x\"");
  EXPECT_EQ(complaint({"--opacity_lr", "nan"}), "command line: opacity_lr must be a number, found \"nan\"");
  EXPECT_EQ(complaint({"--eval=maybe"}), "command line: eval must be true or false, found \"maybe\"");
  EXPECT_NE(complaint({"--iterations"}).find("--iterations"), std::string::npos);
}

TEST(CommandLine, ValuesOutOfRangeAreNamedWithTheRange) {
  EXPECT_EQ(complaint({"--iterations", "0"}), "command line: iterations must be at least 1, found 0");
  EXPECT_EQ(complaint({"--lambda_dssim", "1.5"}), "command line: lambda_dssim must be from 0 to 1, found 1.5");
  EXPECT_EQ(complaint({"--device", "tpu"}), "command line: device must be one of auto, cpu, cuda, found \"tpu\"");
  EXPECT_EQ(complaint({"--test_iterations", "5", "-1"}),
            "command line: test_iterations must be at least 1, found [5,-1]");
}

TEST(CommandLine, PositionalWordsFillTheirFields) {
  CommandLine line("synth", "Writes.");
  line.add(SynthConfig{}, "Scene", {"scene", "output"});
  ASSERT_TRUE(line.parse({"street", "folder", "--views", "3"}));
  SynthConfig config;
  line.apply(config);
  EXPECT_EQ(config.scene, "street");
  EXPECT_EQ(config.output, "folder");
  EXPECT_EQ(config.views, 3);
}

TEST(CommandLine, HelpShowsDefaultsRangesAndAliases) {
  CommandLine line("train", "Trains.");
  line.add(TrainConfig{}, "Training");
  const std::string help = line.help();
  EXPECT_NE(help.find("-s, --source_path"), std::string::npos);
  EXPECT_NE(help.find("optimisation steps (default 30000; at least 1; also --max_steps)"), std::string::npos);
  EXPECT_NE(help.find("default 7000 30000"), std::string::npos);
  EXPECT_NE(help.find("default auto; one of auto,"), std::string::npos);
}

class ConfigFile : public ::testing::Test {
 protected:
  std::string write(const std::string& text) {
    const std::string path = (folder_.path() / "config.json").string();
    write_file(path, text);
    return path;
  }
  std::string complaint(const std::string& text) {
    TrainConfig config;
    try {
      apply_config_file(config, write(text));
    } catch (const InputError& error) {
      return error.what();
    }
    return "accepted";
  }

  test::TempDir folder_;
};

TEST_F(ConfigFile, CountsMoreThanDefaultsAndLessThanFlags) {
  CommandLine line("train", "Trains.");
  line.add(TrainConfig{}, "Training");
  ASSERT_TRUE(line.parse({"--iterations", "100"}));
  TrainConfig config;
  apply_config_file(config, write(R"({"iterations": 50, "seed": 7, "test_iterations": [1, 2]})"));
  line.apply(config);
  EXPECT_EQ(config.iterations, 100);  // flag over file
  EXPECT_EQ(config.seed, 7);          // file over default
  EXPECT_EQ(config.test_iterations, (std::vector<int>{1, 2}));
  EXPECT_EQ(config.sh_degree, TrainConfig{}.sh_degree);  // default
}

TEST_F(ConfigFile, TheEffectiveConfigReadsBackTheSame) {
  TrainConfig before;
  before.iterations = 123;
  before.images = "images_2";
  before.position_lr_init = 0.1 + 0.2;
  TrainConfig after;
  apply_config_file(after, write(config_to_json(before).dump()));
  EXPECT_TRUE(config_differences(before, after).empty());
}

TEST_F(ConfigFile, NamesTheFileAndTheFault) {
  EXPECT_NE(complaint("{").find("config.json: no valid JSON"), std::string::npos);
  EXPECT_NE(complaint(R"({"iteratons": 5})").find("config.json: unknown option \"iteratons\""), std::string::npos);
  EXPECT_NE(complaint(R"({"iterations": "5"})").find("config.json: iterations must be a whole number, found \"5\""),
            std::string::npos);
  EXPECT_NE(complaint(R"({"iterations": 0})").find("config.json: iterations must be at least 1"), std::string::npos);
  EXPECT_NE(complaint("[]").find("expected a JSON object"), std::string::npos);
}

TEST_F(ConfigFile, NumbersAreNeitherWrappedNorRounded) {
  const auto says = [&](const std::string& text, const std::string& wanted) {
    const std::string found = complaint(text);
    EXPECT_NE(found.find(wanted), std::string::npos) << text << ": " << found;
  };
  says(R"({"iterations": 4294967297})",
       "iterations must be a whole number from -2147483648 to 2147483647, found 4294967297");
  says(R"({"iterations": 1e3})", "iterations must be a whole number, found 1000.0");
  says(R"({"iterations": true})", "iterations must be a whole number, found true");
  says(R"({"seed": 18446744073709551615})", "seed must be a whole number from -9223372036854775808");
  says(R"({"test_iterations": [1.9]})", "test_iterations must be a list, each entry a whole number, found [1.9]");
  says(R"({"test_iterations": [7, 4294967297]})",
       "each entry a whole number from -2147483648 to 2147483647, found [7,");
  says(R"({"test_iterations": 7})", "test_iterations must be a list, found 7");
  says(R"({"kernel_candidates": ["naive", 2]})", "each entry text in quotes");
  says(R"({"opacity_lr": "0.1"})", "opacity_lr must be a number, found \"0.1\"");
  says(R"({"opacity_lr": 1e999})", "no valid JSON");
  says(R"({"eval": 1})", "eval must be true or false, found 1");
  EXPECT_EQ(complaint(R"({"seed": 9223372036854775807, "opacity_lr": 1, "test_iterations": [2147483647]})"),
            "accepted");
}

TEST_F(ConfigFile, TakesTheNamesOfTheCommandLine) {
  TrainConfig config;
  apply_config_file(config, write(R"({"max_steps": 50, "test-iterations": [3], "s": "scene", "data-factor": 2})"));
  EXPECT_EQ(config.iterations, 50);
  EXPECT_EQ(config.test_iterations, std::vector<int>{3});
  EXPECT_EQ(config.source_path, "scene");
  EXPECT_EQ(config.resolution, 2);
  const std::string twice = complaint(R"({"max_steps": 50, "iterations": 60})");
  EXPECT_NE(twice.find("\"max_steps\" and \"iterations\" are the same option; give one"), std::string::npos) << twice;
}

TEST_F(ConfigFile, AMissingFileIsNamed) {
  TrainConfig config;
  EXPECT_THROW(apply_config_file(config, (folder_.path() / "none.json").string()), InputError);
}

TEST(NearestName, PrefersAbbreviationsAndRefusesFarNames) {
  const std::vector<std::string> known{"iterations", "test_iterations", "seed"};
  EXPECT_EQ(nearest_name("iter", known), "iterations");
  EXPECT_EQ(nearest_name("sed", known), "seed");
  EXPECT_EQ(nearest_name("seed_value", known), "seed") << "a word more";
  EXPECT_EQ(nearest_name("seedling_value", known), "");
  EXPECT_EQ(nearest_name("background", known), "");
  EXPECT_EQ(nearest_name("", known), "");
}

}  // namespace
}  // namespace b3dgs
