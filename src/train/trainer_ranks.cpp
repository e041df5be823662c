// Training on several ranks (processes, src/dist). Each has some rows of the model (core/row_shards.h), with their
// moments and statistics. In a step every rank projects its Gaussians for all views of the step; the splats of a view
// go to the rank that draws it (DrawPlan), compares it with the photograph and blends backward; the sums of each splat
// go back to the rank of its Gaussian, which takes the Adam step. What is learned does not depend on the number of
// ranks.
//
// Ranks take the same decisions in the same order: from what all of them know, or from what StepRecord tells them.
// Rank 0 writes the files. To evaluate or to time kernels, it renders views of the whole model; the other ranks then
// project their Gaussians on its request.

#include <algorithm>
#include <cmath>

#include "config/batch_steps.h"
#include "config/coarse_schedule.h"
#include "raster/math/project_splat.h"
#include "raster/torch/splat_owner.h"
#include "train/density/invalid_gaussians.h"
#include "train/optimizer/lr_schedule.h"
#include "train/ranks/sharded_row_edit.h"
#include "train/trainer_impl.h"

namespace b3dgs {
namespace {

/// What each rank tells the others in a step, after its projections.
struct StepRecord {
  std::int64_t n_splats[kMaxBatch]{};  // of each view
  std::int64_t first_invalid = -1;     // row of the model that cannot be rendered
  DrawnRecord drawn{};                 // of the step before
  std::int32_t stop = 0;
  std::int32_t write_checkpoint = 0, check_kernels = 0;  // rank 0's count
};

/// What rank 0 asks of the others in on_first_rank().
struct RenderRequest {
  enum Kind : std::int32_t { kDone, kRender, kRemove };
  std::int64_t row = 0;  // to remove
  PinholeView view{};
  RenderSettings settings{};
  Kind kind = kDone;
};

constexpr std::int64_t kSplatSums = 12, kSplatScores = 6;  // columns of backward_splats() and score_splats()

constexpr std::size_t kPlannedSteps = 4;  // whose views are assigned to ranks at a time

// Exchanges are timed in the first kMeasured iterations of a session after kWarmUp, and then in some steps.
constexpr int kWarmUp = 20, kMeasured = 40, kTimedInterval = 10;

struct ProjectRecord {
  std::int64_t n_splats = 0, first_invalid = -1;
};

/// All tensors with a row per Gaussian.
template <class Visit>
void visit_rows(TrainState& state, Visit&& visit) {
  for (GaussianTensors* group : {&state.gaussians, &state.adam.m, &state.adam.v}) {
    for (torch::Tensor* tensor : group->all()) visit(*tensor);
  }
  visit(state.gaussians.filters);
  for (torch::Tensor* column : state.statistics.all()) visit(*column);
}

/// @throws InvalidGaussianError, on all ranks, if one of them has found an invalid Gaussian
template <class Record>
void check_valid(const std::vector<Record>& records) {
  std::int64_t first = -1;
  for (const Record& record : records) {
    if (record.first_invalid >= 0 && (first < 0 || record.first_invalid < first)) first = record.first_invalid;
  }
  if (first >= 0) throw InvalidGaussianError(first, detail::concat("Gaussian ", first, kInvalidText));
}

}  // namespace

void Trainer::Impl::check_options_of_ranks() const {
  const std::pair<bool, const char*> unsupported[]{
      {config.pose_opt, "--pose_opt"},
      {config.exposure, "--exposure"},
      {config.bilateral_grid, "--bilateral_grid"},
      {learned_background_degree(config) >= 0, "--background learned or sky"},
      {config.skip_share > 0, "--skip_share"},
  };
  for (const auto& [is_set, option] : unsupported) {
    if (is_set) input_error(option, ": not supported with several ranks (--ranks, --gpus); leave out one of them");
  }
}

void Trainer::Impl::keep_own_rows() {
  state.n_of_all_ranks = state.gaussians.size();
  visit_rows(state, [&](torch::Tensor& tensor) {
    if (tensor.defined()) tensor = own_rows(tensor, shards()).to(device);
  });
}

TrainState Trainer::Impl::gathered_state() {
  TrainState whole = flushed_state();
  visit_rows(whole, [&](torch::Tensor& tensor) {
    if (tensor.defined()) tensor = gather_rows_on_first(*ranks, tensor, state.n_gaussians());
  });
  whole.n_of_all_ranks.reset();
  return whole;
}

PinholeView Trainer::Impl::camera_of(std::int32_t index, int iteration) {
  const PinholeView camera = poses.camera(index);
  const int scale = coarse_scale_of(coarse_scale_at(config, iteration), camera.width, camera.height);
  return scale == 1 ? camera : reduced_camera(camera, scale);
}

TrainView Trainer::Impl::take_own_view(int iteration, std::int32_t index, const std::vector<std::int32_t>& next) {
  TrainView view = images.take(index, next);
  view.camera = poses.camera(index);
  const int scale = coarse_scale_of(coarse_scale_at(config, iteration), view.camera.width, view.camera.height);
  return reducer.reduce(view, scene.train[static_cast<std::size_t>(index)].valid.get(), scale);
}

void Trainer::Impl::take_distributed_step() {
  const int from = state.iteration, last = step_end(config.batch, config.iterations, from);
  const auto n_views = static_cast<std::size_t>(last - from), size = static_cast<std::size_t>(ranks->size());
  const bool is_filter_due = begin_step_of_views(last);
  const std::size_t n_ahead = images.n_upcoming_wanted();
  const std::size_t n_upcoming = n_views + (n_ahead + 1) * std::max(size, static_cast<std::size_t>(config.batch));
  const std::vector<std::int32_t> next = state.view_order.upcoming(
      config.seed, images.size(), std::max(n_upcoming, kPlannedSteps * static_cast<std::size_t>(config.batch)));
  const std::vector<int> drawers_of_next = plan_drawing(next);
  const std::vector<int> step_drawers(drawers_of_next.begin(), drawers_of_next.begin() + (last - from));
  std::vector<std::int32_t> own_next;  // the views that this rank draws, in this step and later
  for (std::size_t i = 0; i < next.size(); ++i) {
    if (drawers_of_next[i] == ranks->rank()) own_next.push_back(next[i]);
  }
  if (times_exchanges(from, last)) exchange_timer.start();

  // Every view's projection.
  struct View {
    int iteration;
    DensityPlan plan;
    PinholeView camera;
    RenderSettings settings;
    ViewSplats own;
    std::int64_t n_splats = 0;  // on all ranks
  };
  std::vector<View> views(n_views);
  StepRecord record;
  try {
    for (std::size_t v = 0; v < n_views; ++v) {
      View& view = views[v];
      view.iteration = state.iteration = from + 1 + static_cast<int>(v);
      state.view_order.next(config.seed, images.size());
      view.plan = density->plan(view.iteration);
      view.camera = camera_of(next[v], view.iteration);
      view.settings = step_settings();
      view.settings.absolute_gradient = view.plan.absolute_gradients;
      view.own = with_remedies({wait_for_files(), free_scratch(), release_photographs()}, [&] {
        update_filters(is_filter_due && v == 0);
        return stepper.project(state.gaussians, state.adam, view.camera, view.settings);
      });
      record.n_splats[v] = view.own.size();
    }
  } catch (const InvalidGaussianError& error) {
    record.first_invalid = shards().global_row(error.row());
  }
  record.stop = is_stopped();
  record.write_checkpoint = recorder.is_checkpoint_due();
  record.check_kernels = kernels.is_due(check_moment(last + 1));
  record.drawn = take_drawn();
  const std::vector<StepRecord> records = exchange_timer.time([&] { return ranks->exchange_record("step", record); });
  agreed = {false, records[0].write_checkpoint != 0, records[0].check_kernels != 0};
  std::vector<std::vector<std::int64_t>> counts;
  std::vector<DrawnRecord> drawn_before;
  for (const StepRecord& other : records) {
    agreed.stop |= other.stop != 0;
    counts.emplace_back(other.n_splats, other.n_splats + n_views);
    drawn_before.push_back(other.drawn);
    for (std::size_t v = 0; v < n_views; ++v) views[v].n_splats += other.n_splats[v];
  }
  add_drawn(drawn_before);
  step_start.loss_average = state.loss_average;
  check_valid(records);
  drawers = step_drawers;

  // The views that this rank draws.
  std::vector<ViewSplats> own;
  for (View& view : views) own.push_back(view.own);
  const std::vector<ViewSplats> drawn = exchange_timer.time([&] { return splats->to_drawers(own, counts, drawers); });
  const bool has_scores = std::any_of(views.begin(), views.end(), [](const View& view) { return view.plan.score; });
  std::vector<torch::Tensor> drawn_sums, drawn_scores;
  std::size_t place = 0;
  for (std::size_t v = 0; v < n_views; ++v) {
    const View& own_view = views[v];
    if (drawers[v] == ranks->rank()) {
      state.iteration = own_view.iteration;
      timer.begin(Stage::kUpload);
      const auto begin = own_next.begin() + static_cast<std::ptrdiff_t>(place) + 1;
      const std::ptrdiff_t n_next = std::min(static_cast<std::ptrdiff_t>(n_ahead), own_next.end() - begin);
      const TrainView view = take_own_view(state.iteration, next[v], {begin, begin + n_next});
      timer.end();
      ComparedView compared;
      compared.plan = own_view.plan;
      try {
        compared.rendered = with_remedies({wait_for_files(), free_scratch(), release_photographs()}, [&] {
          return rasterizer.forward_splats(drawn[place], view.camera, own_view.settings);
        });
      } catch (const NumericError& error) {
        throw NumericError(detail::concat("iteration ", state.iteration, ", view ", view.name, ": ", error.what()));
      }
      note_view_size();
      read_own_loss();  // of the view before: the next loss takes its place
      own_views.push_back({v, std::nullopt, rasterizer.row_entries()});
      compare_with_photograph(view, compared);
      drawn_sums.push_back(rasterizer.backward_splats(compared.grad).clone());
      if (has_scores) {
        torch::Tensor scores = rasterizer.score_splats(
            compared.plan.score ? error_image.error() : torch::zeros_like(compared.rendered.alpha));
        drawn_scores.push_back(scores.clone());
      }
      ++place;
    }
    unread_losses.push_back({own_view.iteration, scene.train[static_cast<std::size_t>(next[v])].name, next[v]});
  }

  // The Gaussians of this rank.
  const std::vector<torch::Tensor> sums =
      exchange_timer.time([&] { return splats->to_owners(drawn_sums, kSplatSums, torch::kFloat32); });
  std::vector<torch::Tensor> scores;
  if (has_scores) {
    scores = exchange_timer.time([&] { return splats->to_owners(drawn_scores, kSplatScores, torch::kInt32); });
  }
  for (std::size_t v = 0; v < n_views; ++v) {
    const View& view = views[v];
    state.iteration = view.iteration;
    const ViewStatistics statistics =
        stepper.keep_splats(view.own, sums[v], view.camera, view.settings, state.gaussians, view.n_splats,
                            regularization_weights(config, view.iteration));
    if (view.plan.statistics) {
      timer.begin(Stage::kDensify);
      make_room_for_statistics();
      save_statistics();
      DensityStep step{view.iteration, statistics, view.camera.width, view.camera.height};
      if (view.plan.score) {
        step.add_scores = [&](const GaussianScores& to) { add_splat_scores(view.own, scores[v], to); };
      }
      density->after_view(step, state.statistics);
      timer.end();
    }
    learned_views.push_back({next[v], view.iteration});
  }
  learn_from_kept_views();
  timer.finish(state.step_iterations);
  exchange_timer.finish();
}

std::vector<int> Trainer::Impl::plan_drawing(const std::vector<std::int32_t>& next) {
  draw_plan.forget_before(state.iteration);
  std::vector<int> all;
  int from = state.iteration;
  for (std::size_t n_steps = 0; all.size() < next.size(); ++n_steps) {
    const int last = step_end(config.batch, config.iterations, from);
    const auto begin = next.begin() + static_cast<std::ptrdiff_t>(all.size());
    const std::vector<std::int32_t> views(begin, begin + std::min<std::ptrdiff_t>(last - from, next.end() - begin));
    // Beyond that, a guess: how many views are read ahead differs between ranks, but plans must not.
    const std::vector<int> step =
        n_steps < kPlannedSteps ? draw_plan.drawers(from, views) : equal_drawers(views.size(), ranks->size());
    all.insert(all.end(), step.begin(), step.end());
    from = last;
  }
  return all;
}

bool Trainer::Impl::times_exchanges(int from, int last) const {
  const int n_done = from - result.first_iteration;  // in this session
  return n_done >= kWarmUp && (n_done < kWarmUp + kMeasured || from / kTimedInterval != last / kTimedInterval);
}

void Trainer::Impl::advise_on_ranks() {
  if (!is_distributed()) return;
  const int n_steps = kMeasured / std::max(1, config.batch);
  const auto advice = rank_load.advise(std::max(1, n_steps * 3 / 4), device.is_cuda() ? "GPU" : "process");
  if (advice && writes_files()) recorder.say(*advice);
}

void Trainer::Impl::read_own_loss() {
  if (!own_views.empty() && !own_views.back().loss) own_views.back().loss = loss.value().loss;
}

DrawnRecord Trainer::Impl::take_drawn() {
  read_own_loss();
  DrawnRecord record;
  for (const OwnView& view : std::exchange(own_views, {})) {
    record.losses[view.place] = *view.loss;
    record.entries[view.place] = view.entries.sum().item<std::int64_t>();
  }
  for (const ExchangeTimer::Times& step : exchange_timer.take()) {
    ++own_totals.n_timed;
    own_totals.exchange_ms += step.exchange_ms;
    own_totals.step_ms += step.step_ms;
  }
  own_totals.sent_bytes = splats->sent_bytes();
  own_totals.received_bytes = splats->received_bytes();
  record.totals = own_totals;
  return record;
}

void Trainer::Impl::read_losses_of_ranks() {
  if (!unread_losses.empty()) add_drawn(ranks->exchange_record("drawn", take_drawn()));
}

void Trainer::Impl::add_drawn(const std::vector<DrawnRecord>& of_ranks) {
  const std::vector<UnreadLoss> unread = std::exchange(unread_losses, {});
  if (unread.empty()) return;
  std::vector<std::int64_t> entries;
  for (std::size_t v = 0; v < unread.size(); ++v) {
    entries.push_back(of_ranks[static_cast<std::size_t>(drawers[v])].entries[v]);
    draw_plan.set_work(unread[v].view_index, entries.back());
  }
  const int size = ranks->size();
  rank_load.add_step(work_of_ranks(drawers, entries, size),
                     work_of_ranks(equal_drawers(unread.size(), size), entries, size));
  std::vector<RankTotals> totals;
  for (const DrawnRecord& record : of_ranks) totals.push_back(record.totals);
  rank_load.set_totals(totals);
  for (std::size_t v = 0; v < unread.size(); ++v) {
    const double value = of_ranks[static_cast<std::size_t>(drawers[v])].losses[v];
    if (!std::isfinite(value)) {
      throw LossError(detail::concat("iteration ", unread[v].iteration, ", view ", unread[v].view, ": the loss is ",
                                     value, recorder.last_checkpoint()));
    }
    state.loss_average = unread[v].iteration == 1 ? value : 0.4 * value + 0.6 * state.loss_average;
  }
}

void Trainer::Impl::on_first_rank(const std::function<void()>& work) {
  if (!is_distributed()) return work();
  read_losses_of_ranks();
  if (!ranks->is_first()) return serve_renders();
  renders_on_first = true;
  work();
  renders_on_first = false;
  ranks->exchange_record("render", RenderRequest{});
}

void Trainer::Impl::serve_renders() {
  for (;;) {
    const RenderRequest request = ranks->exchange_record("render", RenderRequest{}).front();
    if (request.kind == RenderRequest::kDone) return;
    if (request.kind == RenderRequest::kRemove) {
      flush();
      state.n_removed += remove_invalid_rows(request.row);
      continue;
    }
    try {
      project_and_draw(request.view, request.settings);
    } catch (const InvalidGaussianError&) {
      // Rank 0 has it, too, and decides.
    }
  }
}

RenderedView Trainer::Impl::render(const PinholeView& view, const RenderSettings& settings) {
  if (!is_distributed()) return rasterizer.forward(flushed_state().gaussians, view, settings);
  B3DGS_CHECK(renders_on_first, "render() outside on_first_rank()");
  RenderRequest request;
  request.kind = RenderRequest::kRender;
  request.view = view;
  request.settings = settings;
  request.settings.stages = nullptr;
  ranks->exchange_record("render", request);
  return project_and_draw(view, settings);
}

RenderedView Trainer::Impl::project_and_draw(const PinholeView& view, const RenderSettings& settings) {
  ProjectRecord record;
  ViewSplats own;
  try {
    own = rasterizer.project(flushed_state().gaussians, view, settings);
    record.n_splats = own.size();
  } catch (const InvalidGaussianError& error) {
    record.first_invalid = shards().global_row(error.row());
  }
  const std::vector<ProjectRecord> records = ranks->exchange_record("projected", record);
  check_valid(records);
  std::vector<std::vector<std::int64_t>> counts;
  for (const ProjectRecord& other : records) counts.push_back({other.n_splats});
  const std::vector<ViewSplats> drawn = splats->to_drawers({own}, counts, {0});
  if (drawn.empty()) return {};
  return rasterizer.forward_splats(drawn.front(), view, settings);
}

void Trainer::Impl::adopt_kernels_of_first_rank() {
  const std::string text = ranks->exchange("kernels", ranks->is_first() ? kernels.to_json().dump() : "").front();
  if (!ranks->is_first()) kernels.restore(nlohmann::ordered_json::parse(text), "rank 0");
}

void Trainer::Impl::agree_on_start(bool& lacks_ply, bool& lacks_checkpoint) {
  struct Start {
    std::int32_t lacks_ply, lacks_checkpoint, check_kernels;
  };
  const Start own{lacks_ply, lacks_checkpoint, kernels.is_due(check_moment(state.iteration + 1))};
  const Start first = ranks->exchange_record("start", own).front();
  lacks_ply = first.lacks_ply != 0;
  lacks_checkpoint = first.lacks_checkpoint != 0;
  agreed.check_kernels = first.check_kernels != 0;
}

bool Trainer::Impl::has_written_files() {
  const bool own = recorder.failed_files().empty();
  return is_distributed() ? ranks->exchange_record("files", std::int32_t{own}).front() != 0 : own;
}

DensityRound Trainer::Impl::plan_round_of_ranks(int iteration, std::int64_t limit) {
  // Strategies do not read colours.
  GaussianTensors gaussians;
  const GaussianTensors& own = state.gaussians;
  const std::int64_t n = state.n_gaussians();
  gaussians.means = gather_rows(*ranks, own.means, n);
  gaussians.log_scales = gather_rows(*ranks, own.log_scales, n);
  gaussians.quats = gather_rows(*ranks, own.quats, n);
  gaussians.logit_opacities = gather_rows(*ranks, own.logit_opacities, n);
  DensityStatistics statistics = state.statistics;
  for (torch::Tensor* column : statistics.all()) *column = gather_rows(*ranks, *column, n);
  return density->plan_round(gaussians, statistics, iteration, limit);
}

std::int64_t Trainer::Impl::remove_invalid_rows(std::int64_t row) {
  if (!is_distributed()) {
    return b3dgs::remove_invalid_gaussians(row, scene.extent, state.gaussians, state.adam, state.statistics);
  }
  if (renders_on_first) {
    RenderRequest request;
    request.kind = RenderRequest::kRemove;
    request.row = row;
    ranks->exchange_record("render", request);
  }
  const std::int64_t n = state.n_gaussians();
  const GaussianWidths widths = gaussian_widths(state.gaussians, state.adam);
  const RowEdit edit = edit_without_invalid(
      row, scene.extent, {gather_rows(*ranks, widths.is_finite, n), gather_rows(*ranks, widths.largest, n)});
  apply_row_edit(*ranks, edit, n, state.gaussians, state.adam, state.statistics);
  state.n_of_all_ranks = edit.n_kept;
  return n - edit.n_kept;
}

}  // namespace b3dgs
