#include "app/compare/interleaved_training.h"

#include <algorithm>
#include <deque>
#include <memory>

#include "app/common/stop_request.h"
#include "app/common/torch/progress.h"
#include "app/report/train_report.h"
#include "app/train/session_record.h"
#include "core/files/folders.h"
#include "core/text.h"
#include "dist/communicator.h"
#include "train/checkpoint/checkpoint.h"
#include "train/device.h"
#include "train/images/image_store.h"
#include "train/scene_limits.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

TrainConfig run_config(const Configuration& configuration, const ModelFolder& folder, std::int64_t seed) {
  TrainConfig config = configuration.config;
  config.seed = seed;
  config.model_path = folder.root().string();
  return config;
}

class InterleavedTraining {
 public:
  InterleavedTraining(const ComparisonPlan& plan, std::int64_t seed, const Scene& scene, StatusLine& status)
      : plan_(plan), seed_(seed), scene_(scene), status_(status) {
    const std::vector<Configuration> configurations = plan.configurations();
    // By default a trainer uses half of the free memory for images, so later trainers would get less than the first.
    // Here the budget is divided equally.
    const std::int64_t share = image_budget(-1, choose_device(plan.base.device), plan.base.gpu_memory_gb) /
                               static_cast<std::int64_t>(configurations.size());
    for (const Configuration& configuration : configurations) add(configuration, share);
  }

  bool run(double reading_s, const nlohmann::ordered_json& machine) {
    const bool is_complete = take_turns();
    status_.clear();
    if (!is_complete) write_checkpoints();
    for (const Turn& turn : turns_) {
      if (turn.result.iteration == 0) continue;  // stopped before its first turn
      record_session(machine, reading_s, turn.result.output_s, *turn.trainer, scene_, turn.folder, *ranks_);
      write_train_report(turn.folder);
    }
    return is_complete;
  }

 private:
  struct Turn {
    Configuration configuration;
    ModelFolder folder;
    std::string label;  // "NAME, seed 0: "
    Eta eta;
    std::unique_ptr<FolderLock> lock{};
    std::unique_ptr<Trainer> trainer{};
    TrainResult result{};
    int iterations() const { return configuration.config.iterations; }
  };

  void add(const Configuration& configuration, std::int64_t image_budget) {
    const ModelFolder folder = plan_.folder(configuration, seed_);
    const FinalConfig final_config = finalize(run_config(configuration, folder, seed_), scene_);
    const TrainConfig& config = final_config.options;
    const std::string label = detail::concat(configuration.name, ", seed ", seed_, ": ");
    Turn& turn = turns_.emplace_back(Turn{configuration, folder, label, Eta(config.iterations)});
    turn.lock = std::make_unique<FolderLock>(folder.root());
    TrainHooks hooks = hooks_for(status_, turn.label);
    hooks.on_progress = [this, &turn](const TrainProgress& progress) { show(turn, progress); };
    hooks.stop_signal = &stop_signal();
    hooks.image_budget = image_budget;
    hooks.on_last_files_written = [this, &turn] { record_previews(*turn.trainer, scene_, turn.folder, *ranks_); };
    hooks.resume_command = resume_command(plan_);
    turn.trainer = std::make_unique<Trainer>(final_config, scene_, folder, hooks);
    status_.clear();
    if (const std::string text = describe_epochs(config, plan_.photographs); !text.empty()) hooks.on_message(text);
    hooks.on_message("photographs " + turn.trainer->describe_images());
    const fs::path checkpoint = newest_valid_checkpoint(folder, hooks.on_warning);
    if (checkpoint.empty()) return;
    for (const std::string& change : turn.trainer->resume(checkpoint)) hooks.on_message("changed option " + change);
  }

  bool take_turns() {
    const auto seed_index = std::find(plan_.seeds.begin(), plan_.seeds.end(), seed_) - plan_.seeds.begin();
    const int longest = plan_.longest();
    int start = longest;
    for (const Turn& turn : turns_) {
      if (turn.trainer->iteration() < turn.iterations()) start = std::min(start, turn.trainer->iteration());
    }
    int n_turns = start / plan_.chunk;  // a resumed comparison keeps the order of turns
    for (int until = start - start % plan_.chunk; until < longest; ++n_turns) {
      until = std::min(until + plan_.chunk, longest);
      const std::size_t first = first_in_turn(static_cast<std::size_t>(seed_index), n_turns, turns_.size());
      for (std::size_t i = 0; i < turns_.size(); ++i) {
        Turn& turn = turns_[(first + i) % turns_.size()];
        if (turn.result.iteration == turn.iterations()) continue;  // shorter than the others, and finished
        turn.result = turn.trainer->run(std::min(until, turn.iterations()));
        if (stop_signal() != 0) return false;
      }
    }
    return true;
  }

  void write_checkpoints() {
    for (const Turn& turn : turns_) {
      const bool has_started = turn.result.iteration > 0;
      if (has_started && turn.result.checkpoint != turn.folder.checkpoint(turn.trainer->iteration())) {
        turn.trainer->write_checkpoint();
      }
    }
  }

  void show(Turn& turn, const TrainProgress& progress) {
    turn.eta.add(progress.iteration, progress.elapsed_s);
    std::optional<double> all = 0.0;  // known after every configuration has had a turn
    for (const Turn& own : turns_) {
      const std::optional<double> left = own.eta.seconds_left();
      all = all && left ? std::optional(*all + *left) : std::nullopt;
    }
    status_.show(turn.label + format_train_progress(progress, turn.eta.iterations_per_second(), all));
  }

  const ComparisonPlan& plan_;
  const std::int64_t seed_;
  const Scene& scene_;
  StatusLine& status_;
  const std::unique_ptr<Communicator> ranks_ = Communicator::alone();
  std::deque<Turn> turns_;  // elements do not move, because the trainers' hooks refer to them
};

}  // namespace

bool train_in_turns(const ComparisonPlan& plan, std::int64_t seed, const Scene& scene, double reading_s,
                    const nlohmann::ordered_json& machine, StatusLine& status) {
  return InterleavedTraining(plan, seed, scene, status).run(reading_s, machine);
}

std::string resume_command(const ComparisonPlan& plan) {
  return "b3dgs compare --resume -m " + shell_quote(plan.root().string());
}

std::size_t first_in_turn(std::size_t seed_index, int turn, std::size_t n_configurations) {
  return (seed_index + 1 + static_cast<std::size_t>(turn)) % n_configurations;
}

void warm_up(const ComparisonPlan& plan, const Scene& scene) {
  constexpr std::int64_t kPoints = 10000;
  Scene part = scene;
  const auto n = static_cast<std::size_t>(std::min(kPoints, part.points.size()));
  part.points.positions.resize(3 * n);
  part.points.colors.resize(3 * n);
  part.train.resize(std::min<std::size_t>(1, part.train.size()));
  part.test.clear();
  TrainHooks hooks;
  hooks.resume_command = resume_command(plan);
  for (const Configuration& configuration : plan.configurations()) {
    const WorkFolder folder(plan.root());
    TrainConfig config = run_config(configuration, ModelFolder(folder.path()), 0);
    if (n > 0) config.init_ply.clear();   // the part has fewer points; without points, the PLY is needed
    constexpr int kIterations = 5;        // the first are in a timing check, which runs both kernels
    config.iterations = kIterations + 1;  // at its end, a training writes its outputs
    config.densify_from_iter = 0;
    config.densification_interval = 2;
    Trainer(finalize(config, part), part, ModelFolder(folder.path()), hooks).run(kIterations);
  }
}

}  // namespace b3dgs
