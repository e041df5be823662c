// The trainer's members, shared by its sources in the order of an iteration:
//   trainer_step.cpp      one optimizer step, with the kernel check before it
//   trainer_batch.cpp     a step of several views (--batch)
//   trainer_ranks/        several processes that train together
//   trainer_outputs.cpp   what is evaluated, logged and saved after it, and at the start of a session
//   trainer_density.cpp   density control within the memory of the device
//   trainer_faults.cpp    what happens when a step fails
//   trainer.cpp           the public interface and the loop
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "config/batch_steps.h"
#include "config/output_plan.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "dist/communicator.h"
#include "raster/checks.h"
#include "scene/view_image.h"
#include "train/appearance/appearance_model.h"
#include "train/checkpoint/train_state.h"
#include "train/density/density_strategy.h"
#include "train/density/row_edit.h"
#include "train/depth/depth_priors.h"
#include "train/device.h"
#include "train/gaussians/smoothing_filter.h"
#include "train/images/image_store.h"
#include "train/images/view_reducer.h"
#include "train/loss/error_image.h"
#include "train/loss/loss.h"
#include "train/memory/memory_plan.h"
#include "train/memory/memory_source.h"
#include "train/optimizer/gaussian_step.h"
#include "train/output/train_recorder.h"
#include "train/poses/pose_refiner.h"
#include "train/ranks/draw_plan.h"
#include "train/ranks/rows/row_owners.h"
#include "train/ranks/splat_exchange.h"
#include "train/selection/kernel_chooser.h"
#include "train/timing/stage_timer.h"
#include "train/timing/time_account.h"
#include "train/trainer.h"
#include "train/trainer_ranks/rank_records.h"

namespace b3dgs {

/// The loss is not finite, or no valid Gaussian is left: the model may be damaged, and no checkpoint is written.
class LossError : public NumericError {
 public:
  using NumericError::NumericError;
};

struct Trainer::Impl {
  /// `config.device` is "cpu" or "cuda".
  Impl(const TrainConfig& config, const Scene& scene, ModelFolder folder, TrainHooks hooks);

  // trainer.cpp
  /// One iteration and everything it writes. @throws what failed, with the path of the checkpoint written appended
  void iterate();
  void show_model();
  bool is_stopped() const { return hooks.stop_signal && hooks.stop_signal->load() != 0; }
  /// Whether training is to end after this step; the same on all ranks.
  bool must_stop() const { return is_distributed() ? agreed.stop : is_stopped(); }

  // trainer_step.cpp
  void initialize_model();
  /// One step; repeated without the Gaussians that cannot be rendered. Starts with a kernel check if one is due.
  void step();
  void take_step();
  /// The view of this iteration: with its refined pose, and at a part of its size with --coarse_scale.
  TrainView take_view(int iteration);
  /// The gradient of the depth loss with respect to the render of a view; undefined if it has no depth map.
  torch::Tensor depth_gradient(const TrainView& view, const RenderedView& rendered);
  /// Moves the Gaussians along the gradients of one view, and updates the density statistics.
  void learn(const TrainView& view);
  /// What a step does with a view before its backward pass.
  struct ComparedView {
    DensityPlan plan;
    bool refines_pose = false;
    RenderedView rendered;
    torch::Tensor color;    // as the photograph shows it
    RenderedViewGrad grad;  // of the loss
  };
  /// Renders a view and compares it with its photograph. `is_filter_due`: the filters are computed before.
  ComparedView compare(const TrainView& view, bool is_filter_due);
  /// The comparison alone: the loss, and its gradient with respect to the render.
  void compare_with_photograph(const TrainView& view, ComparedView& compared);
  /// Memory is planned with the sizes of the views that were rendered.
  void note_view_size();
  /// Warns after each view has been drawn once if no Gaussian is visible in some of them.
  void note_visibility(std::int32_t view, bool is_empty);
  /// The same at the end, if these are half of the views, or more than before.
  void warn_of_empty_views();
  /// Adds the view to the density statistics.
  void add_to_statistics(const TrainView& view, const ComparedView& compared, const ViewStatistics& statistics);
  RenderSettings step_settings();
  /// Waits for the loss of the last step and adds it to the average; before that, finishes the step of its pose.
  /// @throws LossError if the loss is not finite
  void read_loss();
  /// Times the blending kernels before the step of `iteration`, if that is due. Does not change the training state.
  void check_kernels(int iteration);
  CheckMoment check_moment(int iteration) const;
  /// The next views, and the current model.
  BlendInput kernel_check_input();
  /// Applies the deferred optimizer updates, which is part of training.
  void flush() {
    if (state.gaussians.size() > 0) stepper.flush(state.gaussians, state.adam);
  }
  /// The state without deferred updates, and with filters for anti-aliasing.
  TrainState& flushed_state() {
    flush();
    update_filters(/*is_due=*/false);
    return state;
  }
  /// The filters follow the means, which move slowly.
  static bool is_filter_iteration(int iteration) { return iteration % 100 == 1; }
  /// Makes the state of the appearance model, unless that of a checkpoint fits, and drops what no option asks for.
  void prepare_appearance();
  /// How views are to be compared: with their exposures as learned so far.
  ColorEvaluation color_evaluation() const;
  /// With --antialiasing, computes the filters of the Gaussians if that is due or rows have changed. All ranks call it
  /// together.
  void update_filters(bool is_due);

  // trainer_batch.cpp
  /// Whether steps keep the gradients of their views' splats, from which a pass of its own takes the Adam step. Else
  /// the backward pass of the one view does that, which is faster. The GPU compiler may fuse multiplications and
  /// additions differently in the two; --deterministic always has the bytes of the former.
  bool keeps_views() const { return config.batch > 1 || (config.deterministic && !device.is_cpu()); }
  void take_batched_step();
  /// One view of a step: everything up to the gradients of its splats, which are kept.
  void keep_view(const TrainView& view, bool is_filter_due);
  /// The step along the gradients of the views that were kept. Cannot fail, and allocates nothing.
  void learn_from_kept_views();
  /// Begins a step of the views up to iteration `last`. Returns whether filters for anti-aliasing are due.
  bool begin_step_of_views(int last);
  /// First iteration of the last step.
  int first_of_step() const { return state.iteration - state.step_iterations + 1; }

  // trainer_ranks/
  bool is_distributed() const { return ranks != nullptr && ranks->size() > 1; }
  /// Whether this process writes the files: one of several does.
  bool writes_files() const { return !is_distributed() || ranks->is_first(); }
  /// Drops the rows of other ranks from a model that every rank holds whole in host memory, and moves its own to the
  /// device.
  void keep_own_rows();
  /// The Gaussians of all ranks: on rank 0, in host memory; undefined on the others.
  GaussianTensors gathered_gaussians();
  /// Rank 0 writes the rows of all ranks as they come, piece by piece.
  void write_checkpoint_of_ranks();
  void take_distributed_step();
  struct LearnedView;
  static constexpr std::int64_t kCameraColumns = 2 * kCameraGradients;  // of n_shared_columns(): doubles as floats
  /// The next views of a step up to iteration `last`, at most n_views_at_a_time().
  std::vector<LearnedView> next_views_of_step(int last);
  std::size_t n_views_at_a_time() const;
  /// Up to the gradients of the splats of these views, which each rank keeps for its Gaussians.
  /// `from`, `last`: the iteration before this part of the step, and the step's last one.
  void keep_views_of_ranks(int from, const std::vector<LearnedView>& learned, int last, bool is_filter_due);
  struct ViewsOfRanks;  // step.cpp; the next six follow each other
  /// Errors are left in the record: all ranks learn of them.
  void project_own_gaussians(ViewsOfRanks& step, bool is_filter_due, StepRecord& record);
  void exchange_records(ViewsOfRanks& step, StepRecord record, int last);
  void draw_own_views(ViewsOfRanks& step);
  /// View `v` of the step. `own_next`: views that this rank draws after this one.
  void draw_view(ViewsOfRanks& step, std::size_t v, const ViewSplats& drawn, const std::vector<std::int32_t>& own_next);
  /// Sends the sums back; `sums` are then those of the own splats of each view, whose gradients are kept.
  void keep_own_splats(ViewsOfRanks& step);
  void gather_pose_gradients(ViewsOfRanks& step);
  /// Views that this rank will probably draw after this part of the step. Plans the next steps, on all ranks alike.
  std::vector<std::int32_t> own_views_ahead();
  /// What is learned of photographs with the Gaussians: gradients of a view that this rank has drawn, as a row of
  /// n_shared_columns() floats; and those of all views of a part of the step, from which every rank learns the same.
  std::int64_t n_shared_columns() const;
  torch::Tensor shared_gradients() const;
  void keep_shared_gradients(const std::vector<LearnedView>& learned, const std::vector<torch::Tensor>& drawn);
  /// The view of an iteration that this rank draws. `next`: those that it draws after it, to be read ahead.
  TrainView take_own_view(int iteration, std::int32_t index, const std::vector<std::int32_t>& next);
  /// The camera of a view, as take_view() has it.
  PinholeView camera_of(std::int32_t index, int iteration);
  /// Who draws these views, which are those of the step after iteration `from`, or of a part of it.
  std::vector<int> planned_drawers(int from, const std::vector<LearnedView>& views);
  struct UnreadLoss;
  /// Adds the loss of a view to the average. @throws LossError if it is not finite
  void add_loss(const UnreadLoss& of, double value);
  /// Exchanges what was drawn in the last step, and adds its losses to the average. All ranks call it together.
  void read_losses_of_ranks();
  /// Waits for the loss of the view drawn last, if it has not been read.
  void read_own_loss();
  /// Rasterizer::row_entries() in host memory, valid when the loss of the view has been read.
  torch::Tensor queue_row_entries() const;
  /// What this rank has drawn in the last step. Waits for the loss of the view drawn last.
  DrawnRecord take_drawn();
  /// Losses for the average, and work for the plans to come.
  void add_drawn(const std::vector<DrawnRecord>& of_ranks);
  /// Calls work() on rank 0, which may render the whole model; the other ranks project their Gaussians for it.
  void on_first_rank(const std::function<void()>& work);
  void serve_renders();
  /// Renders the whole model. With several ranks: on rank 0 only, within on_first_rank(). @throws InvalidGaussianError
  RenderedView render(const PinholeView& view, const RenderSettings& settings);
  RenderedView project_and_draw(const PinholeView& view, const RenderSettings& settings);
  void adopt_kernels_of_first_rank();
  /// At the start of a session, replaces the arguments by those of rank 0, and agrees whether kernels are to be
  /// checked.
  void agree_on_start(bool& lacks_ply, bool& lacks_checkpoint);
  /// Whether all files of the last iteration could be written; the same on all ranks.
  bool has_written_files();
  DensityRound plan_round_of_ranks(int iteration, std::int64_t limit);
  /// Applies a round's edit to the own rows. `limit`: of the model's Gaussians; 0 = none.
  void apply_round_of_ranks(const DensityRound& round, int iteration, std::int64_t limit);
  /// reserve() of the editor, if possible with spare capacity, so that most rounds reallocate nothing. `limit`: of the
  /// rows; 0 = none.
  void reserve_rows(const RowEdit& edit, std::int64_t limit);
  /// Redistributes the rows evenly. Does nothing if a rank lacks the memory for it.
  void redistribute_rows();
  /// Calls work(), which allocates and exchanges nothing. @throws OutOfMemoryError on all ranks if that fails on one
  void allocate_together(const std::function<void()>& work);
  [[noreturn]] void throw_out_of_memory(int rank, const std::string& reason);
  /// A remedy that counts as successful on all ranks if it is on one.
  MemoryRemedy together(MemoryRemedy remedy);
  /// Removes the Gaussian of this row of the model, and others that are invalid. Returns their number.
  std::int64_t remove_invalid_rows(std::int64_t row);

  // trainer_outputs.cpp
  void begin();
  /// What a checkpoint says about the scene.
  nlohmann::ordered_json identify_scene() const;
  void claim_folder();
  void write_outputs(const OutputPlan& plan);
  void log_load();
  void log_kernel_times();
  void log_floaters();
  /// No value if no test view has a valid pixel.
  std::optional<ImageQuality> evaluate_test_views();
  void write_ply();
  /// cameras.json and poses.json, with the refined poses.
  void write_poses();
  void write_checkpoint();

  // trainer_density.cpp
  /// What falls on the iterations of the last step.
  void control_density();
  void control_density(int iteration);
  /// A round of density control, with fewer or no new Gaussians if memory is short.
  void run_density_round(int iteration);
  /// `adds`: whether Gaussians may be added.
  void plan_and_apply_round(int iteration, bool adds = true);
  GaussianMemory memory_of_gaussian();
  /// Number of Gaussians for which there is memory; nothing if memory is not limited.
  std::optional<std::int64_t> room_for_gaussians();
  /// Whether the hold can end now that there is memory for `room` Gaussians (0 = any number).
  bool can_grow_again(std::int64_t room) const;
  /// The model does not grow beyond `count` until there is memory for more. Logged at the start of a hold and when it
  /// drops by over 1 %.
  void hold_count(std::int64_t count);
  /// Returns memory that the allocator caches beyond a share.
  void trim_memory();
  MemoryRemedy wait_for_files();
  MemoryRemedy free_scratch();
  MemoryRemedy release_photographs();

  // trainer_faults.cpp
  void roll_back();
  void remove_invalid_gaussians(const InvalidGaussianError& error);
  /// Repeats `work` without the Gaussians that it cannot render.
  template <class Work>
  auto without_invalid_gaussians(Work&& work) {
    for (;;) {
      try {
        return work();
      } catch (const InvalidGaussianError& error) {
        remove_invalid_gaussians(error);
      }
    }
  }
  /// Writes a checkpoint if the state is consistent, and rethrows the current exception with the checkpoint's path.
  [[noreturn]] void end_with_checkpoint();
  std::string save_last_state();
  /// The same on several ranks, if all of them have failed in the same place.
  std::string save_together();
  /// How to continue from a checkpoint.
  std::string resume_words(const std::filesystem::path& checkpoint) const;
  /// The newest one in the model folder, which rank 0 writes.
  std::string last_checkpoint_of_ranks() const;

  const TrainConfig config;
  const Scene& scene;
  const ModelFolder folder;
  std::optional<OwnFiles> own_files;  // of the folder, while it is written
  const TrainHooks hooks;
  Communicator* const ranks;  // null: this process trains alone
  const torch::Device device;
  const double gpu_memory_gb;  // that this process may use; 0: all that is free

  const std::shared_ptr<MemorySource> memory;
  const bool memory_is_limited = memory->limit().has_value();
  RowEditor row_editor;
  Rasterizer rasterizer;
  std::optional<SmoothingFilter> smoothing_filter;  // with --antialiasing
  GaussianStepper stepper;
  ImageLoss loss;
  ErrorImage error_image;
  const std::unique_ptr<AppearanceModel> appearance;  // null = none
  std::optional<DepthPriors> depth_priors;            // with --depths
  const std::unique_ptr<DensityStrategy> density;
  KernelChooser kernels;
  ImageStore images;
  ViewReducer reducer;
  StageTimer timer;
  TimeAccount time;
  TrainState state;  // use flushed_state() to read SH coefficients beyond degree 0 or their Adam moments
  PoseRefiner poses;
  TrainRecorder recorder;
  std::vector<bool> empty_views;  // in which no Gaussian was visible when they were drawn last
  std::size_t n_views_drawn = 0, n_warned_empty = 0;
  bool growth_has_failed = false;  // in this session, although memory had seemed sufficient
  std::int64_t view_bytes = 0;     // of the rasterizer's buffers after the last view
  TrainResult result;

  /// A step whose loss the host has not read yet.
  struct UnreadLoss {
    int iteration = 0;
    std::string view;
    std::int32_t view_index = 0;
  };
  std::optional<UnreadLoss> unread_loss;

  // With several ranks:
  /// What ranks agree on in each step.
  struct Agreed {
    bool stop = false;              // after this step
    bool write_checkpoint = false;  // likewise
    bool check_kernels = false;     // before the next step
  };
  Agreed agreed;
  /// Views of the last step whose losses have not been added to the average, and who draws them.
  std::vector<UnreadLoss> unread_losses;
  std::vector<int> step_drawers;
  /// Those that this rank has drawn. The loss of the last one may still be on the device.
  struct OwnView {
    std::size_t place = 0;  // among them
    std::optional<double> loss;
    torch::Tensor entries;  // queue_row_entries()
  };
  std::vector<OwnView> own_views;
  std::optional<SplatExchange> splats;
  RowOwners owners;         // which rows of the model this rank has
  ViewRatios model_ratios;  // to the Gaussians of all ranks; without pairs
  DrawPlan draw_plan{ranks != nullptr ? ranks->size() : 1};
  bool renders_on_first = false;     // within on_first_rank()
  bool has_failed_together = false;  // the exception that is under way was thrown by all ranks

  /// What a step changes before it changes the Gaussians, for roll_back().
  struct StepStart {
    int iteration = 0, step_iterations = 1, sh_degree = 0;
    std::int64_t adam_steps = 0;
    ViewOrder view_order;
    std::optional<double> loss_average;  // once the loss of the step before has been added
  };
  StepStart step_start;

  /// A view of a step whose splat gradients have been kept.
  struct LearnedView {
    std::int32_t index = 0;
    int iteration = 0;
  };
  std::vector<LearnedView> learned_views;
  /// Statistics as they were before a step of several views, whose views are added one by one.
  struct SavedStatistics {
    bool is_in_use = false;
    std::vector<torch::Tensor> columns, rooms;
  };
  SavedStatistics saved_statistics;
  void make_room_for_statistics();
  void save_statistics();
  bool has_begun = false;     // this session
  bool is_consistent = true;  // false while, or after, a change to the state was interrupted halfway

  std::filesystem::path resumed;             // checkpoint
  std::vector<std::string> changed_options;  // since that checkpoint was written
  nlohmann::ordered_json fingerprint;        // of the scene
  std::int64_t n_warned_of = 0;              // removed Gaussians at the last warning
};

}  // namespace b3dgs
