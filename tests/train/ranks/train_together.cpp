// A program of several ranks for train_ranks_tests: train_together RANKS SCENARIO. What several ranks train together
// must have the bytes of what one process trains alone with the same options.
#include <torch/torch.h>

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>

#include "core/check.h"
#include "dist/communicator.h"
#include "support/rank_program.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::expect;

/// Files of a training; of several ranks, on rank 0.
struct Files {
  TrainResult result;
  std::string ply, checkpoint;
};

/// Trains with `ranks`, or alone if it is null.
Files train(const TrainConfig& config, const Scene& scene, const fs::path& folder, Communicator* ranks,
            const fs::path& resume = {}, TrainHooks hooks = {}) {
  hooks.ranks = ranks;
  Trainer trainer(config, scene, ModelFolder(folder), hooks);
  if (!resume.empty()) trainer.resume(resume);
  Files files;
  files.result = trainer.run();
  if (ranks != nullptr && !ranks->is_first()) return files;
  if (!files.result.ply.empty()) files.ply = test::read_bytes(files.result.ply);
  files.checkpoint = test::timeless_bytes(files.result.checkpoint);
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

/// On rank 0, the files of a training alone; the others wait.
Files train_alone(const TrainConfig& config, const Scene& scene, const fs::path& folder, Communicator& ranks,
                  const fs::path& resume = {}) {
  Files files;
  if (ranks.is_first()) files = train(config, scene, folder, nullptr, resume);
  ranks.barrier("trained alone");
  return files;
}

/// What a training on several ranks says about them.
void expect_figures(const TrainResult& together, const std::string& what, const Communicator& ranks) {
  expect(together.ranks.has_value(), what + ": no figures of the ranks");
  const RankFigures& figures = *together.ranks;
  const auto size = static_cast<std::size_t>(ranks.size());
  expect(figures.n_steps > 0 && figures.entries.size() == size && figures.sent_bytes.size() == size,
         what + ": figures of each rank");
  double entries = 0, sent = 0, received = 0;
  for (std::size_t r = 0; r < size; ++r) {
    entries += figures.entries[r];
    sent += figures.sent_bytes[r];
    received += figures.received_bytes[r];
  }
  expect(entries > 0 && sent > 0 && std::abs(sent - received) < 1e-6 * sent, what + ": what is sent is received");
  const auto limit = static_cast<double>(size);
  expect(figures.busiest >= 1 && figures.busiest <= limit, what + ": busiest rank");
  expect(figures.busiest_equal >= 1 && figures.busiest_equal <= limit, what + ": busiest rank of equal parts");
}

void expect_same(const Files& together, const Files& alone, const std::string& what, const Communicator& ranks) {
  if (!ranks.is_first()) return;
  expect(!alone.result.ranks, what + ": figures of one rank");
  expect(!alone.ply.empty() && together.ply == alone.ply, what + ": PLY");
  expect(together.checkpoint == alone.checkpoint, what + ": checkpoint");
  expect(together.result.n_gaussians == alone.result.n_gaussians, what + ": number of Gaussians");
  const auto& own = together.result.evaluations;
  const auto& other = alone.result.evaluations;
  expect(own.size() == other.size(), what + ": evaluations");
  for (std::size_t i = 0; i < own.size(); ++i) {
    expect(own[i].second.mean.psnr == other[i].second.mean.psnr, what + ": PSNR");
  }
}

TrainConfig config_of(const std::string& strategy) {
  TrainConfig config = strategy == "balanced" ? test::eventful_balanced_config() : test::eventful_config();
  config.strategy = strategy;
  if (strategy == "mcmc") config.max_gaussians = 160;
  config.iterations = 23;  // the last step has fewer views
  config.batch = 3;
  config.threads = 1;
  config.deterministic = true;
  return config;
}

void check_strategy(const TrainConfig& config, const Scene& scene, Communicator& ranks) {
  const SharedFolder folder(ranks);
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  const Files together = train(config, scene, folder / "together", &ranks);
  expect_same(together, alone, config.strategy, ranks);
  expect_figures(together.result, config.strategy, ranks);
}

/// Everything that the step of a view may do.
void check_options(Communicator& ranks) {
  test::TinySceneOptions options;
  options.masked = true;
  Scene scene = test::make_tiny_scene(options);
  scene.test.assign(scene.train.begin(), scene.train.begin() + 3);
  TrainConfig config = config_of("balanced");
  config.test_iterations = {7, 12};
  config.save_iterations = {9};
  config.antialiasing = true;
  config.opacity_reg = config.scale_reg = 0.01;
  config.coarse_scale = 2;
  config.coarse_until = 12;
  config.noise_lr = 1000;
  for (const int batch : {2, 5}) {  // fewer and more views than ranks
    config.batch = batch;
    check_strategy(config, scene, ranks);
  }
}

/// Fewer Gaussians than ranks x rows of a block, some ranks have none.
void check_few(Communicator& ranks) {
  test::TinySceneOptions options;
  options.n_gaussians = 20;
  TrainConfig config = config_of("default");
  config.densify_from_iter = 100;
  check_strategy(config, test::make_tiny_scene(options), ranks);
}

/// A checkpoint of any number of ranks continues on any other.
void check_resume(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of("balanced");
  config.checkpoint_interval = 6;
  config.keep_checkpoints = 10;
  const Files alone = train_alone(config, scene, folder / "alone", ranks);
  const Files together = train(config, scene, folder / "together", &ranks);
  expect_same(together, alone, "whole", ranks);
  for (const int iteration : {6, 12, 18}) {
    const std::string name = std::to_string(iteration);
    const auto copy = [&](const std::string& from) {
      const fs::path path = folder / ("from_" + from + name + ".b3dgs");
      if (ranks.is_first()) fs::copy_file(ModelFolder(folder / from).checkpoint(iteration), path);
      ranks.barrier("copied");
      return path;
    };
    const Files later = train(config, scene, folder / ("together" + name), &ranks, copy("alone"));
    expect_same(later, alone, "alone, then together from " + name, ranks);
    const Files last = train_alone(config, scene, folder / ("alone" + name), ranks, copy("together"));
    expect_same(last, alone, "together, then alone from " + name, ranks);
  }
}

/// Gaussians that cannot be rendered are removed: in a step, and if an evaluation finds them.
void check_invalid(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of("default");
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
  hooks.ranks = &ranks;
  Trainer trainer(config, scene, ModelFolder(folder / "evaluated"), hooks);
  trainer.resume(damaged);
  trainer.run_until(3);
  const Evaluation evaluation = trainer.evaluate(scene.train);
  expect(trainer.n_gaussians() == 118, "the evaluation removes two of 120");
  expect(!ranks.is_first() || evaluation.views.size() == scene.train.size(), "all views are evaluated");
  const TrainResult result = trainer.run();
  if (ranks.is_first()) expect(test::read_bytes(result.ply) == alone.ply, "training goes on as alone");
}

/// A signal that one rank receives stops all of them after the same step, with a checkpoint to continue from.
void check_stop(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  const TrainConfig config = config_of("mcmc");
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

void check_unsupported(Communicator& ranks) {
  const Scene scene = test::make_tiny_scene();
  const SharedFolder folder(ranks);
  TrainConfig config = config_of("default");
  config.exposure = true;
  if (ranks.size() == 1) return;
  try {
    train(config, scene, folder / "model", &ranks);
  } catch (const InputError& error) {
    return expect(std::string(error.what()).find("--exposure: not supported with several ranks") == 0, error.what());
  }
  expect(false, "--exposure is refused");
}

void run_scenario(const std::string& scenario, Communicator& ranks) {
  if (scenario == "options") return check_options(ranks);
  if (scenario == "few") return check_few(ranks);
  if (scenario == "resume") return check_resume(ranks);
  if (scenario == "invalid") return check_invalid(ranks);
  if (scenario == "stop") return check_stop(ranks);
  if (scenario == "unsupported") return check_unsupported(ranks);
  check_strategy(config_of(scenario), test::make_tiny_scene(), ranks);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const std::string scenario = argv[2];
  b3dgs::test::RankProgram program;
  program.size = std::atoi(argv[1]);
  program.arguments = {argv[1], scenario};
  program.body = [&](b3dgs::Communicator& ranks) { b3dgs::run_scenario(scenario, ranks); };
  return b3dgs::test::report_errors([&] { return b3dgs::test::run_rank_program(program); });
}
