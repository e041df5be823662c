// Every rank projects its Gaussians for the views of a step; the splats of a view go to the rank that renders it, which
// compares it with the photograph and blends backward; the sums of each splat go back to the rank of its Gaussian,
// which takes the Adam step:
//
//   own Gaussians -> splats -> [rank that renders] -> render, loss, backward blend -> sums -> [own rank] -> Adam

#include <algorithm>
#include <limits>
#include <utility>

#include "config/batch_steps.h"
#include "multi/rank_stepper.h"
#include "multi/rows/sharded_rows.h"
#include "raster/math/project_splat.h"
#include "raster/torch/rasterizer.h"
#include "train/optimizer/adam.h"

namespace b3dgs {

/// Views of a step that the ranks take at a time: n_views_at_a_time(), or fewer at the end of a step.
struct RankStepper::Part {
  struct View {
    ViewOfStep id;
    DensityPlan plan;
    CameraView camera;
    RenderSettings settings;
    ViewSplats own;             // of the Gaussians of this rank
    std::int64_t n_splats = 0;  // on all ranks, with second ones of panoramas
    bool refines_pose = false;
  };

  std::vector<View> views;
  std::vector<int> renderers;                     // the rank that renders each view
  std::vector<std::vector<std::int64_t>> counts;  // by rank: its splats of each view

  // Of the views that this rank renders, in their order.
  std::vector<torch::Tensor> splat_grads, scores, shared;

  bool has_scores() const {
    return std::any_of(views.begin(), views.end(), [](const View& view) { return view.plan.score; });
  }
  bool refines_poses() const {
    return std::any_of(views.begin(), views.end(), [](const View& view) { return view.refines_pose; });
  }
};

void RankStepper::take_step() {
  has_failed_together_ = false;
  const int last = step_end(config_.batch, config_.iterations, state_.iteration);
  begin_step(last);
  do {
    const std::vector<ViewOfStep> views = next_views_of_step(last);
    learn_part(views, last);
  } while (state_.iteration < last);
  finish_step(owners_.own());
}

void RankStepper::learn_part(const std::vector<ViewOfStep>& views, int last) {
  Part part;
  std::vector<std::int32_t> indices;
  for (const ViewOfStep& view : views) {
    part.views.emplace_back().id = view;
    indices.push_back(view.index);
  }
  part.renderers = render_plan_.renderers(indices);
  StepRecord record;
  project_own_gaussians(part, record);
  exchange_records(part, record, last);
  renderers_ = part.renderers;
  render_own_views(part);
  unread_losses_ = views;
  keep_own_splats(part);
  if (part.refines_poses()) gather_pose_gradients(part);
  if (n_shared_columns() > 0) keep_shared_gradients(views, part.shared);
  learned_views_.insert(learned_views_.end(), views.begin(), views.end());
}

void RankStepper::project_own_gaussians(Part& part, StepRecord& record) {
  std::vector<CameraView> cameras;
  std::vector<RenderSettings> settings;
  record_errors(record, [&] {
    for (Part::View& view : part.views) {
      view.plan = training_.density->plan(view.id.iteration);
      view.refines_pose = training_.views.poses.refines(view.id.index, view.id.iteration);
      view.camera = training_.views.camera(view.id.index, view.id.iteration);
      view.settings = step_settings(view.id.iteration);
      cameras.push_back(view.camera);
      settings.push_back(view.settings);
    }
    const std::vector<ViewSplats> own = with_remedies(training_.remedies(), [&] {
      std::vector<ViewSplats> projected = optimizer_.project_views(state_.gaussians, state_.adam, cameras, settings);
      splats_.pack(projected, part.renderers, owners_.own());
      return projected;
    });
    for (std::size_t v = 0; v < own.size(); ++v) {
      part.views[v].own = own[v];
      record.n_splats[v] = own[v].size();
      record.n_second[v] = own[v].n_second;
    }
  });
}

void RankStepper::record_errors(StepRecord& record, const std::function<void()>& project) {
  try {
    project();
  } catch (const InvalidGaussianError& error) {
    record.invalid_row = owners_.row_of_model(error.row());
  } catch (const OutOfMemoryError&) {
    record.is_out_of_memory = 1;
  }
}

void RankStepper::check_projections(const std::vector<StepRecord>& records) {
  std::int64_t row = std::numeric_limits<std::int64_t>::max();
  for (const StepRecord& record : records) {
    if (record.invalid_row >= 0) row = std::min(row, record.invalid_row);
  }
  if (row < std::numeric_limits<std::int64_t>::max()) {
    throw InvalidGaussianError(row, detail::concat("Gaussian ", row, kInvalidText));
  }
  for (std::size_t r = 0; r < records.size(); ++r) {
    if (records[r].is_out_of_memory != 0) throw_out_of_memory(r, "a view's projection");
  }
}

void RankStepper::exchange_records(Part& part, StepRecord record, int last) {
  record.stop = training_.is_stopped();
  record.write_checkpoint = training_.recorder.is_checkpoint_due();
  record.check_kernels = training_.kernels.is_due(training_.check_moment(last + 1));
  training_.views.poses.take_queued_steps();  // of the step before: the device has finished it by now
  record.rendered = take_rendered();
  const std::vector<StepRecord> records = ranks_.exchange_record("step", record);
  std::vector<RenderedRecord> rendered_before;
  agreed_ = {};
  for (const StepRecord& other : records) {
    part.counts.emplace_back(other.n_splats, other.n_splats + part.views.size());
    rendered_before.push_back(other.rendered);
    agreed_.stop |= other.stop != 0;
    for (std::size_t v = 0; v < part.views.size(); ++v) {
      part.views[v].n_splats += other.n_splats[v] + other.n_second[v];
    }
  }
  for (const Part::View& view : part.views) {
    model_ratios_.add(view.n_splats, 0, state_.n_gaussians());
    note_visibility(view.id.index, view.n_splats == 0);
  }
  agreed_.write_checkpoint = records[0].write_checkpoint != 0;
  agreed_.check_kernels = records[0].check_kernels != 0;
  add_rendered(rendered_before);
  check_projections(records);
}

void RankStepper::render_own_views(Part& part) {
  const std::vector<ViewSplats> splats = splats_.to_renderers(part.counts);
  std::vector<std::size_t> own;
  std::vector<std::int32_t> own_next;
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    if (part.renderers[v] != ranks_.rank()) continue;
    own.push_back(v);
    own_next.push_back(part.views[v].id.index);
  }
  if (AppearanceModel* const appearance = training_.objective.appearance()) {
    for (const Part::View& view : part.views) {
      appearance->begin_step(view.id.index, view.id.iteration, state_.appearance);
    }
  }
  const std::vector<std::int32_t> ahead = own_views_ahead();
  own_next.insert(own_next.end(), ahead.begin(), ahead.end());
  for (std::size_t i = 0; i < own.size(); ++i) {
    own_next.erase(own_next.begin());
    render_view(part, own[i], splats[i], own_next);
  }
}

void RankStepper::render_view(Part& part, std::size_t v, const ViewSplats& splats,
                              const std::vector<std::int32_t>& own_next) {
  const Part::View& part_view = part.views[v];
  const int iteration = part_view.id.iteration;
  training_.timer.begin(Stage::kUpload);
  const std::size_t n_next = std::min(training_.views.images.n_upcoming_wanted(), own_next.size());
  const TrainView view = training_.views.take(
      part_view.id.index, iteration, {own_next.begin(), own_next.begin() + static_cast<std::ptrdiff_t>(n_next)});
  training_.timer.end();
  AppearanceModel* const appearance = training_.objective.appearance();
  if (appearance != nullptr) appearance->set_place(static_cast<int>(learned_views_.size() + v));
  Rasterizer& rasterizer = training_.rasterizer;
  torch::Tensor entries, splat_grads, shared, scores;
  with_remedies(training_.remedies(), [&] {
    RenderedView rendered;
    try {
      rendered = rasterizer.forward_splats(splats, view.camera, part_view.settings);
    } catch (const NumericError& error) {
      throw NumericError(detail::concat("iteration ", iteration, ", view ", view.name, ": ", error.what()));
    }
    read_own_loss();  // of the view before: the next loss takes its place
    entries = queue_row_entries();
    splat_grads = rasterizer.backward_splats(compare(view, iteration, rendered, part_view.plan.score));
    if (n_shared_columns() > 0) shared = shared_gradients();
    if (part.has_scores()) {
      scores = rasterizer.score_splats(part_view.plan.score ? training_.objective.errors()
                                                            : torch::zeros_like(rendered.alpha));
    }
  });
  note_view_size(iteration);
  own_views_.push_back({v, std::nullopt, entries});
  part.splat_grads.push_back(splat_grads);
  if (shared.defined()) part.shared.push_back(shared);
  if (scores.defined()) part.scores.push_back(scores);
}

void RankStepper::keep_own_splats(Part& part) {
  constexpr std::int64_t kGradFloats = sizeof(SplatGradSum) / sizeof(float);
  constexpr std::int64_t kScores = sizeof(ScoreSums) / sizeof(std::int32_t);
  std::vector<torch::Tensor>& splat_grads = part.splat_grads;
  splat_grads = splats_.to_owners(splat_grads, kGradFloats, torch::kFloat32);
  std::vector<torch::Tensor> scores;
  if (part.has_scores()) scores = splats_.to_owners(part.scores, kScores, torch::kInt32);
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    const Part::View& view = part.views[v];
    const ViewStatistics statistics = with_remedies(training_.remedies(), [&] {
      if (view.plan.statistics) save_statistics();
      return optimizer_.keep_splats(view.own, splat_grads[v], view.camera, view.settings, state_.gaussians,
                                    view.n_splats, regularization());
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
}

void RankStepper::gather_pose_gradients(Part& part) {
  // What each splat adds to the gradient of the camera, added up where the view was rendered.
  std::vector<torch::Tensor> columns;
  for (std::size_t v = 0; v < part.views.size(); ++v) {
    const Part::View& view = part.views[v];
    columns.push_back(camera_parts(state_.gaussians, view.own, part.splat_grads[v], view.camera, view.settings));
  }
  columns = splats_.columns_to_renderers(columns);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    part.shared[i].slice(0, 0, kCameraColumns).copy_(sum_camera_parts(columns[i]).view(torch::kFloat32));
  }
}

std::int64_t RankStepper::n_shared_columns() const {
  std::int64_t n = config_.pose_opt ? kCameraColumns : 0;
  if (AppearanceModel* const appearance = training_.objective.appearance()) n += appearance->grad().numel();
  return n + n % 2;  // rows of doubles
}

torch::Tensor RankStepper::shared_gradients() const {
  torch::Tensor row = torch::zeros({n_shared_columns()}, torch::dtype(torch::kFloat32).device(training_.device));
  const std::int64_t begin = config_.pose_opt ? kCameraColumns : 0;
  if (AppearanceModel* const appearance = training_.objective.appearance()) {
    const torch::Tensor grad = appearance->grad();
    row.slice(0, begin, begin + grad.numel()).copy_(grad.flatten());
  }
  return row;
}

void RankStepper::keep_shared_gradients(const std::vector<ViewOfStep>& views,
                                        const std::vector<torch::Tensor>& rendered) {
  const auto options = torch::dtype(torch::kFloat32).device(training_.device);
  const torch::Tensor own = rendered.empty() ? torch::empty({0, n_shared_columns()}, options) : torch::stack(rendered);
  const torch::Tensor rows = gather_view_rows(ranks_, own, renderers_);
  const std::int64_t begin = config_.pose_opt ? kCameraColumns : 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    const torch::Tensor row = rows.select(0, static_cast<std::int64_t>(v));
    PoseRefiner& poses = training_.views.poses;
    if (poses.refines(views[v].index, views[v].iteration)) {
      poses.add_gradient(views[v].index, views[v].iteration, row.slice(0, 0, kCameraColumns).view(torch::kFloat64));
    }
    if (AppearanceModel* const appearance = training_.objective.appearance()) {
      appearance->set_place(static_cast<int>(learned_views_.size() + v));
      const torch::Tensor grad = appearance->grad();
      grad.copy_(row.slice(0, begin, begin + grad.numel()).view(grad.sizes()));
    }
  }
}

}  // namespace b3dgs
