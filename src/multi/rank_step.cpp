// Every rank projects its Gaussians for the views of a step. The splats of a view go to the rank that renders it, which
// compares it with the photograph and runs the backward blend. The sums of each splat go back to the rank that owns its
// Gaussian, which takes the Adam step:
//
//   own Gaussians -> splats -> [rank that renders] -> render, loss, backward blend -> sums -> [own rank] -> Adam

#include <algorithm>
#include <limits>
#include <numeric>
#include <utility>

#include "config/batch_steps.h"
#include "multi/rank_team.h"
#include "raster/math/project_splat.h"
#include "raster/torch/rasterizer.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

namespace {

/// Gathers one row per view from the rank that renders it. `own` are the rows [n_columns] of the views that this rank
/// renders, in their order. Returns the rows of all views.
torch::Tensor gather_view_rows(Communicator& ranks, const std::vector<torch::Tensor>& own, std::int64_t n_columns,
                               torch::ScalarType type, const std::vector<int>& renderers) {
  const torch::TensorOptions options = torch::dtype(type).device(ranks.device());
  const RowOwners owners(ranks.rank(), ranks.size(), torch::tensor(renderers, torch::kInt16));
  return gather_rows(ranks, own.empty() ? torch::empty({0, n_columns}, options) : torch::stack(own), owners);
}

}  // namespace

/// The views of a step that the ranks take at a time. There are n_views_at_a_time(), or fewer at the end of a step.
struct RankTeam::Part {
  struct View {
    StepView id;
    DensityPlan plan;
    CameraView camera;
    RenderSettings settings;
    ViewSplats own;             // splats of the Gaussians of this rank
    std::int64_t n_splats = 0;  // splats on all ranks, including second ones in panoramas
    bool refines_pose = false;
  };

  std::size_t n_before = 0;  // number of views of the step before this part
  std::vector<View> views;
  std::vector<ViewSize> sizes;                     // sizes of the views that this rank renders
  std::vector<int> renderers;                      // the rank that renders each view
  std::vector<std::vector<std::int64_t>> counts;   // by rank: number of its splats in each view
  std::vector<torch::Tensor> splat_grads, scores;  // for the views that this rank renders, in their order
  bool has_scores = false, refines_poses = false;
};

// --- Views ---

std::size_t RankTeam::n_views_at_a_time() const {
  const double n_splats = model_ratios_.splats() * static_cast<double>(state_.n_gaussians());
  return views_at_a_time(n_splats, splats_at_a_time_, ranks_.size());
}

std::vector<std::int32_t> RankTeam::own_views_ahead() {
  const std::size_t n_wanted = training_.views.images.n_upcoming_wanted();
  const auto n_of_step = static_cast<std::size_t>(std::max(ranks_.size(), config_.batch));
  const std::vector<std::int32_t> upcoming = training_.views.upcoming(state_.view_order, (n_wanted + 1) * n_of_step);
  const auto n_most = static_cast<std::ptrdiff_t>(n_views_at_a_time());
  std::vector<std::int32_t> own;
  int iteration = state_.iteration;
  for (auto view = upcoming.begin(); view != upcoming.end() && iteration < config_.iterations;) {
    const int n_left = step_end(config_.batch, config_.iterations, iteration) - iteration;
    const auto n = std::min({n_most, static_cast<std::ptrdiff_t>(n_left), upcoming.end() - view});
    const std::vector<std::int32_t> part(view, view + n);  // views of the same step
    const std::vector<int> renderers = render_plan_.renderers(part);
    for (std::size_t v = 0; v < part.size(); ++v) {
      if (renderers[v] == ranks_.rank()) own.push_back(part[v]);
    }
    view += n;
    iteration += static_cast<int>(n);
  }
  return own;
}

// --- The step ---

StepOutcome RankTeam::take_step(LastStep& before) {
  can_save_ = false;
  const int last = step_end(config_.batch, config_.iterations, state_.iteration);
  StepOutcome outcome;
  begin_step(training_, last);
  do {
    take_part(last, before, outcome);
  } while (state_.iteration < last);
  finish_step(training_, outcome.views, owners_.own());
  return outcome;
}

void RankTeam::take_part(int last, LastStep& before, StepOutcome& outcome) {
  Part part;
  part.n_before = outcome.views.size();
  std::vector<std::int32_t> indices;
  for (std::size_t n = n_views_at_a_time(); n > 0 && state_.iteration < last; --n) {
    indices.push_back(state_.view_order.next(config_.seed, training_.views.size()));
    part.views.emplace_back().id = {indices.back(), ++state_.iteration};
  }
  part.renderers = render_plan_.renderers(indices);
  StepRecord record;
  record_errors(record, [&] { project_own_gaussians(part, record); });
  exchange_records(part, record, before, outcome.views.empty() ? before.unread_losses : outcome.unread_losses);
  renderers_ = part.renderers;
  render_own_views(part);
  outcome.sizes.insert(outcome.sizes.end(), part.sizes.begin(), part.sizes.end());
  keep_own_splats(part, regularization(training_, before));
  if (training_.objective.appearance()) gather_appearance_gradients(part);
  for (const Part::View& view : part.views) {
    outcome.views.push_back(view.id);
    outcome.unread_losses.push_back(view.id);
  }
}

void RankTeam::project_own_gaussians(Part& part, StepRecord& record) {
  std::vector<CameraView> cameras;
  std::vector<RenderSettings> settings;
  for (Part::View& view : part.views) {
    view.plan = training_.density->plan(view.id.iteration);
    view.refines_pose = training_.views.poses.refines(view.id.index, view.id.iteration);
    view.camera = training_.views.camera(view.id.index, view.id.iteration);
    view.settings = step_settings(training_, view.id.iteration);
    part.has_scores |= view.plan.score;
    part.refines_poses |= view.refines_pose;
    cameras.push_back(view.camera);
    settings.push_back(view.settings);
  }
  const std::vector<ViewSplats> own = with_remedies(training_.remedies(), [&] {
    std::vector<ViewSplats> projected =
        training_.optimizer.project_views(state_.gaussians, state_.adam, cameras, settings);
    splats_.pack(projected, part.renderers, owners_.own());
    return projected;
  });
  for (std::size_t v = 0; v < own.size(); ++v) {
    part.views[v].own = own[v];
    record.n_splats[v] = own[v].size();
    record.n_second[v] = own[v].n_second;
  }
}

void RankTeam::record_errors(StepRecord& record, const std::function<void()>& project) {
  try {
    project();
  } catch (const InvalidGaussianError& error) {
    record.invalid_row = owners_.row_of_model(error.row());
  } catch (const OutOfMemoryError&) {
    record.is_out_of_memory = true;
  }
}

void RankTeam::check_projections(const std::vector<StepRecord>& records) {
  constexpr std::int64_t kNone = std::numeric_limits<std::int64_t>::max();
  std::int64_t row = kNone;
  for (const StepRecord& record : records) {
    if (record.invalid_row >= 0) row = std::min(row, record.invalid_row);
  }
  if (row != kNone) throw InvalidGaussianError(row, detail::concat("Gaussian ", row, kInvalidText));
  for (std::size_t r = 0; r < records.size(); ++r) {
    if (records[r].is_out_of_memory) throw_out_of_memory(r, "a view's projection");
  }
}

void RankTeam::exchange_records(Part& part, StepRecord record, LastStep& before, std::vector<StepView>& unread) {
  record.asks = {training_.is_stopped(), training_.recorder.is_checkpoint_due()};
  training_.views.poses.take_queued_steps();  // of the previous step, which the device has finished by now
  record.rendered = take_rendered();
  const std::vector<StepRecord> records = ranks_.exchange_record("step", record);
  std::vector<RenderedRecord> rendered_before;
  agreed_ = records[0].asks;
  for (const StepRecord& other : records) {
    part.counts.emplace_back(other.n_splats, other.n_splats + part.views.size());
    rendered_before.push_back(other.rendered);
    agreed_.stop |= other.asks.stop;
    for (std::size_t v = 0; v < part.views.size(); ++v) {
      part.views[v].n_splats += other.n_splats[v] + other.n_second[v];
    }
  }
  add_rendered(rendered_before, before, unread);
  check_projections(records);  // first, because the counts of a failed step, which is repeated, are incomplete
  for (Part::View& view : part.views) {
    model_ratios_.add(view.n_splats, 0, state_.n_gaussians());
    view.id.is_empty = view.n_splats == 0;
  }
}

void RankTeam::render_own_views(Part& part) {
  const std::vector<ViewSplats> splats = splats_.to_renderers(part.counts);
  std::vector<std::size_t> own;
  std::vector<std::int32_t> next;  // views that this rank renders
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    if (part.renderers[v] != ranks_.rank()) continue;
    own.push_back(v);
    next.push_back(part.views[v].id.index);
  }
  if (AppearanceModel* const appearance = training_.objective.appearance()) {
    for (const Part::View& view : part.views) {
      appearance->begin_step(view.id.index, view.id.iteration, state_.appearance);
    }
  }
  const std::vector<std::int32_t> ahead = own_views_ahead();
  next.insert(next.end(), ahead.begin(), ahead.end());
  for (std::size_t i = 0; i < own.size(); ++i) {
    next.erase(next.begin());
    render_view(part, own[i], splats[i], next);
  }
}

void RankTeam::render_view(Part& part, std::size_t v, const ViewSplats& splats, const std::vector<std::int32_t>& next) {
  const Part::View& part_view = part.views[v];
  const int iteration = part_view.id.iteration;
  training_.timer.begin(Stage::kUpload);
  const std::size_t n_next = std::min(training_.views.images.n_upcoming_wanted(), next.size());
  const TrainView view = training_.views.take(part_view.id.index, iteration,
                                              {next.begin(), next.begin() + static_cast<std::ptrdiff_t>(n_next)});
  training_.timer.end();
  if (AppearanceModel* const appearance = training_.objective.appearance()) {
    appearance->set_place(static_cast<int>(part.n_before + v));
  }
  decide_kernel(training_, iteration);
  const RenderSettings settings = training_.kernels.begin_view(iteration, part_view.settings);
  Rasterizer& rasterizer = training_.rasterizer;
  torch::Tensor entries, splat_grads, scores;
  with_remedies(training_.remedies(), [&] {
    const RenderedView rendered =
        name_view_in_errors(view, iteration, [&] { return rasterizer.forward_splats(splats, view.camera, settings); });
    read_own_loss();  // of the previous view, before the next loss overwrites it
    entries = queue_row_entries();
    splat_grads = rasterizer.backward_splats(loss_gradient(training_, view, iteration, rendered, part_view.plan.score));
    if (part.has_scores) {
      scores = rasterizer.score_splats(part_view.plan.score ? training_.objective.errors()
                                                            : torch::zeros_like(rendered.alpha));
    }
  });
  trim_after_view(training_);
  part.sizes.push_back(full_size_of_view(training_, iteration));
  unread_view_ = UnreadView{v, entries};
  part.splat_grads.push_back(splat_grads);
  if (scores.defined()) part.scores.push_back(scores);
}

void RankTeam::keep_own_splats(Part& part, const RegularizationWeights& weights) {
  constexpr std::int64_t kGradFloats = sizeof(SplatGradSum) / sizeof(float);
  constexpr std::int64_t kScores = sizeof(ScoreSums) / sizeof(std::int32_t);
  const std::vector<torch::Tensor> grads = splats_.to_owners(part.splat_grads, kGradFloats, torch::kFloat32);
  std::vector<torch::Tensor> scores;
  if (part.has_scores) scores = splats_.to_owners(part.scores, kScores, torch::kInt32);
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    const Part::View& view = part.views[v];
    const ViewStatistics statistics = with_remedies(training_.remedies(), [&] {
      return training_.optimizer.keep_splats(view.own, grads[v], view.camera, view.settings, state_.gaussians,
                                             view.n_splats, weights);
    });
    if (!view.plan.statistics) continue;
    training_.timer.begin(Stage::kDensify);
    DensityView step{view.id.iteration, statistics, view.camera.width, view.camera.height};
    if (view.plan.score) {
      step.add_scores = [&](const GaussianScores& to) { add_splat_scores(view.own, scores[v], to); };
    }
    training_.density->after_view(step, state_.statistics);
    training_.timer.end();
  }
  if (part.refines_poses) gather_pose_gradients(part, grads);
}

// --- Appearance and poses, which are the same on every rank ---

void RankTeam::gather_pose_gradients(const Part& part, const std::vector<torch::Tensor>& splat_grads) {
  // The rank that rendered a view adds up the contributions of its splats.
  std::vector<torch::Tensor> columns;
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    const Part::View& view = part.views[v];
    columns.push_back(camera_parts(state_.gaussians, view.own, splat_grads[v], view.camera, view.settings));
  }
  std::vector<torch::Tensor> own;
  for (const torch::Tensor& parts : splats_.columns_to_renderers(columns)) own.push_back(sum_camera_parts(parts));
  const torch::Tensor rows = gather_view_rows(ranks_, own, kCameraGradients, torch::kFloat64, renderers_);
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    const Part::View& view = part.views[v];
    if (!view.refines_pose) continue;
    training_.views.poses.add_gradient(view.id.index, view.id.iteration, rows.select(0, static_cast<std::int64_t>(v)));
  }
}

void RankTeam::gather_appearance_gradients(const Part& part) {
  AppearanceModel& appearance = *training_.objective.appearance();
  const auto grad_of = [&](std::size_t v) {
    appearance.set_place(static_cast<int>(part.n_before + v));
    return appearance.grad();
  };
  std::vector<torch::Tensor> own;
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    if (renderers_[v] == ranks_.rank()) own.push_back(grad_of(v).flatten());
  }
  const torch::Tensor rows = gather_view_rows(ranks_, own, grad_of(0).numel(), torch::kFloat32, renderers_);
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    const torch::Tensor grad = grad_of(v);
    grad.copy_(rows.select(0, static_cast<std::int64_t>(v)).view(grad.sizes()));
  }
}

// --- Exchange of the losses and counted work of the previous views ---

torch::Tensor RankTeam::queue_row_entries() const {
  const torch::Tensor entries = training_.rasterizer.row_entries();
  if (training_.device.is_cpu()) return entries;
  torch::Tensor on_host = torch::empty(entries.sizes(), torch::dtype(torch::kInt64).pinned_memory(true));
  return on_host.copy_(entries, /*non_blocking=*/true);
}

void RankTeam::read_own_loss() {
  if (!unread_view_) return;
  const auto [v, entries] = *std::exchange(unread_view_, std::nullopt);
  rendered_.losses[v] = training_.objective.value();  // queued after the entries, so these have arrived, too
  const auto* const counts = entries.data_ptr<std::int64_t>();
  rendered_.entries[v] = std::accumulate(counts, counts + entries.size(0), std::int64_t{0});
}

RenderedRecord RankTeam::take_rendered() {
  read_own_loss();
  return std::exchange(rendered_, {});
}

void RankTeam::read_losses(LastStep& last) {
  if (last.unread_losses.empty()) return;
  add_rendered(ranks_.exchange_record("rendered", take_rendered()), last, last.unread_losses);
}

void RankTeam::add_rendered(const std::vector<RenderedRecord>& of_ranks, LastStep& before,
                            std::vector<StepView>& unread) {
  const std::vector<StepView> views = std::exchange(unread, {});
  for (std::size_t v = 0; v < views.size(); ++v) {
    const RenderedRecord& of_renderer = of_ranks[static_cast<std::size_t>(renderers_[v])];
    render_plan_.set_work(views[v].index, of_renderer.entries[v]);
    add_loss(training_, before, views[v], of_renderer.losses[v]);
  }
}

}  // namespace b3dgs
