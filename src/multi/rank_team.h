// A training on several processes (ranks). Each rank has some rows of the model (rows.h), with their moments and
// statistics. With the same --batch, the result does not depend on the number of ranks. It is the same byte for byte
// under the conditions in docs/distributed.md, and otherwise up to rounding.
//
//   rank_step.cpp   one step, whose views are taken together or in parts; who renders them, and their losses
//   rank_model.cpp  distributing the model to the ranks, gathering it for files, density control
//   rank_team.cpp   the start, at which ranks compare their scenes, and renders on request of rank 0
//
// Ranks take the same decisions in the same order, based on values that all of them know or have exchanged.
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

// Data that ranks exchange on the host.

/// Losses and counted work of the views that a rank has rendered in the previous part of a step, by index in that part.
struct RenderedRecord {
  double losses[kMaxBatch]{};
  std::int64_t entries[kMaxBatch]{};
};

/// Each rank sends this after its projections, for a step or for a view that rank 0 requests.
struct StepRecord {
  std::int64_t invalid_row = -1;       // index in the model of a Gaussian that cannot be rendered, or -1
  RenderedRecord rendered{};           // views of the previous part of a step
  std::int64_t n_splats[kMaxBatch]{};  // splats of each view
  std::int64_t n_second[kMaxBatch]{};  // second splats in panoramas, which are not exchanged
  StepRequests asks{};
  bool is_out_of_memory = false;
};

/// A request of rank 0 to the other ranks in render_on_first().
struct RenderRequest {
  enum Kind : std::int32_t { kDone, kRender, kRemove, kFailed };
  std::int64_t row = 0;  // with kRemove: index in the model
  CameraView view{};
  RenderSettings settings{};
  Kind kind = kDone;
  bool can_save = false;  // with kFailed: whether the model is undamaged
};

/// Makes the Trainer of these hooks train together with those of the other ranks, which all have the same options and
/// scene. `ranks` must outlive it. With one rank, nothing changes. Ranks that share a GPU get equal parts of its free
/// memory, unless --gpu_memory_gb is given. All ranks call this together. For `splats_at_a_time` see RankTeam.
void use_rank_team(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks,
                   std::int64_t splats_at_a_time = 2000000);

/// One of several processes that train together.
class RankTeam final : public Team {
 public:
  /// All arguments must outlive this object. `splats_at_a_time` is about how many splats each rank renders at a time. A
  /// step with more views is taken in parts, because splats and sums that are exchanged between ranks take up to 400
  /// bytes for each of these splats.
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
  struct Part;  // the part of a step that the ranks take at a time
  std::size_t n_views_at_a_time() const;
  /// Returns the views that this rank will probably render after this part, according to the work counted so far.
  std::vector<std::int32_t> own_views_ahead();
  /// Takes the next views of a step, up to the gradients of their splats, which each rank keeps for its own Gaussians.
  /// `last` is the last iteration of the step.
  void take_part(int last, LastStep& before, StepOutcome& outcome);
  /// Calls project(), and stores its errors in the record, so that all ranks learn of them.
  void record_errors(StepRecord& record, const std::function<void()>& project);
  /// Checks the records of all ranks. @throws InvalidGaussianError or OutOfMemoryError, on all ranks, if a record
  /// contains one
  void check_projections(const std::vector<StepRecord>& records);
  void project_own_gaussians(Part& part, StepRecord& record);
  /// Exchanges the records. `unread` are the views of the previous part or step.
  void exchange_records(Part& part, StepRecord record, LastStep& before, std::vector<StepView>& unread);
  void render_own_views(Part& part);
  /// Renders view `v` of the part. `next` are the views that this rank renders after it.
  void render_view(Part& part, std::size_t v, const ViewSplats& splats, const std::vector<std::int32_t>& next);
  void keep_own_splats(Part& part, const RegularizationWeights& weights);
  /// `splat_grads` are the gradients of this rank's splats in each view.
  void gather_pose_gradients(const Part& part, const std::vector<torch::Tensor>& splat_grads);
  void gather_appearance_gradients(const Part& part);
  /// Returns Rasterizer::row_entries() in host memory, valid once the loss of the view has been read.
  torch::Tensor queue_row_entries() const;
  /// Waits for the loss of the last rendered view, if it has not been read.
  void read_own_loss();
  /// Returns the losses and work of the views rendered last, after read_own_loss().
  RenderedRecord take_rendered();
  /// Adds losses to the running average, and work to the plan for later views.
  void add_rendered(const std::vector<RenderedRecord>& of_ranks, LastStep& before, std::vector<StepView>& unread);

  // rank_model.cpp
  /// Plans the same round on each rank, from statistics of the whole model.
  DensityRound plan_round(int iteration, std::int64_t limit);
  /// Calls work(), which allocates memory and exchanges nothing. @throws OutOfMemoryError on all ranks if it fails on
  /// one
  void allocate_together(const std::function<void()>& work);
  [[noreturn]] void throw_out_of_memory(std::size_t rank, const std::string& reason);
  /// Calls work(). Returns the reason if it runs out of memory, or "".
  static std::string lack_of_memory(const std::function<void()>& work);

  // rank_team.cpp
  void check_same_scene();
  RenderedView render(const CameraView& view, const RenderSettings& settings);
  void serve_renders();
  RenderedView project_and_render(const CameraView& view, const RenderSettings& settings);

  Communicator& ranks_;
  const std::int64_t splats_at_a_time_;
  SplatExchange splats_;
  RowOwners owners_;         // which rank owns which rows of the model
  ViewRatios model_ratios_;  // relative to the Gaussians of all ranks, without pairs
  RenderPlan render_plan_;
  StepRequests agreed_;
  std::vector<int> renderers_;  // renderers of the views whose losses are unread
  RenderedRecord rendered_;     // views rendered last by this rank, except unread_view_
  /// The last rendered view, whose loss may still be on the device.
  struct UnreadView {
    std::size_t index = 0;  // index in the part's views
    torch::Tensor entries;  // queue_row_entries()
  };
  std::optional<UnreadView> unread_view_;
  bool renders_on_first_ = false;  // within render_on_first()
};

}  // namespace b3dgs
