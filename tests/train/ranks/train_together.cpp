// A program for train_ranks_tests that runs on several ranks: train_together RANKS SCENARIO. A training on several
// ranks must write the same bytes as one process alone with the same options.
#include <torch/types.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/check.h"
#include "core/config.h"
#include "dist/communicator.h"
#include "multi/rank_team.h"
#include "multi/rows.h"
#include "multi/splats/splat_words.h"
#include "support/files.h"
#include "support/rank_program.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/every_feature.h"
#include "support/train/lens_scene.h"
#include "support/train/short_memory.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"
#include "train/step.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::expect;

/// Files of a training. With several ranks, rank 0 has them.
struct Files {
  TrainResult result;
  std::string ply, checkpoint;
};

/// Returns whether the ranks share a GPU, which is the device that run_rank_program() chooses.
bool runs_on_gpu() {
  const char* const device = std::getenv("TEST_DEVICE");
  return device != nullptr && std::string(device) == "cuda";
}

constexpr std::int64_t kSplatsAtATime = 2000000;  // the default

/// Trains with `ranks`, or alone if it is null.
Files train(const TrainConfig& config, const Scene& scene, const fs::path& folder, Communicator* ranks,
            const fs::path& resume = {}, TrainHooks hooks = {}, std::int64_t splats_at_a_time = kSplatsAtATime) {
  if (ranks != nullptr) use_rank_team(*ranks, config, hooks, splats_at_a_time);
  Trainer trainer(finalize(config, scene), scene, ModelFolder(folder), hooks);
  if (!resume.empty()) trainer.resume(resume);
  Files files;
  files.result = trainer.run();
  if (ranks != nullptr && !ranks->is_first()) return files;
  if (!files.result.ply.empty()) files.ply = test::read_bytes(files.result.ply);
  // On a GPU memory is limited, so that a process alone also saves the largest ratios of its views.
  files.checkpoint = test::timeless_bytes(files.result.checkpoint, runs_on_gpu() ? "view_ratios" : "");
  return files;
}

/// A folder that all ranks use, removed at the end.
class SharedFolder {
 public:
  explicit SharedFolder(Communicator& ranks) {
    if (ranks.is_first()) own_.emplace();
    path_ = ranks.exchange("folder", ranks.is_first() ? own_->path().string() : "").front();
  }
  fs::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::optional<test::TempDir> own_;
  fs::path path_;
};

/// Returns the files of a training alone on rank 0, while the other ranks wait.
Files train_alone(const TrainConfig& config, const Scene& scene, const fs::path& folder, Communicator& ranks,
                  const fs::path& resume = {}) {
  Files files;
  if (ranks.is_first()) files = train(config, scene, folder, nullptr, resume);
  ranks.barrier("trained alone");
  return files;
}

void expect_same_bytes(const std::string& found, const std::string& expected, const std::string& what) {
  const testing::AssertionResult result = test::same(found, expected);
  expect(result, what + ": " + result.message());
}

void expect_same(const Files& together, const Files& alone, const std::string& what, const Communicator& ranks) {
  if (!ranks.is_first()) return;
  expect(!alone.ply.empty(), what + ": a PLY");
  expect_same_bytes(together.ply, alone.ply, what + ": PLY");
  expect_same_bytes(together.checkpoint, alone.checkpoint, what + ": checkpoint");
  expect(together.result.n_gaussians == alone.result.n_gaussians, what + ": number of Gaussians");
  const auto& own = together.result.evaluations;
  const auto& other = alone.result.evaluations;
  expect(own.size() == other.size(), what + ": evaluations");
  for (std::size_t i = 0; i < own.size(); ++i) {
    expect(own[i].second.mean.psnr == other[i].second.mean.psnr, what + ": PSNR");
  }
}

TrainConfig on_ranks(TrainConfig config) {
  config.threads = 1;
  config.deterministic = true;
  if (runs_on_gpu()) {
    config.device = "cuda";
    config.kernel = "segmented";
  }
  return config;
}

TrainConfig config_of(Strategy strategy) {
  TrainConfig config = strategy == Strategy::kBudget ? test::eventful_budget_config() : test::eventful_config();
  config.strategy = strategy;
  if (strategy == Strategy::kMcmc) config.max_gaussians = 160;
  config.iterations = 23;  // the last step has fewer views
  config.batch = 3;        // with four ranks, one renders nothing
  return on_ranks(config);
}

void check_strategy(const TrainConfig& config, const Scene& scene, Communicator& ranks,
                    std::int64_t splats_at_a_time = kSplatsAtATime) {
  const SharedFolder folder(ranks);
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  expect_same(train(config, scene, folder / "together", &ranks, {}, {}, splats_at_a_time), alone,
              name_of(config.strategy), ranks);
}

/// Trains with every feature, with and without an interruption. A checkpoint of any number of ranks continues on any
/// other number.
void check_everything(Communicator& ranks) {
  const SharedFolder folder(ranks);
  std::optional<test::FeatureScene> written;  // the ranks write the depth maps in turn
  for (int r = 0; r < ranks.size(); ++r) {
    if (r == ranks.rank()) written.emplace(folder / "depths");
    ranks.barrier("depth maps");
  }
  Scene scene = written->scene;
  scene.test.assign(scene.train.begin(), scene.train.begin() + 3);
  for (const test::FeatureRow& row : test::kFeatureRows) {
    TrainConfig config = on_ranks(test::every_feature(row, folder / "depths"));
    config.batch = row.batch == 1 ? ranks.size() : 5;  // as many views as ranks, and more
    config.test_iterations = {17};                     // after the checkpoint below
    config.save_iterations = {9};
    const std::string name = row.name();
    const fs::path alone_at = folder / (name + "alone"), together_at = folder / (name + "together");
    const Files alone = train_alone(config, scene, alone_at, ranks);
    expect_same(train(config, scene, together_at, &ranks), alone, name, ranks);
    if (ranks.is_first()) {
      for (const char* const file : {"exposures.json", "poses.json", "cameras.json"}) {
        expect(fs::exists(alone_at / file) == fs::exists(together_at / file), name + ": whether there is a " + file);
        if (!fs::exists(alone_at / file)) continue;
        expect_same_bytes(test::read_bytes(together_at / file), test::read_bytes(alone_at / file), name + ": " + file);
      }
    }
    const std::vector<int> saved = ModelFolder(alone_at).checkpoint_iterations();
    const int half = saved[saved.size() / 2];
    const auto copy = [&](const fs::path& from) {
      const fs::path path = from.string() + "_half.b3dgs";
      if (ranks.is_first()) fs::copy_file(ModelFolder(from).checkpoint(half), path);
      ranks.barrier("copied");
      return path;
    };
    const fs::path of_one = copy(alone_at), of_many = copy(together_at);
    expect_same(train(config, scene, folder / (name + "later"), &ranks, of_one), alone, name + ", alone first", ranks);
    const Files last = train_alone(config, scene, folder / (name + "last"), ranks, of_many);
    expect_same(last, alone, name + ", together first", ranks);
  }
}

/// Takes steps in several parts, because only few splats are rendered at a time.
void check_parts(Communicator& ranks) {
  test::TinySceneOptions options;
  options.masked = true;
  const Scene scene = test::make_tiny_scene(options);
  TrainConfig config = config_of(Strategy::kBudget);
  config.batch = 5;
  for (const std::int64_t splats_at_a_time : {1, 250}) check_strategy(config, scene, ranks, splats_at_a_time);
  config.exposure = true;
  check_strategy(config, scene, ranks, 1);
  config.exposure = false;
  config.strategy = Strategy::kDefault;
  config.densify_until_iter = 12;
  check_strategy(config, scene, ranks, 1);
}

/// Trains on panoramas and a perspective photograph. Gaussians across the seam have two splats, of which only one is
/// exchanged.
void check_panoramas(Communicator& ranks) {
  GaussianTensors truth;
  Scene scene = test::panorama_scene(&truth);
  for (const View& view : scene.train) {
    const ViewSplats splats = Rasterizer(torch::kCPU).project(truth, to_camera_view(view.camera), {});
    expect(splats.n_second > 20 && splats.n_second < splats.size(), "Gaussians across the seam of " + view.name);
  }
  scene.train[1] = test::make_tiny_scene().train[1];
  for (const Strategy strategy : {Strategy::kDefault, Strategy::kMcmc, Strategy::kBudget}) {
    TrainConfig config = config_of(strategy);
    config.opacity_reg = config.scale_reg = 0.01;  // depends on the number of splats
    config.test_iterations = {17};
    for (const std::int64_t splats_at_a_time : {kSplatsAtATime, std::int64_t{1}}) {
      check_strategy(config, scene, ranks, splats_at_a_time);
    }
  }
  // On a CPU, sums of the poses' gradients are rounded differently (sum_camera_parts()).
  TrainConfig config = config_of(Strategy::kDefault);
  config.pose_opt = true;
  if (runs_on_gpu()) return check_strategy(config, scene, ranks);
  config.densify_until_iter = 0;
  config.test_iterations = {23};
  const SharedFolder folder(ranks);
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  const Files together = train(config, scene, folder / "together", &ranks);
  if (!ranks.is_first()) return;
  const auto psnr = [](const Files& files) { return files.result.evaluations.at(0).second.mean.psnr; };
  expect(std::abs(psnr(together) - psnr(alone)) < 1e-3, detail::concat("poses: ", psnr(together), ", ", psnr(alone)));
}

/// Trains with fewer Gaussians than rows in a block, so that all ranks but one have none, also after a resume with a
/// forecast of memory.
void check_few(Communicator& ranks) {
  test::TinySceneOptions options;
  options.n_gaussians = 20;
  const Scene scene = test::make_tiny_scene(options);
  TrainConfig config = config_of(Strategy::kDefault);
  config.max_gaussians = RowOwners::kBlock;
  config.checkpoint_iterations = {12};
  config.keep_checkpoints = 2;
  const SharedFolder folder(ranks);
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  const fs::path half = ModelFolder(folder / "alone").checkpoint(12);
  expect_same(train(config, scene, folder / "together", &ranks), alone, "few", ranks);
  TrainHooks hooks;
  const auto memory = std::make_shared<test::ShortMemory>();
  memory->bytes = std::int64_t{1} << 40;
  hooks.memory = memory;
  use_rank_team(ranks, config, hooks);
  Trainer trainer(finalize(config, scene), scene, ModelFolder(folder / "later"), hooks);
  trainer.resume(half);
  const std::int64_t n = trainer.n_gaussians();
  expect(n != scene.points.size() && n <= RowOwners::kBlock, "density control, " + std::to_string(n) + " Gaussians");
  trainer.forecast_memory();
  expect(trainer.n_gaussians() == n, "the forecast keeps the resumed model");
  const TrainResult result = trainer.run();
  if (ranks.is_first()) expect_same_bytes(test::read_bytes(result.ply), alone.ply, "few, resumed: PLY");
}

/// Checks that the first rank warns that no view shows anything, once all have been rendered and at the end.
void check_empty(Communicator& ranks) {
  Scene scene = test::make_tiny_scene();
  for (std::size_t i = 1; i < scene.points.positions.size(); i += 3) scene.points.positions[i] += 1000;
  TrainConfig config = config_of(Strategy::kDefault);
  config.densify_from_iter = 100;
  int n_said = 0;
  TrainHooks hooks;
  hooks.on_warning = [&](const std::string& text) {
    n_said += text.find("no Gaussian is visible in 6 of 6 training views") != std::string::npos ? 1 : 0;
  };
  const SharedFolder folder(ranks);
  train(config, scene, folder / "together", &ranks, {}, hooks);
  expect(n_said == (ranks.is_first() ? 2 : 0), "warnings of empty views: " + std::to_string(n_said));
}

/// Checks that Gaussians that cannot be rendered are removed, both in a step and in an evaluation.
void check_invalid(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of(Strategy::kDefault);
  config.iterations = 3;
  const fs::path damaged = folder / "damaged.b3dgs";
  if (ranks.is_first()) {
    const fs::path checkpoint = train(config, scene, folder / "first", nullptr).result.checkpoint;
    Checkpoint read = read_checkpoint(checkpoint, scene, torch::kCPU);
    read.state.gaussians.means[3][1] = std::numeric_limits<float>::quiet_NaN();
    read.state.gaussians.log_scales[70].fill_(60);
    write_checkpoint(damaged, read.config, read.state, scene);
  }
  ranks.barrier("damaged");
  config.iterations = 23;
  const Files alone = train_alone(config, scene, folder / "alone", ranks, damaged);
  const Files together = train(config, scene, folder / "together", &ranks, damaged);
  expect_same(together, alone, "invalid", ranks);
  if (ranks.is_first()) expect(together.result.n_removed == 2, "two Gaussians are removed");

  TrainHooks hooks;
  use_rank_team(ranks, config, hooks);
  Trainer trainer(finalize(config, scene), scene, ModelFolder(folder / "evaluated"), hooks);
  trainer.resume(damaged);
  trainer.run(3);
  const Evaluation evaluation = trainer.evaluate(scene.train);
  expect(trainer.n_gaussians() == 118, "the evaluation removes two of 120");
  expect(!ranks.is_first() || evaluation.views.size() == scene.train.size(), "all views are evaluated");
  const TrainResult result = trainer.run();
  if (ranks.is_first()) expect_same_bytes(test::read_bytes(result.ply), alone.ply, "training goes on as alone");
}

/// Checks that a signal to one rank stops all of them after the same step, with a checkpoint to continue from.
void check_stop(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  const TrainConfig config = config_of(Strategy::kMcmc);
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  std::atomic<int> signal{0};
  TrainHooks hooks;
  hooks.stop_signal = &signal;
  if (ranks.rank() == ranks.size() - 1) signal = 2;
  const Files stopped = train(config, scene, folder / "together", &ranks, {}, hooks);
  expect(stopped.result.interrupted && stopped.result.iteration == config.batch, "stops after the first step");
  const fs::path checkpoint = ranks.exchange("checkpoint", stopped.result.checkpoint.string()).front();
  expect_same(train(config, scene, folder / "together", &ranks, checkpoint), alone, "resumed", ranks);
}

/// Trains on ranks without memory for more Gaussians. The number is capped, all ranks agree on it, and a training
/// resumed from the checkpoint has the bytes of one process.
void check_memory(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of(Strategy::kDefault);
  const bool is_last = ranks.rank() == ranks.size() - 1;
  const auto memory = std::make_shared<test::ShortMemory>();
  memory->rows_that_fit =
      RowOwners::round_robin(ranks.rank(), ranks.size(), 120, torch::kCPU).n_own();  // as at the start
  std::string messages;
  TrainHooks hooks;
  hooks.memory = memory;
  hooks.on_message = [&](const std::string& message) { messages += message + "\n"; };
  const Files held = train(config, scene, folder / "capped", &ranks, {}, hooks);
  for (const std::int64_t count : ranks.exchange_record("counts", held.result.n_gaussians)) {
    expect(count == held.result.n_gaussians && count <= 120, "the number is held");
  }
  expect(messages.find("capped at 120 Gaussians: GPU memory\n") != std::string::npos, "capped: " + messages);
  expect(memory->n_releases > 0, "all ranks free memory first");
  hooks = {};
  config.iterations = 29;
  const fs::path checkpoint = ranks.exchange("checkpoint", held.result.checkpoint.string()).front();
  const Files later = train_alone(config, scene, folder / "alone", ranks, checkpoint);
  expect_same(train(config, scene, folder / "later", &ranks, checkpoint), later, "after a hold", ranks);

  // One rank frees memory, and another one knows its limit.
  config.iterations = 23;
  const Files whole = train_alone(config, scene, folder / "whole", ranks);
  hooks.memory = std::make_shared<test::ShortMemory>();
  if (is_last) dynamic_cast<test::ShortMemory&>(*hooks.memory).n_failures = 1;
  expect_same(train(config, scene, folder / "freed", &ranks, {}, hooks), whole, "freed", ranks);
  hooks.memory = std::make_shared<test::ShortMemory>();
  if (is_last) dynamic_cast<test::ShortMemory&>(*hooks.memory).bytes = 100000;
  const Files limited = train(config, scene, folder / "limited", &ranks, {}, hooks);
  const auto counts = ranks.exchange_record("counts", limited.result.n_gaussians);
  for (const std::int64_t count : counts) expect(count == counts[0], "all ranks have one number");
  expect(!ranks.is_first() || counts[0] < whole.result.n_gaussians, "the limit of one rank holds all");
}

/// Trains with a rank that has no memory even for the existing Gaussians. All ranks end with a checkpoint, from which
/// training can continue.
void check_exhausted(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  const TrainConfig config = config_of(Strategy::kDefault);
  TrainHooks hooks;
  hooks.memory = std::make_shared<test::ShortMemory>();
  if (ranks.rank() == ranks.size() - 1) dynamic_cast<test::ShortMemory&>(*hooks.memory).n_failures = 1000;
  const fs::path checkpoint = ModelFolder(folder / "together").checkpoint(12);
  try {
    train(config, scene, folder / "together", &ranks, {}, hooks);
    expect(false, "a rank without memory");
  } catch (const OutOfMemoryError& error) {
    expect(std::string(error.what()) ==
               "out of memory after iteration 12, with 120 Gaussians; iteration 12 is saved, "
               "continue with --resume " +
                   checkpoint.string(),
           error.what());
  }
  const Files alone = train_alone(config, scene, folder / "alone", ranks, checkpoint);
  expect_same(train(config, scene, folder / "together", &ranks, checkpoint), alone, "resumed", ranks);
}

/// Checks that a rank that runs out of memory while it packs splats frees some, and that the step is repeated.
void check_packing(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of(Strategy::kDefault);
  config.iterations = 9;
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  bool is_armed = false;
  const test::FailingAllocator memory([&](std::size_t n_bytes) {  // fails for the next allocation of packed splats
    constexpr std::size_t kRow = kRowWords * sizeof(std::int32_t), kFewRows = 20;
    return is_armed && n_bytes >= kFewRows * kRow && n_bytes % kRow == 0 && std::exchange(is_armed, false);
  });
  TrainHooks hooks;
  hooks.on_progress = [&](const TrainProgress& progress) {
    if (ranks.rank() == ranks.size() - 1) is_armed |= progress.iteration == 6;
  };
  expect_same(train(config, scene, folder / "together", &ranks, {}, hooks), alone, "packed again", ranks);
  expect(!is_armed, "no allocation has failed");
}

/// Checks that the other ranks report which rank failed, why, and where to continue.
void check_failure(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of(Strategy::kDefault);
  config.checkpoint_interval = 6;
  const int last = ranks.size() - 1;
  TrainHooks hooks;
  hooks.wait_for_files = true;
  hooks.on_progress = [&](const TrainProgress& progress) {
    const bool fails = progress.iteration == 15 && std::string(progress.activity) == "training";
    if (fails && ranks.rank() == last) input_error("view4.png: cannot be opened");
  };
  const std::string checkpoint = ModelFolder(folder / "together").checkpoint(12).string();
  const std::string expected =
      "view4.png: cannot be opened; last checkpoint: " + checkpoint + ", continue with --resume " + checkpoint;
  std::string found;
  try {
    run_as_rank(ranks, [&] { train(config, scene, folder / "together", &ranks, {}, hooks); });
  } catch (const PeerError& error) {
    expect(error.rank() == last && ranks.rank() != last, "the rank that failed");
    found = error.what();
  } catch (const InputError& error) {
    found = error.what();
  }
  // Rank 0 removes the folder, so it waits for ranks that still look for a checkpoint in it.
  const auto mark = [&](int rank) { return folder / ("failed_" + std::to_string(rank)); };
  test::write_bytes(mark(ranks.rank()), "");
  for (int rank = 0; ranks.is_first() && rank < ranks.size(); ++rank) {
    while (!fs::exists(mark(rank))) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  const std::string whose =
      ranks.rank() == last ? "" : detail::concat("rank ", last, " of ", ranks.size(), " stopped: ");
  if (found != whose + expected) {
    std::cerr << "expected " << whose << expected << "\nfound " << found << "\n";
    throw test::Exit{1};
  }
}

/// Checks that all ranks end if rank 0 fails while the others wait to render views for it. They leave a checkpoint,
/// from which training can continue. If the caller goes on, so does the training.
void check_evaluation(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of(Strategy::kDefault);
  config.test_iterations = {17};
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  TrainHooks hooks;
  hooks.on_progress = [&](const TrainProgress& progress) {
    const bool fails = progress.iteration == 18 && std::string(progress.activity) == "evaluating";
    if (fails && ranks.is_first()) input_error("view4.png: cannot be opened");
  };
  const auto checkpoint = [&](const std::string& name) { return ModelFolder(folder / name).checkpoint(18); };
  const std::string others = detail::concat("rank 0 of ", ranks.size(), " stopped: "),
                    cause = "view4.png: cannot be opened",
                    saved = cause + "; iteration 18 is saved, continue with --resume ";
  const auto expect_failure = [&](const std::string& here, const std::string& there, const auto& body) {
    std::string found;
    try {
      body();
    } catch (const PeerError& error) {
      expect(!ranks.is_first(), "the rank that failed");
      found = error.what();
    } catch (const InputError& error) {
      found = error.what();
    }
    expect(found == (ranks.is_first() ? here : there), "found: " + found);
  };
  const std::string kept = saved + checkpoint("together").string();
  expect_failure(kept, others + kept, [&] { train(config, scene, folder / "together", &ranks, {}, hooks); });
  const Files resumed = train(config, scene, folder / "together", &ranks, checkpoint("together"));
  if (ranks.is_first()) expect_same_bytes(resumed.checkpoint, alone.checkpoint, "resumed");

  TrainHooks quiet;
  use_rank_team(ranks, config, quiet);
  Trainer trainer(finalize(config, scene), scene, ModelFolder(folder / "goes on"), quiet);
  trainer.run(12);
  expect_failure(cause, others + cause, [&] {
    trainer.evaluate(scene.test, [](std::size_t, const View&, const RenderedView&, const std::optional<ImageQuality>&) {
      input_error("view4.png: cannot be opened");
    });
  });
  const TrainResult result = trainer.run();
  if (ranks.is_first()) expect_same_bytes(test::read_bytes(result.ply), alone.ply, "training goes on");

  const std::string stopped = saved + checkpoint("stopped").string();
  expect_failure(stopped, others + stopped,
                 [&] { run_as_rank(ranks, [&] { train(config, scene, folder / "stopped", &ranks, {}, hooks); }); });
}

/// Checks that every rank names the last checkpoint, which rank 0 has written, if a loss is not finite.
void check_loss(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of(Strategy::kDefault);
  config.iterations = 3;
  const fs::path first =
      ranks.exchange("checkpoint", train(config, scene, folder / "model", &ranks).result.checkpoint.string()).front();
  config.iterations = 6;
  config.lambda_dssim = std::numeric_limits<double>::quiet_NaN();
  try {
    train(config, scene, folder / "model", &ranks, first);
    expect(false, "a loss that is not a number");
  } catch (const LossError& error) {
    const std::string end = "; last checkpoint: " + first.string() + ", continue with --resume " + first.string();
    expect(std::string(error.what()).find(end) != std::string::npos, error.what());
  }
  ranks.barrier("all have looked for the last checkpoint");  // before its folder is removed
}

/// Checks that ranks that read different scenes report the difference.
void check_scenes(Communicator& ranks) {
  struct Change {
    std::string part;  // expected in the message
    void (*apply)(Scene&);
  };
  const std::vector<Change> changes{
      {"number of train views: 5 there, 6 on rank 0", [](Scene& scene) { scene.train.pop_back(); }},
      {"number of test views: 3 there, 2 on rank 0", [](Scene& scene) { scene.test.push_back(scene.train[0]); }},
      {"name of train view 3: \"other.png\" there, ", [](Scene& scene) { scene.train[3].name = "other.png"; }},
      {": focal length, principal point, lens or pose of train view 5 (",
       [](Scene& scene) { scene.train[5].camera.cam_from_world.translation[1] += 1e-9; }},
      {": mask of train view 2 (", [](Scene& scene) { scene.train[2].mask_file = "/proc/self/exe"; }},  // any file
      {"number of points: 119 there, 120 on rank 0",
       [](Scene& scene) {
         scene.points.positions.resize(357);
         scene.points.colors.resize(357);
       }},
      {"positions or colours of points", [](Scene& scene) { scene.points.colors[8] ^= 1; }}};
  const SharedFolder folder(ranks);
  const int last = ranks.size() - 1;
  for (const Change& change : changes) {
    Scene scene = test::make_tiny_scene();
    if (ranks.rank() == last) change.apply(scene);
    try {
      train(config_of(Strategy::kDefault), scene, folder / "model", &ranks);
      expect(false, change.part);
    } catch (const InputError& error) {
      const std::string message = error.what();
      expect(message.find(detail::concat("rank ", last, " of ", ranks.size(), " and rank 0 read different scenes: ")) ==
                     0 &&
                 message.find(change.part) != std::string::npos,
             message);
    }
  }
  expect(!fs::exists(folder / "model" / "train.jsonl"), "nothing is written");
}

void run_scenario(const std::string& scenario, Communicator& ranks) {
  if (scenario == "everything") return check_everything(ranks);
  if (scenario == "parts") return check_parts(ranks);
  if (scenario == "panoramas") return check_panoramas(ranks);
  if (scenario == "few") return check_few(ranks);
  if (scenario == "empty") return check_empty(ranks);
  if (scenario == "invalid") return check_invalid(ranks);
  if (scenario == "stop") return check_stop(ranks);
  if (scenario == "memory") return check_memory(ranks);
  if (scenario == "exhausted") return check_exhausted(ranks);
  if (scenario == "packing") return check_packing(ranks);
  if (scenario == "evaluation") return check_evaluation(ranks);
  if (scenario == "loss") return check_loss(ranks);
  if (scenario == "failure") return check_failure(ranks);
  if (scenario == "scenes") return check_scenes(ranks);
  throw LogicError("unknown scenario " + scenario);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  return b3dgs::test::run_scenarios(argc, argv, b3dgs::run_scenario);
}
