// Tests training from photographs that do not all fit in memory.
#include <gtest/gtest.h>

#include <functional>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/same.h"
#include "support/train/disk_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::DiskScene;

TrainConfig config_of_some_steps() {
  TrainConfig config = test::eventful_config();
  config.iterations = 18;
  config.test_iterations = {9, 18};
  return config;
}

TEST(ReadAheadTraining, GivesTheSameBytesWhateverTheMemory) {
  for (const bool distorted : {false, true}) {
    SCOPED_TRACE(distorted ? "distorted" : "pinhole");
    const DiskScene disk(distorted);
    const test::TempDir temp;
    const TrainConfig config = config_of_some_steps();
    const Scene whole = disk.load();
    const test::Trained expected = test::train(config, whole, temp / "whole");
    for (const View& view : whole.train) EXPECT_NE(view.image->held(), nullptr);
    for (const double photographs : {0.0, 1.0, 4.0, 7.0}) {
      SCOPED_TRACE(std::to_string(photographs) + " photographs");
      const Scene scene = disk.load(photographs);
      const test::Trained trained = test::train(config, scene, temp / std::to_string(photographs));
      EXPECT_TRUE(test::same(trained.ply, expected.ply));
      EXPECT_TRUE(test::same(trained.checkpoint, expected.checkpoint));
      ASSERT_EQ(trained.result.evaluations.size(), 2u);
      for (std::size_t i = 0; i < 2; ++i) {
        EXPECT_EQ(trained.result.evaluations[i].second.mean.psnr, expected.result.evaluations[i].second.mean.psnr);
      }
      // The minimum is one buffer for training and one for evaluation.
      const ImageMemory& memory = *scene.train.front().image->memory();
      EXPECT_LE(memory.peak(), std::max(memory.limit(), memory.fixed() + 2 * disk.image_bytes()));
      std::int64_t held = memory.fixed();
      for (const auto* views : {&scene.train, &scene.test}) {
        for (const View& view : *views) held += view.image->held() ? view.image->n_bytes() : 0;
      }
      EXPECT_EQ(memory.used(), held) << "counted and actual use differ";
      EXPECT_EQ(photographs >= 4, held > memory.fixed());
    }
  }
}

TEST(ReadAheadTraining, ResumesWithAnotherMemoryLimit) {
  const DiskScene disk;
  const test::TempDir temp;
  TrainConfig config = config_of_some_steps();
  config.test_iterations = {};
  const std::string whole = test::train(config, disk.load(), temp / "whole").ply;
  config.iterations = 11;
  const fs::path checkpoint = test::train(config, disk.load(1), temp / "part").result.checkpoint;
  config.iterations = 18;
  config.host_memory_gb = 1;
  EXPECT_TRUE(test::same(test::train(config, disk.load(5), temp / "part", checkpoint).ply, whole));
}

/// Trains with one photograph in memory. `spoil` is called after step 5. Every photograph is used again by step 14.
void spoil_in_mid_training(const std::function<void(const fs::path&)>& spoil, const std::string& reason) {
  const DiskScene disk;
  const test::TempDir temp;
  TrainConfig config = config_of_some_steps();
  config.test_iterations = {};
  const Scene scene = disk.load(1);
  const fs::path file = disk.image_file(scene.train[2]);
  TrainHooks hooks;
  bool is_spoilt = false;
  hooks.on_progress = [&](const TrainProgress& progress) {
    if (progress.iteration == 5 && !std::exchange(is_spoilt, true)) spoil(file);
  };
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), hooks);
  EXPECT_TRUE(test::fails_with<InputError>({file.string(), reason}, [&] { trainer.run(); }));

  // The state is that after the last complete step, so a checkpoint can be written and resumed.
  const int last = trainer.iteration();
  EXPECT_GE(last, 5);
  EXPECT_LT(last, 14);
  const fs::path checkpoint = trainer.write_checkpoint();
  const DiskScene sound_disk;
  const Scene sound = sound_disk.load();
  const test::Trained whole = test::train(config, sound, temp / "whole");
  const test::Trained resumed = test::train(config, sound, temp / "resumed", checkpoint);
  EXPECT_TRUE(test::same(resumed.ply, whole.ply));
}

TEST(ReadAheadTraining, NamesAPhotographThatIsRemovedAndKeepsTheLastGoodStep) {
  spoil_in_mid_training([](const fs::path& file) { fs::remove(file); }, "cannot be read");
}

TEST(ReadAheadTraining, NamesAPhotographThatIsTruncatedAndKeepsTheLastGoodStep) {
  spoil_in_mid_training([](const fs::path& file) { fs::resize_file(file, fs::file_size(file) / 2); },
                        "ends before its last chunk");
}

TEST(ReadAheadTraining, NamesAPhotographThatIsReplacedByOneOfAnotherSize) {
  spoil_in_mid_training([](const fs::path& file) { write_image(file, Image8(30, 20, 3)); },
                        "expected 60 x 44 px (its size when the scene was loaded), found 30 x 20");
}

TEST(ReadAheadTraining, NamesATestPhotographThatIsMissingInAnEvaluation) {
  const DiskScene disk;
  const test::TempDir temp;
  const Scene scene = disk.load(1);
  ASSERT_EQ(scene.test.front().image->held(), nullptr);
  fs::remove(disk.image_file(scene.test.front()));
  TrainConfig config = config_of_some_steps();
  EXPECT_TRUE(test::fails_with<InputError>({disk.image_file(scene.test.front()).string(), "cannot be read"},
                                           [&] { test::train(config, scene, temp / "model"); }));
}

}  // namespace
}  // namespace b3dgs
