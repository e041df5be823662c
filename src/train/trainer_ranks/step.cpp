// A step of several ranks. Every rank projects its Gaussians for all views of the step; the splats of a view go to the
// rank that draws it, which compares it with the photograph and blends backward; the sums of each splat go back to the
// rank of its Gaussian, which takes the Adam step. With more ranks than views, a view is drawn in bands of tile rows;
// the ranks of a view exchange their rows of the image, and each compares the whole image.

#include <algorithm>

#include "config/batch_steps.h"
#include "raster/torch/splat_owner.h"
#include "train/optimizer/lr_schedule.h"
#include "train/trainer_impl.h"

namespace b3dgs {

void Trainer::Impl::take_distributed_step() {
  const int last = step_end(config.batch, config.iterations, state.iteration);
  bool is_filter_due = begin_step_of_views(last);
  if (times_phases(state.iteration, last)) step_phases.start();
  do {
    step_phases.begin(StepPhase::kProject);
    const int from = state.iteration;
    const std::vector<LearnedView> views = next_views_of_step(last);
    keep_views_of_ranks(from, views, last, std::exchange(is_filter_due, false));
  } while (state.iteration < last);
  if (learned_views.empty()) {
    step_phases.cancel();
    return timer.cancel();
  }
  learn_from_kept_views();
  timer.finish(state.step_iterations);
  step_phases.finish();
}

void Trainer::Impl::keep_views_of_ranks(int from, const std::vector<LearnedView>& learned, int last,
                                        bool is_filter_due) {
  const std::size_t n_views = learned.size();
  draw_plan.forget_before(from);
  const StepPlan plan = planned_step(from, learned);

  // Every view's projection.
  struct View {
    DensityPlan plan;
    PinholeView camera;
    RenderSettings settings;
    ViewSplats own;
    std::int64_t n_splats = 0;  // on all ranks
    bool refines_pose = false;
  };
  const int last_of_part = state.iteration;
  std::vector<View> views(n_views);
  std::vector<PinholeView> cameras;
  std::vector<RenderSettings> settings;
  std::vector<ViewSplats> own;
  std::vector<std::int64_t> n_splats(plan.size());  // for each part
  StepRecord record;
  if (n_views > 0) update_filters(is_filter_due);
  try {
    for (std::size_t v = 0; v < n_views; ++v) {
      View& view = views[v];
      state.iteration = learned[v].iteration;
      view.plan = density->plan(state.iteration);
      view.refines_pose = poses.refines(learned[v].index, state.iteration);
      view.camera = camera_of(learned[v].index, state.iteration);
      view.settings = step_settings();
      view.settings.absolute_gradient = view.plan.absolute_gradients;
      cameras.push_back(view.camera);
      settings.push_back(view.settings);
    }
    own = with_remedies({wait_for_files(), free_scratch(), release_photographs()},
                        [&] { return stepper.project_views(state.gaussians, state.adam, cameras, settings); });
    for (std::size_t v = 0; v < n_views; ++v) {
      views[v].own = own[v];
      record.n_seen[v] = own[v].size();
    }
    if (n_views > 0) n_splats = splats->begin(plan, own, views[0].settings.tile.height);
  } catch (const InvalidGaussianError& error) {
    record.first_invalid = shards().global_row(error.row());
  } catch (const OutOfMemoryError&) {
    record.is_out_of_memory = 1;
  }
  state.iteration = last_of_part;
  record.stop = is_stopped();
  record.write_checkpoint = recorder.is_checkpoint_due();
  record.check_kernels = kernels.is_due(check_moment(last + 1));
  poses.finish_step();  // of the step before: the device has finished it by now
  const DrawnParts drawn_here = take_drawn();
  record.drawn = drawn_here.record;
  std::vector<std::int64_t> numbers = n_splats;
  numbers.insert(numbers.end(), drawn_here.rows.begin(), drawn_here.rows.end());
  std::vector<StepRecord> records;
  std::vector<std::vector<std::int64_t>> counts;
  std::vector<DrawnParts> drawn_before;
  agreed = {};
  for (const auto& [other, numbers_of_other] :
       step_phases.time(StepPhase::kRecord, [&] { return exchange_with_numbers(*ranks, "step", record, numbers); })) {
    records.push_back(other);
    B3DGS_CHECK(numbers_of_other.size() >= plan.size(), "numbers of splats of ", plan.size(), " parts of a step");
    const auto rows = numbers_of_other.begin() + static_cast<std::ptrdiff_t>(plan.size());
    counts.emplace_back(numbers_of_other.begin(), rows);
    drawn_before.push_back({other.drawn, {rows, numbers_of_other.end()}});
    agreed.stop |= other.stop != 0;
    for (std::size_t v = 0; v < n_views; ++v) views[v].n_splats += other.n_seen[v];
  }
  agreed.write_checkpoint = records[0].write_checkpoint != 0;
  agreed.check_kernels = records[0].check_kernels != 0;
  add_drawn(drawn_before);
  if (!step_start.loss_average) step_start.loss_average = state.loss_average;
  check_valid(records);
  for (std::size_t r = 0; r < records.size(); ++r) {
    if (records[r].is_out_of_memory != 0) throw_out_of_memory(static_cast<int>(r), "a view's projection");
  }
  if (n_views == 0) return;
  step_plan = plan;
  tile_height = views[0].settings.tile.height;

  // The views, or bands of them, that this rank draws.
  const std::vector<ViewSplats> drawn =
      step_phases.time(StepPhase::kSplats, [&] { return splats->to_drawers(counts); });
  step_phases.begin(StepPhase::kDraw);
  const bool has_scores = std::any_of(views.begin(), views.end(), [](const View& view) { return view.plan.score; });
  const bool refines_poses =
      std::any_of(views.begin(), views.end(), [](const View& view) { return view.refines_pose; });
  std::vector<std::int32_t> own_next;
  for (const DrawnPart& part : plan) {
    if (part.rank == ranks->rank()) own_next.push_back(learned[part.view].index);
  }
  for (std::size_t v = 0; v < n_views; ++v) {
    if (appearance) appearance->begin_step(learned[v].index, learned[v].iteration, state.appearance);
  }
  const std::vector<std::int32_t> ahead = own_views_ahead();
  own_next.insert(own_next.end(), ahead.begin(), ahead.end());
  const bool is_exact = splats->is_banded() && (device.is_cpu() || (config.deterministic && !depth_priors));
  const std::int64_t n_image_columns = depth_priors ? 4 : 3;
  std::vector<torch::Tensor> drawn_sums, drawn_scores, drawn_shared, drawn_orders;
  std::vector<SplatPairs> drawn_pairs;
  for (const DrawnPart& part : plan) {
    const std::size_t v = part.view;
    const View& own_view = views[v];
    if (part.rank == ranks->rank()) {
      const std::size_t place = drawn_sums.size();
      state.iteration = learned[v].iteration;
      timer.begin(Stage::kUpload);
      const auto begin = own_next.begin() + static_cast<std::ptrdiff_t>(place) + 1;
      const auto n_ahead = static_cast<std::ptrdiff_t>(images.n_upcoming_wanted());
      const std::ptrdiff_t n_next = std::min(n_ahead, own_next.end() - begin);
      const TrainView view = take_own_view(state.iteration, learned[v].index, {begin, begin + n_next});
      timer.end();
      ComparedView compared;
      compared.plan = own_view.plan;
      try {
        RenderSettings settings = own_view.settings;
        settings.drawn_rows = part.rows;
        compared.rendered = with_remedies({wait_for_files(), free_scratch(), release_photographs()}, [&] {
          return rasterizer.forward_splats(drawn[place], view.camera, settings);
        });
      } catch (const NumericError& error) {
        throw NumericError(detail::concat("iteration ", state.iteration, ", view ", view.name, ": ", error.what()));
      }
      note_view_size();
      read_own_loss();  // of the view before: the next loss takes its place
      own_parts.push_back({part, std::nullopt, queue_row_entries()});
      std::vector<torch::Tensor> images{compared.rendered.color};
      if (depth_priors) images.push_back(compared.rendered.depth);
      step_phases.time(StepPhase::kRows, [&] { return splats->share_rows(images, n_image_columns); });
      if (appearance) appearance->set_place(static_cast<int>(learned_views.size() + v));
      compare_with_photograph(view, compared);
      drawn_sums.push_back(rasterizer.backward_splats(compared.grad));
      if (is_exact) drawn_pairs.push_back(rasterizer.backward_pairs(splats->crossing(place)));
      if (refines_poses) drawn_orders.push_back(rasterizer.order_of_splats());
      if (n_shared_columns() > 0) drawn_shared.push_back(shared_gradients());
      if (has_scores) {
        drawn_scores.push_back(rasterizer.score_splats(
            compared.plan.score ? error_image.error() : torch::zeros_like(compared.rendered.alpha)));
      }
    }
  }
  if (drawn_sums.empty()) step_phases.time(StepPhase::kRows, [&] { return splats->share_rows({}, n_image_columns); });
  for (const LearnedView& view : learned) {
    unread_losses.push_back({view.iteration, scene.train[static_cast<std::size_t>(view.index)].name, view.index});
  }

  // The Gaussians of this rank.
  const std::vector<torch::Tensor> sums =
      step_phases.time(StepPhase::kSums, [&] { return splats->sums_to_owners(drawn_sums, drawn_pairs, is_exact); });
  std::vector<torch::Tensor> scores;
  if (has_scores) {
    scores = step_phases.time(StepPhase::kSums, [&] { return splats->scores_to_owners(drawn_scores); });
  }
  step_phases.begin(StepPhase::kLearn);
  for (std::size_t v = 0; v < n_views; ++v) {
    const View& view = views[v];
    state.iteration = learned[v].iteration;
    const ViewStatistics statistics =
        stepper.keep_splats(view.own, sums[v], view.camera, view.settings, state.gaussians, view.n_splats,
                            regularization_weights(config, state.iteration));
    if (view.plan.statistics) {
      timer.begin(Stage::kDensify);
      make_room_for_statistics();
      save_statistics();
      DensityStep step{state.iteration, statistics, view.camera.width, view.camera.height};
      if (view.plan.score) {
        step.add_scores = [&](const GaussianScores& to) { add_splat_scores(view.own, scores[v], to); };
      }
      density->after_view(step, state.statistics);
      timer.end();
    }
  }
  if (refines_poses) {
    // What each splat adds to the gradient of the camera, added up where the view was drawn, in its order.
    std::vector<torch::Tensor> parts;
    for (std::size_t v = 0; v < n_views; ++v) {
      parts.push_back(camera_parts(state.gaussians, views[v].own, sums[v], views[v].camera, views[v].settings));
    }
    parts = splats->columns_to_drawers(parts, kCameraGradients, torch::kFloat32);
    for (std::size_t i = 0; i < parts.size(); ++i) {
      torch::Tensor ordered = torch::empty_like(parts[i]).index_copy_(0, drawn_orders[i], parts[i]);
      drawn_shared[i].slice(0, 0, kCameraColumns).copy_(sum_camera_parts(ordered).view(torch::kFloat32));
    }
  }
  if (n_shared_columns() > 0) keep_shared_gradients(learned, drawn_shared);
  learned_views.insert(learned_views.end(), learned.begin(), learned.end());
  state.iteration = last_of_part;
}

}  // namespace b3dgs
