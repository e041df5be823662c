// The training loop: the order of operations in a step, and nothing else.
#pragma once

#include <atomic>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "adaptive/kernel_timer.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "train/config/train_config.h"
#include "train/evaluate.h"
#include "train/memory/memory_source.h"
#include "train/timing/stage_timer.h"

namespace b3dgs {

struct TrainProgress {
  int iteration = 0, iterations = 0;
  double loss = 0;  // running average, 0.4 x new + 0.6 x old as the original prints it
  std::int64_t n_gaussians = 0;
  std::int64_t held_at = 0;  // the count does not grow beyond this for lack of GPU memory; 0: it may
  double elapsed_s = 0;      // of training this run, without evaluation and saving
  // "training", "checking kernels", "densifying", "timing kernels", "evaluating", "saving", "checkpoint"
  std::string activity;
};

/// Of a GPU, bytes besides the CUDA context, before the first step.
struct MemoryForecast {
  std::int64_t limit = 0;          // what may be taken
  std::int64_t photographs = 0;    // that stay there
  std::int64_t model = 0;          // with moments and statistics, at its count at the start
  std::int64_t pairs = 0;          // views of that model: splats, (tile, splat) pairs
  std::int64_t largest_count = 0;  // Gaussians for which there is room
};

struct TrainHooks {
  std::function<void(const TrainProgress&)> on_progress;  // after each step and before each longer activity
  std::function<void(const std::string&)> on_message;     // one line for the user
  std::function<void(const std::string&)> on_warning;     // likewise: something is wrong, and training goes on
  ProgressFn on_loading;                                  // while photographs are read before the first step
  const std::atomic<int>* stop_signal = nullptr;          // not 0: checkpoint and return
  // If set, every step is timed stage by stage, and told some time after the device has got through it.
  std::function<void(const StageTimes&)> on_stage_times;
  // After the last iteration's files and before its density control: the model is the one that is saved.
  std::function<void()> on_result;
  std::function<double()> clock_s;  // what a run's time is counted by; a steady clock if not set
  // Each file is on the disk before the next iteration begins: for tests of which files are written.
  bool wait_for_files = false;
  // What the candidates for a kernel are timed by; the device's own if not set.
  std::function<std::unique_ptr<KernelTimer>()> make_kernel_timer;
  std::shared_ptr<MemorySource> memory;  // the device's own if not set
  // Bytes of photographs that stay on the device in place of what --image_cache_gb says, for trainers that share one.
  std::optional<std::int64_t> image_budget;
};

struct TrainResult {
  int first_iteration = 0;   // done before this run
  int iteration = 0;         // last one done
  bool interrupted = false;  // by stop_signal
  std::int64_t n_gaussians = 0;
  std::int64_t peak_memory_bytes = 0;  // of the process on the GPU besides the CUDA context; 0: not counted
  double train_s = 0;   // all of the steps: uploads, checks of kernels, densification, Adam; but no reading of files
  double output_s = 0;  // evaluation, statistics, saving, checkpoints
  std::int64_t n_removed = 0;                           // Gaussians that could not be rendered, over all runs
  std::filesystem::path ply, checkpoint;                // last ones written
  std::vector<std::filesystem::path> not_written;       // for want of room, or whatever else the system said
  std::vector<std::pair<int, Evaluation>> evaluations;  // of the test views, by iteration
};

class Trainer {
 public:
  /// `scene` must outlive the trainer. @throws InputError if config.device cannot be used
  Trainer(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks);
  ~Trainer();

  /// Continues from a checkpoint. Returns the options that differ from it, as "name: old -> new".
  /// @throws InputError if the file is damaged or does not belong to this scene.
  std::vector<std::string> resume(const std::filesystem::path& checkpoint);

  /// Runs to config.iterations (or the stop signal), writing the folder's files on the way. Gaussians that cannot be
  /// rendered are removed, and files that cannot be written on the way warned of; the training goes on.
  /// What ends it leaves a checkpoint of the last whole iteration, which the error names; where the loss is not finite,
  /// the model may be spoilt, and the error names the last checkpoint before.
  /// @throws InputError if the folder holds the model of another training, or a photograph is lost; IoError if the last
  /// files cannot be written; NumericError with iteration and view; OutOfMemoryError
  TrainResult run();

  /// As run(), but returns after `iteration`, at most config.iterations; call again to go on. The course and the files
  /// are those of one run(), whatever the pieces. The device has finished when this returns, so that trainers can take
  /// turns and each pays for its own time.
  TrainResult run_until(int iteration);

  /// Last iteration done.
  int iteration() const;

  /// Renders `views` with the model as it stands and measures them; the training must have begun.
  Evaluation evaluate(const std::vector<View>& views, const RenderedFn& on_rendered = {});

  /// Writes a checkpoint of the training as it stands, which must have begun, and waits for it. @throws IoError
  std::filesystem::path write_checkpoint();

  /// One iteration with its density control; nothing is written. For benchmarks.
  void step();

  /// Waits until the device is done with all steps, and tells the times that have not been told.
  void wait();

  /// Where the photographs are, on one line: "for training 80 in memory (0.10 GB); for testing none".
  std::string describe_images() const;

  std::int64_t n_gaussians() const;
  int sh_degree() const;  // in use

  /// What training is going to take of a GPU's memory; nothing if that is not counted.
  std::optional<MemoryForecast> forecast_memory();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
