// A step of several ranks, of all its views at a time or some of them. Every rank projects its Gaussians for these; the
// splats of a view go to the rank that draws it, which compares it with the photograph and blends backward; the sums of
// each splat go back to the rank of its Gaussian, which takes the Adam step.

#include <algorithm>
#include <utility>

#include "config/batch_steps.h"
#include "raster/torch/splat_owner.h"
#include "train/optimizer/lr_schedule.h"
#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::take_distributed_step() {
  const int last = step_end(config.batch, config.iterations, state.iteration);
  bool is_filter_due = begin_step_of_views(last);
  do {
    const int from = state.iteration;
    const std::vector<LearnedView> views = next_views_of_step(last);
    keep_views_of_ranks(from, views, last, std::exchange(is_filter_due, false));
  } while (state.iteration < last);
  learn_from_kept_views();
  timer.finish(state.step_iterations);
}

/// Views of a step that the ranks take at a time: n_views_at_a_time(), or fewer at the end of a step.
struct Trainer::Impl::ViewsOfRanks {
  struct View {
    DensityPlan plan;
    PinholeView camera;
    RenderSettings settings;
    ViewSplats own;             // of the Gaussians of this rank
    std::int64_t n_splats = 0;  // on all ranks
    bool refines_pose = false;
  };

  ViewsOfRanks(const std::vector<LearnedView>& of, std::vector<int> by)
      : learned(of), drawers(std::move(by)), views(of.size()) {}

  const std::vector<LearnedView>& learned;
  std::vector<int> drawers;                       // the rank that draws each view
  std::vector<View> views;                        // as `learned`
  std::vector<std::vector<std::int64_t>> counts;  // by rank: its splats of each view

  // Of the views that this rank draws, in their order.
  std::vector<torch::Tensor> sums, scores, shared, orders;

  bool has_scores() const {
    return std::any_of(views.begin(), views.end(), [](const View& view) { return view.plan.score; });
  }
  bool refines_poses() const {
    return std::any_of(views.begin(), views.end(), [](const View& view) { return view.refines_pose; });
  }
};

void Trainer::Impl::keep_views_of_ranks(int from, const std::vector<LearnedView>& learned, int last,
                                        bool is_filter_due) {
  const int last_of_part = state.iteration;
  draw_plan.forget_before(from);
  ViewsOfRanks step(learned, planned_drawers(from, learned));
  StepRecord record;
  project_own_gaussians(step, is_filter_due, record);
  state.iteration = last_of_part;
  exchange_records(step, record, last);
  if (learned.empty()) return;
  step_drawers = step.drawers;
  draw_own_views(step);
  keep_own_splats(step);
  if (step.refines_poses()) gather_pose_gradients(step);
  if (n_shared_columns() > 0) keep_shared_gradients(learned, step.shared);
  learned_views.insert(learned_views.end(), learned.begin(), learned.end());
  state.iteration = last_of_part;
}

void Trainer::Impl::project_own_gaussians(ViewsOfRanks& step, bool is_filter_due, StepRecord& record) {
  if (step.views.empty()) return;
  std::vector<PinholeView> cameras;
  std::vector<RenderSettings> settings;
  update_filters(is_filter_due);
  try {
    for (std::size_t v = 0; v < step.views.size(); ++v) {
      ViewsOfRanks::View& view = step.views[v];
      const LearnedView& learned = step.learned[v];
      state.iteration = learned.iteration;
      view.plan = density->plan(state.iteration);
      view.refines_pose = poses.refines(learned.index, state.iteration);
      view.camera = camera_of(learned.index, state.iteration);
      view.settings = step_settings();
      cameras.push_back(view.camera);
      settings.push_back(view.settings);
    }
    const std::vector<ViewSplats> own = with_remedies({wait_for_files(), free_scratch(), release_photographs()}, [&] {
      return stepper.project_views(state.gaussians, state.adam, cameras, settings);
    });
    for (std::size_t v = 0; v < own.size(); ++v) {
      step.views[v].own = own[v];
      record.n_splats[v] = own[v].size();
    }
    splats->pack(own, step.drawers, owners.own());
  } catch (const InvalidGaussianError& error) {
    record.first_invalid = owners.row_of_model(error.row());
  } catch (const OutOfMemoryError&) {
    record.is_out_of_memory = 1;
  }
}

void Trainer::Impl::exchange_records(ViewsOfRanks& step, StepRecord record, int last) {
  record.stop = is_stopped();
  record.write_checkpoint = recorder.is_checkpoint_due();
  record.check_kernels = kernels.is_due(check_moment(last + 1));
  poses.finish_step();  // of the step before: the device has finished it by now
  record.drawn = take_drawn();
  const std::vector<StepRecord> records = ranks->exchange_record("step", record);
  std::vector<DrawnRecord> drawn_before;
  agreed = {};
  for (const StepRecord& other : records) {
    step.counts.emplace_back(other.n_splats, other.n_splats + step.views.size());
    drawn_before.push_back(other.drawn);
    agreed.stop |= other.stop != 0;
    for (std::size_t v = 0; v < step.views.size(); ++v) step.views[v].n_splats += other.n_splats[v];
  }
  for (std::size_t v = 0; v < step.views.size(); ++v) {
    model_ratios.add(step.views[v].n_splats, 0, state.n_gaussians());
    note_visibility(step.learned[v].index, step.views[v].n_splats == 0);
  }
  agreed.write_checkpoint = records[0].write_checkpoint != 0;
  agreed.check_kernels = records[0].check_kernels != 0;
  add_drawn(drawn_before);
  if (!step_start.loss_average) step_start.loss_average = state.loss_average;
  check_valid(records);
  for (std::size_t r = 0; r < records.size(); ++r) {
    if (records[r].is_out_of_memory != 0) throw_out_of_memory(static_cast<int>(r), "a view's projection");
  }
}

void Trainer::Impl::draw_own_views(ViewsOfRanks& step) {
  const std::vector<ViewSplats> drawn = splats->to_drawers(step.counts);
  std::vector<std::size_t> own;
  std::vector<std::int32_t> own_next;
  for (std::size_t v = 0; v < step.views.size(); ++v) {
    if (step.drawers[v] != ranks->rank()) continue;
    own.push_back(v);
    own_next.push_back(step.learned[v].index);
  }
  if (appearance) {
    for (const LearnedView& view : step.learned) appearance->begin_step(view.index, view.iteration, state.appearance);
  }
  const std::vector<std::int32_t> ahead = own_views_ahead();
  own_next.insert(own_next.end(), ahead.begin(), ahead.end());
  for (std::size_t i = 0; i < own.size(); ++i) {
    own_next.erase(own_next.begin());
    draw_view(step, own[i], drawn[i], own_next);
  }
  for (const LearnedView& view : step.learned) {
    unread_losses.push_back({view.iteration, scene.train[static_cast<std::size_t>(view.index)].name, view.index});
  }
}

void Trainer::Impl::draw_view(ViewsOfRanks& step, std::size_t v, const ViewSplats& drawn,
                              const std::vector<std::int32_t>& own_next) {
  state.iteration = step.learned[v].iteration;
  timer.begin(Stage::kUpload);
  const auto n_next = static_cast<std::ptrdiff_t>(std::min(images.n_upcoming_wanted(), own_next.size()));
  const TrainView view =
      take_own_view(state.iteration, step.learned[v].index, {own_next.begin(), own_next.begin() + n_next});
  timer.end();
  ComparedView compared;
  compared.plan = step.views[v].plan;
  try {
    compared.rendered = with_remedies({wait_for_files(), free_scratch(), release_photographs()}, [&] {
      return rasterizer.forward_splats(drawn, view.camera, step.views[v].settings);
    });
  } catch (const NumericError& error) {
    throw NumericError(detail::concat("iteration ", state.iteration, ", view ", view.name, ": ", error.what()));
  }
  note_view_size();
  read_own_loss();  // of the view before: the next loss takes its place
  own_views.push_back({v, std::nullopt, queue_row_entries()});
  if (appearance) appearance->set_place(static_cast<int>(learned_views.size() + v));
  compare_with_photograph(view, compared);
  step.sums.push_back(rasterizer.backward_splats(compared.grad));
  if (step.refines_poses()) step.orders.push_back(rasterizer.order_of_splats());
  if (n_shared_columns() > 0) step.shared.push_back(shared_gradients());
  if (step.has_scores()) {
    step.scores.push_back(rasterizer.score_splats(compared.plan.score ? error_image.error()
                                                                      : torch::zeros_like(compared.rendered.alpha)));
  }
}

void Trainer::Impl::keep_own_splats(ViewsOfRanks& step) {
  constexpr std::int64_t kSums = sizeof(SplatGradSum) / sizeof(float);
  constexpr std::int64_t kScores = sizeof(ScoreSums) / sizeof(std::int32_t);
  std::vector<torch::Tensor>& sums = step.sums;
  sums = splats->to_owners(sums, kSums, torch::kFloat32);
  std::vector<torch::Tensor> scores;
  if (step.has_scores()) scores = splats->to_owners(step.scores, kScores, torch::kInt32);
  for (std::size_t v = 0; v < step.views.size(); ++v) {
    const ViewsOfRanks::View& view = step.views[v];
    state.iteration = step.learned[v].iteration;
    const ViewStatistics statistics =
        stepper.keep_splats(view.own, sums[v], view.camera, view.settings, state.gaussians, view.n_splats,
                            regularization_weights(config, scene.extent));
    if (!view.plan.statistics) continue;
    timer.begin(Stage::kDensify);
    make_room_for_statistics();
    save_statistics();
    DensityStep density_step{state.iteration, statistics, view.camera.width, view.camera.height};
    if (view.plan.score) {
      density_step.add_scores = [&](const GaussianScores& to) { add_splat_scores(view.own, scores[v], to); };
    }
    density->after_view(density_step, state.statistics);
    timer.end();
  }
}

void Trainer::Impl::gather_pose_gradients(ViewsOfRanks& step) {
  // What each splat adds to the gradient of the camera, added up where the view was drawn, in its order.
  std::vector<torch::Tensor> parts;
  for (std::size_t v = 0; v < step.views.size(); ++v) {
    const ViewsOfRanks::View& view = step.views[v];
    parts.push_back(camera_parts(state.gaussians, view.own, step.sums[v], view.camera, view.settings));
  }
  parts = splats->columns_to_drawers(parts, kCameraGradients, torch::kFloat32);
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const torch::Tensor ordered = torch::empty_like(parts[i]).index_copy_(0, step.orders[i], parts[i]);
    step.shared[i].slice(0, 0, kCameraColumns).copy_(sum_camera_parts(ordered).view(torch::kFloat32));
  }
}

}  // namespace b3dgs
