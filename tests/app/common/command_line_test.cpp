// Option names, conversions, precedence and help texts, mostly with the training options.
#include "core/options/command_line.h"

#include <gtest/gtest.h>

#include "config/train_options.h"
#include "core/files/atomic_file.h"
#include "data_synth/synth_config.h"
#include "support/temp_dir.h"

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

void apply_config_file(TrainConfig& config, const std::string& path) {
  config_from_json(config, read_json_file(path), path);
}

std::string complaint(const Words& words) {
  try {
    parse(words);
  } catch (const InputError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(CommandLine, KeepsDefaultsOfOptionsThatAreNotGiven) {
  EXPECT_TRUE(config_differences(TrainConfig{}, parse({})).empty());
}

TEST(CommandLine, AcceptsUnderscoresAndHyphensInNames) {
  EXPECT_EQ(parse({"--densify_grad_threshold", "0.001"}).densify_grad_threshold, 0.001);
  EXPECT_EQ(parse({"--densify-grad-threshold", "0.001"}).densify_grad_threshold, 0.001);
  EXPECT_EQ(parse({"--densify-grad_threshold=0.001"}).densify_grad_threshold, 0.001);
}

TEST(CommandLine, KeepsHyphensInValues) {
  EXPECT_EQ(parse({"--kernel", "gaussian-wise"}).kernel, "gaussian-wise");
  EXPECT_EQ(parse({"--model-path=out-of-band"}).model_path, "out-of-band");
}

TEST(CommandLine, AcceptsTheLettersOfTheOriginal3dgs) {
  const TrainConfig config = parse({"-s", "scene", "-m", "model", "-i", "images_4", "-r", "4", "-w"});
  EXPECT_EQ(config.source_path, "scene");
  EXPECT_EQ(config.model_path, "model");
  EXPECT_EQ(config.images, "images_4");
  EXPECT_EQ(config.resolution, 4);
  EXPECT_TRUE(config.white_background);
}

TEST(CommandLine, AcceptsANegativeNumberAfterALetter) {
  EXPECT_EQ(parse({"-r", "-1"}).resolution, -1);
}

TEST(CommandLine, AcceptsTheNamesOfOtherTrainers) {
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
    names.insert(names.end(), option.aliases.begin(), option.aliases.end());
    for (const std::string& name : names) {
      Words words{"--" + name};
      if constexpr (!std::is_same_v<std::decay_t<decltype(value)>, bool>) {
        const nlohmann::ordered_json json = detail::option_to_json(value);
        words.push_back(json.is_string() ? json.get<std::string>() : json.is_array() ? "5" : json.dump());
        if (words.back().empty()) words.back() = "x";
      }
      EXPECT_EQ(complaint(words), "accepted") << name;
    }
  });
}

TEST(CommandLine, AcceptsSeveralValuesForAList) {
  const TrainConfig config = parse({"--test_iterations", "10", "20", "30", "--seed", "5"});
  EXPECT_EQ(config.test_iterations, (std::vector<int>{10, 20, 30}));
  EXPECT_EQ(config.seed, 5);
}

TEST(CommandLine, SeparatesListsByCommasOrSpaces) {
  const std::vector<int> wanted{10, 20, 30};
  for (const Words& list : std::vector<Words>{
           {"10,20,30"}, {"10", "20", "30"}, {"10,", "20,", "30"}, {"10 20 30"}, {"10, 20, 30"}, {"10,20,", "30"}}) {
    Words words{"--test_iterations"};
    words.insert(words.end(), list.begin(), list.end());
    EXPECT_EQ(parse(words).test_iterations, wanted);
  }
  EXPECT_EQ(parse({"--test_iterations=10,20,30", "--seed", "5"}).test_iterations, wanted);
  EXPECT_EQ(complaint({"--test_iterations", "10,,20"}),
            "invalid value for --test_iterations (expected a whole number, found \"\")");
}

TEST(CommandLine, AListWithCommasLeavesTheNextWordToThePositionalArgument) {
  for (const Words& words : std::vector<Words>{{"--test_iterations", "1,2", "scene", "-m", "a,b"},
                                               {"--test_iterations=1,2", "scene", "-m", "a,b"},
                                               {"scene", "--test_iterations", "1", "2", "-m", "a,b"},
                                               {"-m", "a,b", "scene", "--test_iterations", "1,2"}}) {
    CommandLine line("train", "Trains.");
    line.add(TrainConfig{}, "Training", {"source_path"});
    ASSERT_TRUE(line.parse(words));
    TrainConfig config;
    line.apply(config);
    EXPECT_EQ(config.test_iterations, (std::vector<int>{1, 2}));
    EXPECT_EQ(config.source_path, "scene");
    EXPECT_EQ(config.model_path, "a,b");
  }
}

TEST(CommandLine, AListWithoutValuesIsEmpty) {
  EXPECT_TRUE(parse({"--test_iterations", "--seed", "5"}).test_iterations.empty());
  EXPECT_TRUE(parse({"--save_iterations"}).save_iterations.empty());
}

TEST(CommandLine, RejectsValuesOutOfRange) {
  EXPECT_NE(complaint({"--lenses", "none"}).find("one of undistort, native, auto"), std::string::npos);
  EXPECT_NE(complaint({"--kernel_check_interval", "0"}).find("at least 1"), std::string::npos);
  EXPECT_NE(complaint({"--densification_interval", "0"}).find("at least 1"), std::string::npos);
  EXPECT_NE(complaint({"--kernel", "fastest"}).find("segmented, published, adaptive"), std::string::npos);
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
  EXPECT_EQ(parse({"--test_iterations", "1", "2", "--seed", "3", "--test_iterations=4,5"}).test_iterations,
            (std::vector<int>{4, 5}));
}

TEST(CommandLine, AnUnknownOptionIsAnErrorThatSuggestsTheNearest) {
  EXPECT_EQ(complaint({"--iteratons", "5"}), "unknown option --iteratons; did you mean --iterations?");
  EXPECT_EQ(complaint({"--iter=5"}), "unknown option --iter; did you mean --iterations?");
  EXPECT_EQ(complaint({"--densify-untill-iter", "5"}),
            "unknown option --densify_untill_iter; did you mean --densify_until_iter?");
  EXPECT_EQ(complaint({"--qqqqq"}), "unknown option --qqqqq; see b3dgs train --help-all");
  EXPECT_EQ(complaint({"-x"}), "unknown option -x; see b3dgs train --help-all");
}

TEST(CommandLine, AnOptionIsNotTakenAsTheValueOfAnother) {
  EXPECT_EQ(complaint({"-m", "--eval"}),
            "missing value: --model_path is followed by --eval (a shell variable that is not set?); for a name that "
            "begins with \"-\", write --model_path=--eval or ./--eval");
  EXPECT_EQ(complaint({"scene", "-m", "--iterations", "20"}).rfind("missing value: --model_path", 0), 0u);
  EXPECT_EQ(complaint({"--model-path", "-r", "8"}).rfind("missing value: --model_path is followed by -r", 0), 0u);
  EXPECT_EQ(complaint({"--data_dir", "--unknown"}).rfind("missing value: --source_path", 0), 0u) << "also by an alias";
  EXPECT_EQ(complaint({"--iterations", "--eval"}),
            "missing value: --iterations is followed by --eval (expected a number)");
  EXPECT_EQ(complaint({"-r", "-m", "model"}).rfind("missing value: --resolution", 0), 0u);
  EXPECT_EQ(parse({"--model_path=--eval"}).model_path, "--eval");
  EXPECT_FALSE(parse({"--model_path=--eval"}).eval);
  EXPECT_EQ(parse({"-m", "./--eval"}).model_path, "./--eval");
  EXPECT_EQ(parse({"-m", "-1"}).model_path, "-1");
  EXPECT_EQ(parse({"--resolution", "-1"}).resolution, -1);
  EXPECT_EQ(parse({"--eval", "-m", "model"}).model_path, "model") << "a flag has no value";
}

TEST(CommandLine, NamesOfOtherTrainersGetTheRightHint) {
  for (const auto& [other, own] : {std::pair<std::string, std::string>{"--max-num-iterations", "--iterations"},
                                   {"--total-steps", "--iterations"},
                                   {"--output", "--model_path"},
                                   {"--output_dir", "--model_path"},
                                   {"-o", "--model_path"}}) {
    EXPECT_NE(complaint({other, "x"}).find("; did you mean " + own + "?"), std::string::npos)
        << complaint({other, "x"});
  }
}

TEST(CommandLine, AnUnexpectedArgumentIsAnError) {
  EXPECT_EQ(complaint({"scene"}),
            "unexpected argument \"scene\"; usage: b3dgs train [OPTIONS]; see b3dgs train --help");
  CommandLine line("train", "Trains.");
  line.add(TrainConfig{}, "Training", {"source_path"});
  try {
    line.parse({"scene", "model"});
    ADD_FAILURE() << "accepted";
  } catch (const InputError& error) {
    EXPECT_EQ(error.what(), std::string("unexpected argument \"model\"; usage: b3dgs train [SOURCE_PATH] [OPTIONS]; "
                                        "for several, run it once for each; see b3dgs train --help"));
  }
}

TEST(CommandLine, MalformedValuesAreNamed) {
  EXPECT_EQ(complaint({"--iterations"}), "missing value: --iterations");
  EXPECT_EQ(complaint({"--iterations", "abc"}),
            "invalid value for --iterations (expected a whole number, found \"abc\")");
  EXPECT_EQ(complaint({"--iterations", "3e4"}),
            "invalid value for --iterations (expected a whole number, found \"3e4\")");
  EXPECT_EQ(
      complaint({"--iterations", "99999999999"}),
      "invalid value for --iterations (expected a whole number from -2147483648 to 2147483647, found \"99999999999\")");
  EXPECT_EQ(complaint({"--iterations", "1.5"}),
            "invalid value for --iterations (expected a whole number, found \"1.5\")");
  EXPECT_EQ(complaint({"--seed", "9223372036854775808"}),
            "invalid value for --seed (expected a whole number from -9223372036854775808 to 9223372036854775807, found "
            "\"9223372036854775808\")");
  EXPECT_EQ(complaint({"--test_iterations", "5", "1.9"}),
            "invalid value for --test_iterations (expected a whole number, found \"1.9\")");
  EXPECT_EQ(complaint({"--opacity_lr", "0.1x"}), "invalid value for --opacity_lr (expected a number, found \"0.1x\")");
  EXPECT_EQ(complaint({"--opacity_lr", "nan"}), "invalid value for --opacity_lr (expected a number, found \"nan\")");
  EXPECT_EQ(complaint({"--eval=maybe"}), "invalid value for --eval (expected true or false, found \"maybe\")");
  EXPECT_NE(complaint({"--iterations"}).find("--iterations"), std::string::npos);
}

TEST(CommandLine, AnEmptyWordIsNoTextExceptForDepths) {
  for (const Words& words : {Words{"-s", ""}, Words{"--model_path", ""}, Words{"--init_ply=", "-s", "scene"}}) {
    EXPECT_NE(complaint(words).find("expected a text that is not empty"), std::string::npos) << words[0];
  }
  EXPECT_EQ(complaint({"--init_ply", "", "-s", "scene"}),
            "invalid value for --init_ply (expected a text that is not empty, found \"\"); leave the option out to "
            "have none");
  EXPECT_NE(complaint({"--strategy", ""}).find("mcmc"), std::string::npos) << "lists the choices instead";
  EXPECT_EQ(parse({"--depths", "maps", "-d", ""}).depths, "") << "the default of the original 3DGS";
  EXPECT_EQ(parse({"--depths=", "-s", "scene"}).source_path, "scene");
}

TEST(CommandLine, AFlagWithAnEmptyValueIsAnError) {
  EXPECT_EQ(complaint({"--eval=", "-s", "scene"}), "invalid value for --eval (expected true or false, found \"\")");
  EXPECT_EQ(complaint({"--iterations="}), "invalid value for --iterations (expected a whole number, found \"\")");
}

TEST(CommandLine, ValuesOutOfRangeAreNamedWithTheRange) {
  EXPECT_EQ(complaint({"--iterations", "0"}), "invalid value for --iterations (expected at least 1, found 0)");
  EXPECT_EQ(complaint({"--lambda_dssim", "1.5"}), "invalid value for --lambda_dssim (expected from 0 to 1, found 1.5)");
  EXPECT_EQ(complaint({"--device", "tpu"}),
            "invalid value for --device (expected one of auto, cpu, cuda, found \"tpu\")");
  EXPECT_EQ(complaint({"--test_iterations", "5", "-2"}),
            "invalid value for --test_iterations (expected at least -1, found [5,-2])");
}

TEST(CommandLine, PositionalArgumentsSetTheirFields) {
  CommandLine line("synth", "Writes.");
  line.add(SynthConfig{}, "Scene", {"scene", "output"});
  ASSERT_TRUE(line.parse({"street", "folder", "--views", "3"}));
  SynthConfig config;
  line.apply(config);
  EXPECT_EQ(config.scene, "street");
  EXPECT_EQ(config.output, "folder");
  EXPECT_EQ(config.views, 3);
}

TEST(CommandLine, HelpListsTheCommonOptionsOfALongList) {
  CommandLine line("train", "Trains.", "b3dgs train scene");
  line.add(TrainConfig{}, "Training", {"source_path"});
  const std::string help = line.help();
  EXPECT_EQ(help.find("Trains.\n\nUsage: b3dgs train [SOURCE_PATH] [OPTIONS]\nExample: b3dgs train scene\n\n"), 0u)
      << help;
  EXPECT_NE(help.find("\nScene and output:\n  -s, --source_path TEXT"), std::string::npos) << help;
  EXPECT_NE(help.find("training iterations (default 30000)\n"), std::string::npos) << help;
  EXPECT_NE(help.find("(default auto; one of auto, cpu, cuda)"), std::string::npos) << "choices are shown; " << help;
  EXPECT_EQ(help.find("--rotation_lr"), std::string::npos) << "is not common";
  int n_options = 0;
  const TrainConfig config;
  visit_fields(config, [&](const auto&...) { ++n_options; });
  const std::string last = "\nb3dgs train --help-all lists all " + std::to_string(n_options) + " options.\n";
  ASSERT_GT(help.size(), last.size());
  EXPECT_EQ(help.substr(help.size() - last.size()), last);
}

TEST(CommandLine, HelpListsAllOptionsOfAShortList) {
  CommandLine line("synth", "Writes.");
  line.add(SynthConfig{}, "Scene", {"scene", "output"});
  const SynthConfig defaults;
  visit_fields(defaults, [&](const Option& option, const auto&, const auto&, const char*) {
    EXPECT_NE(line.help().find("--" + std::string(option.name) + " "), std::string::npos) << option.name;
  });
  EXPECT_NE(line.help().find("\nb3dgs synth --help-all adds ranges and aliases.\n"), std::string::npos);
}

TEST(CommandLine, HelpAllListsEveryOptionInGroupsWithKernelsLast) {
  CommandLine line("train", "Trains.");
  line.add(TrainConfig{}, "Training");
  const std::string help = line.help_all();
  const TrainConfig defaults;
  visit_fields(defaults, [&](const Option& option, const auto&, const auto&, const char* text) {
    EXPECT_NE(help.find("--" + std::string(option.name)), std::string::npos) << option.name;
    EXPECT_LE(std::string(text).size(), 84u) << option.name << ": fits into one line of the help text";
  });
  EXPECT_NE(help.find("training iterations (default 30000; at least 1; also --max_steps)"), std::string::npos) << help;
  EXPECT_NE(help.find("default 7000 30000"), std::string::npos);
  EXPECT_NE(help.find("(0 = never; default 10; at least 0)"), std::string::npos) << "one pair of parentheses";
  const std::size_t kernels = help.find("\nKernels:\n");
  ASSERT_NE(kernels, std::string::npos);
  EXPECT_EQ(help.find(":\n", kernels + 10), std::string::npos) << "the last group";
  EXPECT_GT(help.find("--culling"), kernels);
  EXPECT_LT(help.find("--threads"), kernels) << "a later row that names an earlier group";
}

TEST(CommandLine, HelpTellsHowToTurnOffAFlagThatIsOn) {
  CommandLine line("compare", "Compares.");
  TrainConfig defaults;
  defaults.eval = true;
  line.add(defaults, "Training");
  EXPECT_NE(line.help().find("(default on; --no_eval turns"), std::string::npos) << line.help();
  EXPECT_EQ(line.help().find("--no_white_background"), std::string::npos) << "is off anyway";
}

TEST(CommandLine, ACommandCanReplaceTheHelpOfAnOption) {
  CommandLine line("compare", "Compares.");
  line.add(TrainConfig{}, "Training");
  line.set_help("model_path", "another folder");
  EXPECT_NE(line.help().find("-m, --model_path TEXT             another folder\n"), std::string::npos) << line.help();
  EXPECT_NE(line.help_markdown().find("| another folder |"), std::string::npos);
  EXPECT_THROW(line.set_help("model_pth", "none"), LogicError);
}

TEST(CommandLine, IgnoredOptionsAreAcceptedAndNotListed) {
  CommandLine line("bench step", "Times.");
  line.add(TrainConfig{}, "Training", {}, {"model_path"});
  EXPECT_TRUE(line.parse({"--model_path", "x"}));
  EXPECT_EQ(line.help_all().find("--model_path"), std::string::npos);
  EXPECT_EQ(line.help_markdown().find("--model_path"), std::string::npos);
}

TEST(CommandLine, MarkdownHasARowForEachOption) {
  CommandLine line("synth", "Writes.", "b3dgs synth orbit out");
  line.add(SynthConfig{}, "Scene");
  const std::string page = line.help_markdown();
  EXPECT_EQ(page.find("## b3dgs synth\n\nWrites.\n\n    b3dgs synth orbit out\n\n### Scene\n\n| Option |"), 0u) << page;
  EXPECT_NE(page.find("\n| `--format` |  | binary | one of binary, text | format of the COLMAP model |\n"),
            std::string::npos)
      << page;
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

TEST_F(ConfigFile, OverridesDefaultsAndIsOverriddenByTheCommandLine) {
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

TEST_F(ConfigFile, ErrorsNameTheFileAndTheReason) {
  EXPECT_NE(complaint("{").find("not valid JSON: "), std::string::npos);
  EXPECT_NE(complaint("hello").find("(expected a JSON file with option names as keys; parse error at line 1, column 1"),
            std::string::npos);
  EXPECT_NE(complaint(R"({"iteratons": 5})").find("unknown option \"iteratons\": "), std::string::npos);
  EXPECT_NE(complaint(R"({"iterations": "5"})").find("config.json (expected a whole number, found \"5\")"),
            std::string::npos);
  EXPECT_NE(complaint(R"({"iterations": 0})").find("config.json (expected at least 1, found 0)"), std::string::npos);
  EXPECT_NE(complaint("[]").find("not a JSON object: "), std::string::npos);
}

TEST_F(ConfigFile, NumbersAreNeitherWrappedNorRounded) {
  const auto expect_error = [&](const std::string& text, const std::string& wanted) {
    const std::string found = complaint(text);
    EXPECT_NE(found.find(wanted), std::string::npos) << text << ": " << found;
  };
  expect_error(R"({"iterations": 4294967297})",
               "(expected a whole number from -2147483648 to 2147483647, found 4294967297)");
  expect_error(R"({"iterations": 1e3})", "(expected a whole number, found 1000.0)");
  expect_error(R"({"iterations": true})", "(expected a whole number, found true)");
  expect_error(R"({"seed": 18446744073709551615})", "(expected a whole number from -9223372036854775808");
  expect_error(R"({"test_iterations": [1.9]})", "(expected a list, each entry a whole number, found [1.9])");
  expect_error(R"({"test_iterations": [7, 4294967297]})",
               "each entry a whole number from -2147483648 to 2147483647, found [7,");
  expect_error(R"({"test_iterations": 7})", "invalid value for test_iterations: ");
  expect_error(R"({"test_iterations": 7})", "(expected a list, found 7)");
  expect_error(R"({"opacity_lr": "0.1"})", "(expected a number, found \"0.1\")");
  expect_error(R"({"opacity_lr": 1e999})", "not valid JSON");
  expect_error(R"({"eval": 1})", "(expected true or false, found 1)");
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
  EXPECT_NE(twice.find("\"max_steps\" and \"iterations\" are the same); remove one"), std::string::npos) << twice;
}

TEST_F(ConfigFile, AMissingFileIsNamed) {
  TrainConfig config;
  EXPECT_THROW(apply_config_file(config, (folder_.path() / "none.json").string()), InputError);
}

TEST(NearestName, PrefersAbbreviationsAndIgnoresDifferentNames) {
  const std::vector<std::string> known{"iterations", "test_iterations", "seed"};
  EXPECT_EQ(nearest_name("iter", known), "iterations");
  EXPECT_EQ(nearest_name("sed", known), "seed");
  EXPECT_EQ(nearest_name("seed_value", known), "seed") << "one more word";
  EXPECT_EQ(nearest_name("seedling_value", known), "");
  EXPECT_EQ(nearest_name("background", known), "");
  EXPECT_EQ(nearest_name("", known), "");
}

}  // namespace
}  // namespace b3dgs
