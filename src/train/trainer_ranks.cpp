// Training on several ranks (processes, src/dist). Each has some rows of the model (core/row_shards.h), with their
// moments and statistics. In a step every rank projects its Gaussians for all views of the step; the splats of a view
// go to the rank that draws it (DrawPlan), compares it with the photograph and blends backward; the sums of each splat
// go back to the rank of its Gaussian, which takes the Adam step. With more ranks than views, a view is drawn in bands
// of tile rows; the ranks of a view exchange their rows of the image, and each compares the whole image. What is
// learned does not depend on the number of ranks.
//
// Ranks take the same decisions in the same order: from what all of them know, or from what StepRecord tells them.
// Rank 0 writes the files. To evaluate or to time kernels, it renders views of the whole model; the other ranks then
// project their Gaussians on its request.

#include <algorithm>
#include <cstring>
#include <set>

#include "config/batch_steps.h"
#include "config/coarse_schedule.h"
#include "raster/math/project_splat.h"
#include "raster/torch/splat_owner.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density/invalid_gaussians.h"
#include "train/optimizer/lr_schedule.h"
#include "train/ranks/sharded_row_edit.h"
#include "train/trainer_impl.h"

namespace b3dgs {
namespace {

/// What each rank tells the others in a step, after its projections.
/// Then follow the numbers of splats for each part of the step, and DrawnParts::rows of the step before.
struct StepRecord {
  std::int64_t first_invalid = -1;   // row of the model that cannot be rendered
  DrawnRecord drawn{};               // of the step before
  std::int64_t n_seen[kMaxBatch]{};  // splats of each view
  std::int32_t stop = 0;
  std::int32_t write_checkpoint = 0, check_kernels = 0;  // only rank 0's values are used
  std::int32_t is_out_of_memory = 0;
};

/// What rank 0 asks of the others in on_first_rank().
struct RenderRequest {
  enum Kind : std::int32_t { kDone, kRender, kRemove };
  std::int64_t row = 0;  // to remove
  PinholeView view{};
  RenderSettings settings{};
  Kind kind = kDone;
};

constexpr std::size_t kPlannedSteps = 4;  // whose views are assigned to ranks at a time

// Exchanges are timed in the first kMeasured iterations of a session after kWarmUp, and then in some steps.
constexpr int kWarmUp = 20, kMeasured = 40, kTimedInterval = 10;

struct ProjectRecord {
  std::int64_t n_splats = 0, first_invalid = -1;
};

/// Exchanges a record that numbers follow.
template <class Record>
std::vector<std::pair<Record, std::vector<std::int64_t>>> exchange_with_numbers(
    Communicator& ranks, const char* label, const Record& record, const std::vector<std::int64_t>& numbers) {
  std::string bytes(reinterpret_cast<const char*>(&record), sizeof record);
  bytes.append(reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(std::int64_t));
  std::vector<std::pair<Record, std::vector<std::int64_t>>> all;
  for (const std::string& other : ranks.exchange(label, bytes)) {
    B3DGS_CHECK(other.size() >= sizeof(Record), label);
    auto& [other_record, other_numbers] = all.emplace_back();
    std::memcpy(&other_record, other.data(), sizeof(Record));
    other_numbers.resize((other.size() - sizeof(Record)) / sizeof(std::int64_t));
    if (other_numbers.empty()) continue;  // memcpy() wants no null pointer
    std::memcpy(other_numbers.data(), other.data() + sizeof(Record), other_numbers.size() * sizeof(std::int64_t));
  }
  return all;
}

/// All tensors with a row per Gaussian.
template <class Visit>
void visit_rows(TrainState& state, Visit&& visit) {
  for (GaussianTensors* group : {&state.gaussians, &state.adam.m, &state.adam.v}) {
    for (torch::Tensor* tensor : group->all()) visit(*tensor);
  }
  visit(state.gaussians.filters);
  for (torch::Tensor* column : state.statistics.all()) visit(*column);
}

/// Tensors on the device that are whole on every rank, and the same.
template <class Visit>
void visit_shared(TrainState& state, Visit&& visit) {
  visit_appearance(state.appearance, [&](const char*, torch::Tensor& tensor) { visit(tensor); });
  if (!state.background.is_defined()) return;
  for (torch::Tensor* tensor : {&state.background.coefficients, &state.background.m, &state.background.v}) {
    visit(*tensor);
  }
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

void Trainer::Impl::keep_own_rows() {
  state.n_of_all_ranks = state.gaussians.size();
  visit_rows(state, [&](torch::Tensor& tensor) {
    if (tensor.defined()) tensor = own_rows(tensor, shards()).to(device);
  });
  visit_shared(state, [&](torch::Tensor& tensor) { tensor = tensor.to(device); });
}

GaussianTensors Trainer::Impl::gathered_gaussians() {
  GaussianTensors whole = flushed_state().gaussians;
  const auto gather = [&](torch::Tensor& tensor) {
    if (tensor.defined()) tensor = gather_rows_on_first(*ranks, tensor, state.n_gaussians());
  };
  for (torch::Tensor* tensor : whole.all()) gather(*tensor);
  gather(whole.filters);
  return whole;
}

void Trainer::Impl::write_checkpoint_of_ranks() {
  using TakeBytes = std::function<void(const void*, std::size_t)>;
  const TrainState& own = flushed_state();
  std::set<const void*> rows;  // tensors of which each rank has a part
  visit_rows(state, [&](torch::Tensor& tensor) {
    if (tensor.defined()) rows.insert(tensor.unsafeGetTensorImpl());
  });
  const TakeBytes ignore = [](const void*, std::size_t) {};
  std::vector<OutputWriter::TensorPieces> tensors;
  std::size_t n_read = 0;  // all ranks read all tensors in one order, even if rank 0 cannot write them
  for (const auto& [name, tensor] : checkpoint_tensors(own)) {
    const bool has_part = rows.count(tensor.unsafeGetTensorImpl()) > 0;
    TensorEntry entry{name, tensor.scalar_type(), tensor.sizes().vec()};
    if (has_part) entry.shape[0] = state.n_gaussians();
    tensors.push_back({entry, [this, has_part, &n_read, part = tensor](const TakeBytes& take) {
                         ++n_read;
                         const auto take_rows = [&](const torch::Tensor& piece) {
                           take(piece.data_ptr(), piece.nbytes());
                         };
                         if (has_part) return stream_rows_to_first(*ranks, part, state.n_gaussians(), take_rows);
                         take_rows(part.cpu());
                       }});
  }
  if (writes_files()) recorder.write_checkpoint(checkpoint_header(config, own, fingerprint), tensors);
  while (n_read < tensors.size()) tensors[n_read].read(ignore);
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
  const int last = step_end(config.batch, config.iterations, state.iteration);
  bool is_filter_due = begin_step_of_views(last);
  if (times_exchanges(state.iteration, last)) exchange_timer.start();
  do {
    const int from = state.iteration;
    const std::vector<LearnedView> views = next_views_of_step(last);
    keep_views_of_ranks(from, views, last, std::exchange(is_filter_due, false));
  } while (state.iteration < last);
  if (learned_views.empty()) {
    exchange_timer.cancel();
    return timer.cancel();
  }
  learn_from_kept_views();
  timer.finish(state.step_iterations);
  exchange_timer.finish();
}

std::vector<Trainer::Impl::LearnedView> Trainer::Impl::next_views_of_step(int last) {
  std::vector<LearnedView> views;
  while (state.iteration < last) {
    const int iteration = state.iteration + 1;
    const std::int32_t index = state.view_order.upcoming(config.seed, images.size(), 1).front();
    if (may_skip_step(iteration)) {
      // The same view twice, at the end of an epoch: whether it is skipped depends on its first loss.
      const auto is_same = [&](std::int32_t other) { return other == index; };
      if (std::any_of(views.begin(), views.end(), [&](const auto& view) { return is_same(view.index); })) break;
      if (std::any_of(unread_losses.begin(), unread_losses.end(),
                      [&](const auto& unread) { return is_same(unread.view_index); })) {
        read_losses_of_ranks();
      }
    }
    const bool is_skipped = skip_step(iteration);
    state.iteration = iteration;
    state.view_order.next(config.seed, images.size());
    if (!is_skipped) views.push_back({index, iteration});
  }
  return views;
}

std::vector<std::int32_t> Trainer::Impl::own_views_ahead() {
  // How many views are read ahead differs between ranks, but plans must not: a few steps are planned, others guessed.
  const std::size_t batch = static_cast<std::size_t>(config.batch), n_wanted = images.n_upcoming_wanted();
  const std::size_t n_views =
      std::max((n_wanted + 1) * std::max(static_cast<std::size_t>(ranks->size()), batch), kPlannedSteps * batch);
  const std::vector<std::int32_t> upcoming =
      state.view_order.upcoming(config.seed, images.size(), n_views * (config.skip_share > 0 ? 2 : 1));
  ViewSkips skips = state.view_skips;
  std::vector<std::int32_t> own;
  int iteration = state.iteration;
  auto view = upcoming.begin();
  for (std::size_t n_steps = 0; view != upcoming.end() && iteration < config.iterations; ++n_steps) {
    const int from = iteration, last = step_end(config.batch, config.iterations, from);
    std::vector<LearnedView> step;
    for (; view != upcoming.end() && iteration < last; ++view) {
      ++iteration;
      if (may_skip_step(iteration) && skips.skip(*view, iteration - config.skip_from_iter, config.skip_share)) continue;
      step.push_back({*view, iteration});
    }
    const StepPlan plan =
        n_steps + 1 < kPlannedSteps ? planned_step(from, step) : whole_views(equal_drawers(step.size(), ranks->size()));
    for (const DrawnPart& part : plan) {
      if (part.rank == ranks->rank()) own.push_back(step[part.view].index);
    }
  }
  return own;
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
      view.own = with_remedies({wait_for_files(), free_scratch(), release_photographs()}, [&] {
        return stepper.project(state.gaussians, state.adam, view.camera, view.settings);
      });
      record.n_seen[v] = view.own.size();
      own.push_back(view.own);
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
       exchange_timer.time([&] { return exchange_with_numbers(*ranks, "step", record, numbers); })) {
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
  const std::vector<ViewSplats> drawn = exchange_timer.time([&] { return splats->to_drawers(counts); });
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
      own_parts.push_back({part, std::nullopt, rasterizer.row_entries()});
      std::vector<torch::Tensor> images{compared.rendered.color};
      if (depth_priors) images.push_back(compared.rendered.depth);
      exchange_timer.time([&] { return splats->share_rows(images, n_image_columns); });
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
  if (drawn_sums.empty()) exchange_timer.time([&] { return splats->share_rows({}, n_image_columns); });
  for (const LearnedView& view : learned) {
    unread_losses.push_back({view.iteration, scene.train[static_cast<std::size_t>(view.index)].name, view.index});
  }

  // The Gaussians of this rank.
  const std::vector<torch::Tensor> sums =
      exchange_timer.time([&] { return splats->sums_to_owners(drawn_sums, drawn_pairs, is_exact); });
  std::vector<torch::Tensor> scores;
  if (has_scores) {
    scores = exchange_timer.time([&] { return splats->scores_to_owners(drawn_scores); });
  }
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

StepPlan Trainer::Impl::planned_step(int from, const std::vector<LearnedView>& views) {
  if (views.empty()) return {};
  const std::int32_t height_of_tile = step_settings().tile.height;
  std::vector<DrawPlan::PlannedView> planned;
  for (const LearnedView& view : views) {
    const std::int32_t height = camera_of(view.index, view.iteration).height;
    planned.push_back({view.index, (height + height_of_tile - 1) / height_of_tile});
  }
  // What is learned with the view, and the loss of masked regions, need the whole image of one rank.
  const bool may_cut = n_shared_columns() == 0 && config.mask_mode != "segment";
  return draw_plan.plan(from, planned, may_cut);
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
  if (!own_parts.empty() && !own_parts.back().loss) own_parts.back().loss = loss.value().loss;
}

DrawnParts Trainer::Impl::take_drawn() {
  read_own_loss();
  DrawnParts drawn;
  DrawnRecord& record = drawn.record;
  for (const OwnPart& own : std::exchange(own_parts, {})) {
    record.losses[own.part.view] = *own.loss;
    if (!own.part.is_band() && !is_banded(step_plan)) {
      record.entries[own.part.view] = own.entries.sum().item<std::int64_t>();
      continue;
    }
    const torch::Tensor entries = own.entries.cpu();
    const std::int64_t height = entries.size(0);
    for (std::int64_t row = own.part.rows.begin; row < own.part.rows.end && row * tile_height < height; ++row) {
      const std::int64_t top = row * tile_height, bottom = std::min(top + tile_height, height);
      drawn.rows.push_back(entries.slice(0, top, bottom).sum().item<std::int64_t>());
    }
  }
  for (const ExchangeTimer::Times& step : exchange_timer.take()) {
    ++own_totals.n_timed;
    own_totals.exchange_ms += step.exchange_ms;
    own_totals.step_ms += step.step_ms;
  }
  own_totals.sent_bytes = splats->sent_bytes();
  own_totals.received_bytes = splats->received_bytes();
  record.totals = own_totals;
  return drawn;
}

void Trainer::Impl::read_losses_of_ranks() {
  if (unread_losses.empty()) return;
  const DrawnParts own = take_drawn();
  std::vector<DrawnParts> of_ranks;
  for (auto& [record, rows] : exchange_with_numbers(*ranks, "drawn", own.record, own.rows)) {
    of_ranks.push_back({record, std::move(rows)});
  }
  add_drawn(of_ranks);
}

void Trainer::Impl::count_drawn(const std::vector<UnreadLoss>& views, const std::vector<DrawnParts>& of_ranks) {
  const int size = ranks->size();
  std::vector<std::int64_t> work(static_cast<std::size_t>(size)), equal_work(work);
  if (is_banded(step_plan)) {
    std::vector<std::vector<std::int64_t>> rows(views.size()), even(views.size());
    for (const DrawnPart& part : step_plan) {
      const std::vector<std::int64_t>& band = of_ranks[static_cast<std::size_t>(part.rank)].rows;
      for (const std::int64_t entries : band) work[static_cast<std::size_t>(part.rank)] += entries;
      rows[part.view].insert(rows[part.view].end(), band.begin(), band.end());
    }
    for (std::size_t v = 0; v < views.size(); ++v) even[v].assign(rows[v].size(), 1);
    for (const DrawnPart& part : counted_bands(even, size)) {
      const std::vector<std::int64_t>& of_view = rows[part.view];
      for (std::size_t row = static_cast<std::size_t>(part.rows.begin);
           row < of_view.size() && row < static_cast<std::size_t>(part.rows.end); ++row) {
        equal_work[static_cast<std::size_t>(part.rank)] += of_view[row];
      }
    }
    for (std::size_t v = 0; v < views.size(); ++v) draw_plan.set_row_work(views[v].view_index, std::move(rows[v]));
  } else {
    const std::vector<int> in_turn = equal_drawers(views.size(), size);
    for (const DrawnPart& part : step_plan) {
      const std::int64_t entries = of_ranks[static_cast<std::size_t>(part.rank)].record.entries[part.view];
      work[static_cast<std::size_t>(part.rank)] += entries;
      equal_work[static_cast<std::size_t>(in_turn[part.view])] += entries;
      draw_plan.set_work(views[part.view].view_index, entries);
    }
  }
  rank_load.add_step(work, equal_work);
}

void Trainer::Impl::add_drawn(const std::vector<DrawnParts>& of_ranks) {
  const std::vector<UnreadLoss> unread = std::exchange(unread_losses, {});
  if (unread.empty()) return;
  count_drawn(unread, of_ranks);
  std::vector<RankTotals> totals;
  for (const DrawnParts& drawn : of_ranks) totals.push_back(drawn.record.totals);
  rank_load.set_totals(totals);
  for (std::size_t v = 0; v < unread.size(); ++v) {
    const auto part = std::find_if(step_plan.begin(), step_plan.end(), [&](const auto& p) { return p.view == v; });
    add_loss(unread[v], of_ranks[static_cast<std::size_t>(part->rank)].record.losses[v]);
  }
}

void Trainer::Impl::on_first_rank(const std::function<void()>& work) {
  if (!is_distributed()) return work();
  read_losses_of_ranks();
  update_filters(/*is_due=*/false);  // all ranks together
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
  splats->begin(whole_views({0}), {own}, settings.tile.height);
  const std::vector<ViewSplats> drawn = splats->to_drawers(counts);
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
  allocate_together([&] {
    constexpr std::int64_t kFloats = 3 + 3 + 4 + 1;  // of a Gaussian, without colours
    const auto n_columns = static_cast<std::int64_t>(state.statistics.all().size());
    const torch::Tensor room = memory->allocate({(kFloats + n_columns) * n}, own.means.options());
  });
  gaussians.means = gather_rows(*ranks, own.means, n);
  gaussians.log_scales = gather_rows(*ranks, own.log_scales, n);
  gaussians.quats = gather_rows(*ranks, own.quats, n);
  gaussians.logit_opacities = gather_rows(*ranks, own.logit_opacities, n);
  DensityStatistics statistics = state.statistics;
  for (torch::Tensor* column : statistics.all()) *column = gather_rows(*ranks, *column, n);
  DensityRound round;
  allocate_together([&] { round = density->plan_round(gaussians, statistics, iteration, limit); });
  return round;
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
