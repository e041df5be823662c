// Tests that no completed iteration is lost when a training fails.

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/files/folders.h"
#include "model/formats/splat_formats.h"
#include "support/expect_error.h"
#include "support/full_disk.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/short_memory.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density/row_edit.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::eventful_config;
using test::FileSizeLimit;
using test::read_bytes;
using test::SmallDisk;
using test::train;
using test::Trained;

class TrainerFaults : public testing::Test {
 protected:
  TrainHooks hooks() {
    TrainHooks hooks;
    hooks.on_warning = [this](const std::string& message) { warnings.push_back(message); };
    return hooks;
  }
  /// Changes the state in a checkpoint.
  template <class Change>
  fs::path spoilt(const fs::path& checkpoint, Change&& change) const {
    Checkpoint read = read_checkpoint(checkpoint, scene, torch::kCPU);
    change(read.state);
    write_checkpoint(checkpoint, read.config, read.state, scene);
    return checkpoint;
  }

  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  std::vector<std::string> warnings;
};

/// Returns hooks that let an activity of an iteration fail.
TrainHooks failing_at(int iteration, const std::string& activity, const std::function<void()>& fail) {
  TrainHooks hooks;
  hooks.on_progress = [=](const TrainProgress& progress) {
    if (progress.iteration == iteration && progress.activity == activity) fail();
  };
  return hooks;
}

TEST_F(TrainerFaults, EachLeavesACheckpointOfTheLastIteration) {
  TrainConfig config = eventful_config();
  config.test_iterations = config.save_iterations = {10};  // also an iteration of density control
  const Trained whole = train(config, scene, temp / "whole");
  struct Row {
    const char* name;
    int iteration;
    const char* activity;
    std::function<void()> fail;
    std::function<testing::AssertionResult(const std::function<void()>&)> fails;
  };
  const auto as = [](auto kind, std::initializer_list<std::string> parts) {
    return [parts = std::vector<std::string>(parts)](const std::function<void()>& call) {
      return test::fails_with<decltype(kind)>({parts[0], parts[1]}, call);
    };
  };
  const std::string at_10 = "iteration_10.b3dgs";
  const std::vector<Row> rows{
      {"memory", 10, "training", [] { throw std::bad_alloc(); },
       as(OutOfMemoryError(""), {"out of memory after iteration 10", at_10})},
      {"gpu", 10, "densifying", [] { throw OutOfMemoryError("cudaMalloc: out of memory"); },
       as(OutOfMemoryError(""), {"out of memory after iteration 10", at_10})},
      {"photograph", 10, "evaluating", [] { input_error("view4.png: cannot be opened"); },
       as(InputError(""), {"view4.png: cannot be opened; iteration 10 is saved", at_10})},
      {"numbers", 10, "saving", [] { throw NumericError("too many pairs"); },
       as(NumericError(""), {"too many pairs; iteration 10 is saved", at_10})},
      {"other", 13, "training", [] { throw std::runtime_error("device lost\nwith a stack trace"); },
       as(Error(""), {"device lost; iteration 13 is saved", "iteration_13.b3dgs"})}};
  for (const Row& row : rows) {
    SCOPED_TRACE(row.name);
    const ModelFolder folder(temp / row.name);
    EXPECT_TRUE(row.fails([&] {
      Trainer(finalize(config, scene), scene, folder, failing_at(row.iteration, row.activity, row.fail)).run();
    }));
    ASSERT_EQ(folder.checkpoint_iterations(), (std::vector<int>{row.iteration}));
    const Trained resumed = train(config, scene, folder.root(), folder.checkpoint(row.iteration));
    EXPECT_TRUE(test::same(resumed.ply, whole.ply)) << "density control was skipped, or done twice";
    EXPECT_TRUE(test::same(read_bytes(folder.ply(10)), read_bytes(ModelFolder(temp / "whole").ply(10))));
  }
}

/// Two rounds are due after one step, and memory runs out between them. The first one is not repeated.
TEST_F(TrainerFaults, ResumesBetweenTwoRoundsOfDensityControl) {
  TrainConfig config = eventful_config();
  config.batch = 4;
  config.densification_interval = 2;
  const Trained whole = train(config, scene, temp / "whole");
  int n_rounds = 0;
  const auto fail = [&] {
    if (++n_rounds == 2) throw OutOfMemoryError("cudaMalloc: out of memory");
  };
  const ModelFolder folder(temp / "model");
  EXPECT_TRUE(test::fails_with<OutOfMemoryError>({"iteration 12 is saved"}, [&] {
    Trainer(finalize(config, scene), scene, folder, failing_at(12, "densifying", fail)).run();
  }));
  const Trained resumed = train(config, scene, folder.root(), folder.checkpoint(12));
  EXPECT_TRUE(test::same(resumed.checkpoint, whole.checkpoint));
}

/// Evaluations and measurements between steps take memory, too.
TEST_F(TrainerFaults, EvaluationsThatRunOutOfMemoryAreRepeated) {
  TrainConfig config = eventful_config();
  config.iterations = 10;
  config.stats_interval = 10;
  config.test_iterations = {10};
  const auto events = [&](const std::string& name) {
    std::string lines;
    std::ifstream log(temp / name / "train.jsonl");
    for (std::string line; std::getline(log, line);) {
      const nlohmann::json json = nlohmann::json::parse(line);
      if (json.value("event", "") == "load_statistics" || json.contains("test_psnr")) {
        lines += json.value("event", "") + std::to_string(json.value("test_psnr", 0.0)) + json.value("view", "") + "\n";
      }
    }
    return lines;
  };
  train(config, scene, temp / "whole");
  ASSERT_FALSE(events("whole").empty());
  for (const char* const before : {"training", "evaluating"}) {  // load statistics follow the step
    for (std::int64_t n = 0; n < 3; ++n) {
      SCOPED_TRACE(testing::Message() << "allocation " << n << " after " << before);
      test::FailOnce failure;
      const test::FailingAllocator allocator([&](std::size_t) { return failure(); });
      train(config, scene, temp / "short", {}, failing_at(10, before, [&] { failure.n = n; }));
      EXPECT_TRUE(failure.has_failed);
      EXPECT_EQ(events("short"), events("whole"));
    }
  }
}

TEST_F(TrainerFaults, GaussiansThatCannotBeRenderedAreRemovedAndCounted) {
  TrainConfig config = eventful_config();
  config.iterations = 8;
  const fs::path first = train(config, scene, temp / "model").result.checkpoint;
  const auto make_bad = [](TrainState& state) {
    state.gaussians.means[3][1] = NAN;
    state.gaussians.log_scales[5][0] = INFINITY;
    state.adam.v.quats[7][2] = NAN;  // would make the row invalid in the next step
    state.gaussians.log_scales[9].fill_(60);
  };
  spoilt(first, make_bad);
  const std::int64_t n = read_checkpoint_header(first)["n_gaussians"];
  // The expected result is the same training without these Gaussians.
  const ModelFolder clean(temp / "clean");
  fs::create_directories(clean.root() / "checkpoints");
  fs::copy_file(first, clean.checkpoint(8));
  spoilt(clean.checkpoint(8), [&](TrainState& state) {
    torch::Tensor stays = torch::ones({n}, torch::kBool);
    for (const int row : {3, 5, 7, 9}) stays[row] = false;
    RowEdit edit;
    edit.sources = stays.nonzero().flatten();
    edit.n_kept = edit.sources.size(0);
    edit.new_means = edit.new_log_scales = torch::empty({0, 3});
    apply_row_edit(edit, state.gaussians, state.adam, state.statistics);
  });
  config.iterations = 20;
  config.checkpoint_iterations = {8, 13};
  config.keep_checkpoints = 9;
  const Trained expected = train(config, scene, clean.root(), clean.checkpoint(8));
  const Trained run = train(config, scene, temp / "model", first, hooks());
  EXPECT_TRUE(test::same(run.ply, expected.ply));
  EXPECT_EQ(run.result.n_removed, 4);
  ASSERT_FALSE(warnings.empty());
  EXPECT_NE(warnings[0].find("that cannot be rendered"), std::string::npos) << warnings[0];
  std::int64_t n_logged = 0;
  std::ifstream log(temp / "model" / "train.jsonl");
  for (std::string line; std::getline(log, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (json.value("event", "") == "gaussians_removed") n_logged += json["count"].get<std::int64_t>();
  }
  EXPECT_EQ(n_logged, 4);

  // Resuming after the removal gives the same result.
  const fs::path later = ModelFolder(temp / "model").checkpoint(13);
  EXPECT_EQ(read_checkpoint_header(later)["n_removed"], 4);
  EXPECT_TRUE(test::same(train(config, scene, temp / "model", later).ply, run.ply));
}

TEST_F(TrainerFaults, TrainingEndsIfNoGaussianIsLeft) {
  TrainConfig config = eventful_config();
  config.iterations = 4;
  const fs::path first = train(config, scene, temp / "model").result.checkpoint;
  spoilt(first, [](TrainState& state) { state.gaussians.means.fill_(NAN); });
  config.iterations = 8;
  EXPECT_TRUE(test::fails_with<NumericError>({"no Gaussian is left", "last checkpoint", first.string()},
                                             [&] { train(config, scene, temp / "model", first); }));
  EXPECT_EQ(ModelFolder(temp / "model").checkpoint_iterations(), (std::vector<int>{4})) << "no new checkpoint";
}

TEST_F(TrainerFaults, ALossThatIsNotFiniteWritesNoCheckpoint) {
  TrainConfig config = eventful_config();
  config.iterations = 4;
  const fs::path first = train(config, scene, temp / "model").result.checkpoint;
  const std::string before = read_bytes(first);
  config.iterations = 8;
  config.lambda_dssim = NAN;  // renders are always finite, so only this can make the loss NaN
  EXPECT_TRUE(test::fails_with<NumericError>({"iteration 5, view view", "the loss is", first.string()},
                                             [&] { train(config, scene, temp / "model", first); }));
  EXPECT_EQ(ModelFolder(temp / "model").checkpoint_iterations(), (std::vector<int>{4}));
  EXPECT_TRUE(test::same(read_bytes(first), before));
}

TEST(InvalidGaussians, AreTheNamedOneThoseNotFiniteAndThoseAsAbsurdlyLarge) {
  GaussianTensors gaussians = to_tensors(splats_from_points(test::make_tiny_scene().points, 1), 1, torch::kCPU);
  AdamState adam = make_adam_state(gaussians);
  DensityStatistics statistics = make_density_statistics(gaussians.size(), torch::kCPU);
  for (int i = 0; i < gaussians.size(); ++i) statistics.view_count[i] = i;
  const auto remove = [&](std::int64_t row) { return remove_invalid_gaussians(row, 1.0, gaussians, adam, statistics); };
  EXPECT_EQ(remove(4), 1) << "only the named one";
  EXPECT_EQ(statistics.view_count[4].item<int>(), 5);
  gaussians.log_scales[1][2] = 20;
  gaussians.log_scales[2][0] = 25;
  gaussians.log_scales[3][1] = 5;
  adam.m.shN[6][0][0] = INFINITY;
  EXPECT_EQ(remove(1), 3) << "1, 2 and 6";
  EXPECT_EQ(gaussians.log_scales[1][1].item<float>(), 5) << "large, but below the limit";
  EXPECT_EQ(gaussians.size(), 116);
  EXPECT_EQ(remove(0), 1);
}

TEST_F(TrainerFaults, CheckpointsWrittenByTimeDoNotChangeTheTraining) {
  TrainConfig config = eventful_config();
  const Trained whole = train(config, scene, temp / "whole");
  const auto count = [&](double minutes, const std::string& name) {
    config.checkpoint_minutes = minutes;
    TrainHooks hooks;
    hooks.clock_s = [now_s = 0.0]() mutable { return now_s += 20; };
    hooks.wait_for_files = true;  // because no checkpoint is due while one is being written, which depends on the disk
    std::vector<int> iterations;
    hooks.on_progress = [&](const TrainProgress& progress) {
      if (progress.activity == "checkpoint") iterations.push_back(progress.iteration);
    };
    EXPECT_TRUE(test::same(train(config, scene, temp / name, {}, hooks).ply, whole.ply)) << minutes;
    return iterations;
  };
  EXPECT_EQ(count(0, "never"), (std::vector<int>{20})) << "only the last one";
  const std::vector<int> often = count(1, "often"), seldom = count(5, "seldom");
  EXPECT_GE(often.size(), 3u);
  EXPECT_LT(seldom.size(), often.size());
  EXPECT_GE(seldom.size(), 2u);
  EXPECT_EQ(ModelFolder(temp / "often").checkpoint_iterations().size(), 2u) << "two are kept";
}

TEST_F(TrainerFaults, FilesThatCannotBeWrittenBeforeTheEndDoNotEndTheTraining) {
  TrainConfig config = eventful_config();
  config.checkpoint_iterations = {5, 15};
  config.save_iterations = {5};
  const Trained whole = train(config, scene, temp / "whole");
  TrainHooks own = hooks();
  std::unique_ptr<FileSizeLimit> limit;
  own.on_progress = [&](const TrainProgress& progress) {
    if (progress.iteration == 4) limit = std::make_unique<FileSizeLimit>(5000);
    if (progress.iteration == 12) limit.reset();
  };
  const Trained run = train(config, scene, temp / "model", {}, own);
  EXPECT_TRUE(test::same(run.ply, whole.ply));
  const ModelFolder folder(temp / "model");
  EXPECT_EQ(folder.checkpoint_iterations(), (std::vector<int>{15, 20}));
  EXPECT_EQ(folder.ply_iterations(), (std::vector<int>{20}));
  EXPECT_EQ(run.result.not_written, (std::vector<fs::path>{folder.ply(5), folder.checkpoint(5)}));
  ASSERT_EQ(warnings.size(), 2u);
  for (const std::string& warning : warnings) {
    EXPECT_NE(warning.find("File too large"), std::string::npos) << warning;
    EXPECT_NE(warning.find("training continues"), std::string::npos) << warning;
  }
}

TEST_F(TrainerFaults, ALastPlyThatCannotBeWrittenFailsAndIsWrittenOnResume) {
  TrainConfig config = eventful_config();
  const Trained whole = train(config, scene, temp / "whole");
  config.checkpoint_iterations = {16};
  config.densification_interval = 10;  // the last iteration has density control, and the PLY shows the model before it
  const Trained dense = train(config, scene, temp / "dense");
  const ModelFolder folder(temp / "model");
  TrainHooks own = hooks();
  std::unique_ptr<FileSizeLimit> limit;
  own.on_progress = [&](const TrainProgress& progress) {
    if (progress.activity == "saving") limit = std::make_unique<FileSizeLimit>(5000);
    if (progress.activity == "checkpoint") limit.reset();
  };
  EXPECT_TRUE(test::fails_with<IoError>(
      {folder.ply(20).string(), "File too large", "--resume auto", folder.checkpoint(20).string()},
      [&] { train(config, scene, folder.root(), {}, own); }));
  EXPECT_TRUE(folder.ply_iterations().empty());
  const Trained resumed = train(config, scene, folder.root(), folder.checkpoint(20));
  EXPECT_TRUE(test::same(resumed.ply, dense.ply));
  EXPECT_TRUE(test::same(resumed.checkpoint, dense.checkpoint));
}

TEST_F(TrainerFaults, AFullDiskNamesTheLastGoodCheckpoint) {
  const fs::path disk = temp / "disk";
  const SmallDisk mounted(disk, "size=1500k");
  if (!mounted.fault().empty()) GTEST_SKIP() << "no file system can be mounted here: " << mounted.fault();
  TrainConfig config = eventful_config();
  config.checkpoint_interval = 2;
  config.stats_interval = 0;
  const ModelFolder folder(disk / "model");
  TrainHooks own = hooks();
  own.on_progress = [&](const TrainProgress& progress) {
    if (progress.iteration == 7) std::ofstream(disk / "other") << std::string(2 << 20, 'x');
  };
  EXPECT_TRUE(test::fails_with<IoError>({"No space left on device", "last checkpoint: " + folder.root().string()},
                                        [&] { Trainer(finalize(config, scene), scene, folder, own).run(); }));
  EXPECT_GE(warnings.size(), 2u);
  ASSERT_FALSE(folder.checkpoint_iterations().empty());
  for (const int iteration : folder.checkpoint_iterations()) {
    EXPECT_LE(iteration, 8);
    verify_checkpoint_file(folder.checkpoint(iteration));
  }
  fs::remove(disk / "other");
  const fs::path last = newest_valid_checkpoint(folder, {});
  const TrainResult resumed = [&] {
    Trainer trainer(finalize(config, scene), scene, folder, {});
    trainer.resume(last);
    return trainer.run();
  }();
  config.checkpoint_interval = 0;
  EXPECT_TRUE(test::same(read_bytes(resumed.ply), train(config, scene, temp / "whole").ply));
}

TEST_F(TrainerFaults, AReadOnlyFolderIsReportedBeforeTheFirstStep) {
  const SmallDisk mounted(temp / "disk", "size=100k", MS_RDONLY);
  if (!mounted.fault().empty()) GTEST_SKIP() << "no file system can be mounted here: " << mounted.fault();
  const fs::path folder = temp / "disk" / "model";
  EXPECT_TRUE(test::fails_with<IoError>({folder.string(), "Read-only file system"}, [&] { FolderLock lock(folder); }));
  EXPECT_TRUE(test::fails_with<IoError>({folder.string(), "Read-only file system"},
                                        [&] { train(eventful_config(), scene, folder); }));
}

TEST_F(TrainerFaults, ChangedPhotographsAreNoticed) {
  Scene with_files = scene;
  for (std::size_t i = 0; i < with_files.train.size(); ++i) {
    with_files.train[i].file = (temp / ("photo" + std::to_string(i))).string();
    test::write_bytes(with_files.train[i].file, "photograph");
  }
  TrainConfig config = eventful_config();
  config.iterations = 3;
  const fs::path checkpoint = train(config, with_files, temp / "model").result.checkpoint;
  Trainer(finalize(config, with_files), with_files, ModelFolder(temp / "model"), hooks()).resume(checkpoint);
  EXPECT_TRUE(warnings.empty());
  test::write_bytes(with_files.train[1].file, "photogrbph");
  Trainer(finalize(config, with_files), with_files, ModelFolder(temp / "model"), hooks()).resume(checkpoint);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("1 of 6 photographs"), std::string::npos) << warnings[0];
  EXPECT_NE(warnings[0].find(with_files.train[1].name), std::string::npos) << warnings[0];
}

TEST_F(TrainerFaults, ChangedMasksAreNoticed) {
  Scene with_masks = scene;
  for (const std::size_t i : {0u, 1u}) {
    with_masks.train[i].mask_file = (temp / ("mask" + std::to_string(i))).string();
    test::write_bytes(with_masks.train[i].mask_file, "mask");
  }
  TrainConfig config = eventful_config();
  config.iterations = 3;
  const fs::path checkpoint = train(config, with_masks, temp / "model").result.checkpoint;
  const auto resume = [&] {
    Trainer(finalize(config, with_masks), with_masks, ModelFolder(temp / "model"), hooks()).resume(checkpoint);
  };
  resume();
  EXPECT_TRUE(warnings.empty());
  test::write_bytes(with_masks.train[1].mask_file, "musk");
  resume();
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("masks of 1 of 6 photographs have changed"), std::string::npos) << warnings[0];
  EXPECT_NE(warnings[0].find(with_masks.train[1].name), std::string::npos) << warnings[0];
  with_masks.train[0].mask_file.clear();
  with_masks.train[2].mask_file = with_masks.train[1].mask_file;
  resume();
  ASSERT_EQ(warnings.size(), 2u);
  EXPECT_NE(warnings[1].find("masks of 3 of 6 photographs"), std::string::npos) << warnings[1];
}

}  // namespace
}  // namespace b3dgs
