// A training on several processes (ranks). Each has some rows of the model (rows.h), with their moments and statistics.
// With the same --batch, the result does not depend on the number of ranks: byte for byte under the conditions in
// docs/distributed.md, else up to rounding.
//
//   rank_step.cpp   one step, its views all at once or in parts; who renders them, and their losses
//   rank_model.cpp  the model distributed to the ranks and gathered for files; density control
//   rank_team.cpp   the start, at which ranks compare their scenes, and the renders that rank 0 asks for
//
// Ranks take the same decisions in the same order, from values that all of them know or have exchanged.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "config/batch_steps.h"
#include "config/view_ratios.h"
#include "dist/communicator.h"
#include "multi/render_plan.h"
#include "multi/rows.h"
#include "multi/splat_exchange.h"
#include "raster/args.h"
#include "raster/checks.h"
#include "raster/math/gaussian_grad.h"
#include "train/team.h"

namespace b3dgs {

// Records that ranks exchange on the host.

/// Losses and counted work of the views that a rank has rendered in the last step.
struct RenderedRecord {
  double losses[kMaxBatch]{};
  std::int64_t entries[kMaxBatch]{};
};

/// Each rank sends this after its projections, for a step or for a view that rank 0 asks for.
struct StepRecord {
  std::int64_t invalid_row = -1;       // of the model; not -1: cannot be rendered
  RenderedRecord rendered{};           // of the step before
  std::int64_t n_splats[kMaxBatch]{};  // of each view
  std::int64_t n_second[kMaxBatch]{};  // more that panoramas draw, which are not exchanged
  StepRequests asks{};
  bool is_out_of_memory = false;
};

/// A request of rank 0 to the others in render_on_first().
struct RenderRequest {
  enum Kind : std::int32_t { kDone, kRender, kRemove, kFailed };
  std::int64_t row = 0;  // to remove
  CameraView view{};
  RenderSettings settings{};
  Kind kind = kDone;
  bool can_save = false;  // after a failure: whether the model is undamaged
};

/// The Trainer of these hooks trains together with those of the other ranks, all with the same options and scene.
/// `ranks` must outlive it; with one rank, nothing changes. Ranks that share a GPU get equal parts of what is free
/// there, unless --gpu_memory_gb is given. All ranks call this together. `splats_at_a_time`: see RankTeam.
void use_rank_team(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks,
                   std::int64_t splats_at_a_time = 2000000);

class RankTeam final : public Team {
 public:
  /// All must outlive this. `splats_at_a_time`: about how many splats each rank renders at a time. A step of more views
  /// is taken in parts: splats and sums on their way between ranks take up to 400 bytes for each of these splats.
  /// @throws InputError if the ranks have read different scenes
  RankTeam(Training& training, Communicator& ranks, std::int64_t splats_at_a_time);

  std::int64_t max(const std::string& label, std::int64_t value) override { return ranks_.max(label, value); }
  StepRequests requests() const override { return agreed_; }
  StepOutcome take_step(LastStep& before) override;
  void read_losses(LastStep& last) override;

  void distribute_model() override;
  void render_on_first(const std::function<void(const RenderModelFn&)>& work) override;
  GaussianTensors gather_gaussians() override;
  void write_checkpoint() override;
  std::int64_t remove_invalid_rows(std::int64_t row) override;
  void run_round(int iteration, std::int64_t limit,
                 const std::function<void(const DensityRound&)>& on_planned) override;

 private:
  // rank_step.cpp
  struct Part;  // of a step: the views that the ranks take at a time
  std::size_t n_views_at_a_time() const;
  /// Views that this rank will probably render after this part, by what has been counted so far.
  std::vector<std::int32_t> own_views_ahead();
  /// Takes the next views of a step, up to the gradients of their splats, which each rank keeps for its Gaussians.
  /// `last`: the step's last iteration.
  void take_part(int last, LastStep& before, StepOutcome& outcome);
  /// Calls project(). Errors are left in the record: all ranks learn of them.
  void record_errors(StepRecord& record, const std::function<void()>& project);
  /// @throws InvalidGaussianError or OutOfMemoryError, on all ranks, if that is what a record says
  void check_projections(const std::vector<StepRecord>& records);
  void project_own_gaussians(Part& part, StepRecord& record);
  /// `unread`: views of the part before, or of the step before.
  void exchange_records(Part& part, StepRecord record, LastStep& before, std::vector<StepView>& unread);
  void render_own_views(Part& part);
  /// View `v` of the part. `next`: views that this rank renders after this one.
  void render_view(Part& part, std::size_t v, const ViewSplats& splats, const std::vector<std::int32_t>& next);
  void keep_own_splats(Part& part, const RegularizationWeights& weights);
  /// `splat_grads`: of the own splats of each view.
  void gather_pose_gradients(const Part& part, const std::vector<torch::Tensor>& splat_grads);
  void gather_appearance_gradients(const Part& part);
  /// Rasterizer::row_entries() in host memory, valid when the loss of the view has been read.
  torch::Tensor queue_row_entries() const;
  /// Waits for the loss of the view rendered last, if it has not been read.
  void read_own_loss();
  /// Returns the record of the last step, after read_own_loss().
  RenderedRecord take_rendered();
  /// Adds losses to the average, and work to the plan for later views.
  void add_rendered(const std::vector<RenderedRecord>& of_ranks, LastStep& before, std::vector<StepView>& unread);

  // rank_model.cpp
  /// Each rank plans the same round, from statistics of the whole model.
  DensityRound plan_round(int iteration, std::int64_t limit);
  /// Calls work(), which allocates and exchanges nothing. @throws OutOfMemoryError on all ranks if that fails on one
  void allocate_together(const std::function<void()>& work);
  [[noreturn]] void throw_out_of_memory(std::size_t rank, const std::string& reason);
  /// Why there is no memory for work(); "" if there is.
  static std::string lack_of_memory(const std::function<void()>& work);

  // rank_team.cpp
  void check_same_scene();
  RenderedView render(const CameraView& view, const RenderSettings& settings);
  void serve_renders();
  RenderedView project_and_render(const CameraView& view, const RenderSettings& settings);

  Communicator& ranks_;
  const std::int64_t splats_at_a_time_;
  SplatExchange splats_;
  RowOwners owners_;         // which rows of the model this rank has
  ViewRatios model_ratios_;  // to the Gaussians of all ranks; without pairs
  RenderPlan render_plan_;
  StepRequests agreed_;
  std::vector<int> renderers_;  // of the views whose losses are unread
  RenderedRecord rendered_;     // of the last step by this rank, but for unread_view_
  /// Rendered last: its loss may still be on the device.
  struct UnreadView {
    std::size_t index = 0;  // in the step's views
    torch::Tensor entries;  // queue_row_entries()
  };
  std::optional<UnreadView> unread_view_;
  bool renders_on_first_ = false;  // within render_on_first()
};

}  // namespace b3dgs
