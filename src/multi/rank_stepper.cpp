// What rank 0 alone does while the others help: it evaluates and times kernels, for which it renders views of the whole
// model; the others project their Gaussians on its request.
#include "multi/rank_stepper.h"

#include "raster/torch/torch_cuda.h"

namespace b3dgs {

void use_rank_stepper(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks,
                      std::int64_t splats_at_a_time) {
  if (ranks.size() == 1) return;
  hooks.make_stepper = [&ranks, splats_at_a_time](Training& training) {
    return std::make_unique<RankStepper>(training, ranks, splats_at_a_time);
  };
  if (kTorchHasCuda && config.gpu_memory_gb == 0 && ranks.shares_gpus()) {
    device_memory_size();  // makes the context of this process, which takes memory itself
    ranks.barrier("start of the GPU");
    const std::int64_t free = device_memory_size().free;
    ranks.barrier("free GPU memory");
    hooks.gpu_memory_gb = 1e-9 * static_cast<double>(free) / ranks.n_on_own_gpu();
  }
}

void RankStepper::on_first(const std::function<void()>& work) {
  if (renders_on_first_) return work();
  has_failed_together_ = false;
  complete_pending();
  update_filters(/*is_due=*/false);  // all ranks together
  if (!ranks_.is_first()) return serve_renders();
  renders_on_first_ = true;
  RenderRequest end;
  try {
    work();
  } catch (const PeerError&) {
    renders_on_first_ = false;
    throw;
  } catch (const std::exception& error) {
    // The others wait for a request. All end together, which leaves a checkpoint.
    renders_on_first_ = false;
    end.kind = RenderRequest::kFailed;
    end.can_save = dynamic_cast<const LossError*>(&error) == nullptr;
    ranks_.exchange_record("render", end);
    ranks_.exchange("failure", error.what());
    has_failed_together_ = end.can_save;
    throw;
  }
  renders_on_first_ = false;
  ranks_.exchange_record("render", end);
}

void RankStepper::serve_renders() {
  for (;;) {
    const RenderRequest request = ranks_.exchange_record("render", RenderRequest{}).front();
    if (request.kind == RenderRequest::kDone) return;
    if (request.kind == RenderRequest::kFailed) {
      has_failed_together_ = request.can_save;
      throw PeerError(0, ranks_.size(), ranks_.exchange("failure", "").front());
    }
    if (request.kind == RenderRequest::kRemove) {
      flush();
      state_.n_removed += remove_invalid_rows(request.row);
      continue;
    }
    try {
      project_and_render(request.view, request.settings);
    } catch (const InvalidGaussianError&) {
      // Rank 0 has it, too, and decides.
    } catch (const OutOfMemoryError&) {
      // Likewise.
    }
  }
}

RenderedView RankStepper::render(const CameraView& view, const RenderSettings& settings) {
  B3DGS_CHECK(renders_on_first_, "render() outside on_first()");
  RenderRequest request;
  request.kind = RenderRequest::kRender;
  request.view = view;
  request.settings = settings;
  request.settings.stages = nullptr;
  ranks_.exchange_record("render", request);
  return project_and_render(view, settings);
}

RenderedView RankStepper::project_and_render(const CameraView& view, const RenderSettings& settings) {
  StepRecord record;
  ViewSplats own;
  record_errors(record, [&] {
    own = with_remedies(training_.remedies(),
                        [&] { return training_.rasterizer.project(flushed_state().gaussians, view, settings); });
    record.n_splats[0] = own.size();
  });
  const std::vector<StepRecord> records = ranks_.exchange_record("projected", record);
  check_projections(records);
  std::vector<std::vector<std::int64_t>> counts;
  for (const StepRecord& other : records) counts.push_back({other.n_splats[0]});
  std::vector<ViewSplats> splats;
  try {
    splats_.pack({own}, {0}, owners_.own());
    splats = splats_.to_renderers(counts);
  } catch (const OutOfMemoryError& error) {  // not to be repeated by this rank alone: the others are in the exchange
    throw PeerError(ranks_.rank(), ranks_.size(), error.what());
  }
  if (splats.empty()) return {};
  return training_.rasterizer.forward_splats(splats.front(), view, settings);
}

void RankStepper::share_kernels() {
  const std::string text =
      ranks_.exchange("kernels", ranks_.is_first() ? training_.kernels.to_json().dump() : "").front();
  if (!ranks_.is_first()) training_.kernels.restore(nlohmann::ordered_json::parse(text), "rank 0");
}

Stepper::Missing RankStepper::agree_on_start(Missing here) {
  struct Start {
    std::int32_t lacks_ply, lacks_checkpoint, check_kernels;
  };
  const bool check_kernels = training_.kernels.is_due(training_.check_moment(state_.iteration + 1));
  const Start first = ranks_.exchange_record("start", Start{here.ply, here.checkpoint, check_kernels}).front();
  agreed_.check_kernels = first.check_kernels != 0;
  return {first.lacks_ply != 0, first.lacks_checkpoint != 0};
}

bool RankStepper::has_written_files() {
  const bool here = training_.recorder.failed_files().empty();
  return ranks_.exchange_record("files", std::int32_t{here}).front() != 0;
}

std::string RankStepper::last_checkpoint() const {
  const std::vector<int> iterations = training_.folder.checkpoint_iterations();  // rank 0 has written them
  if (iterations.empty()) return "; last checkpoint: none was written";
  const std::filesystem::path last = training_.folder.checkpoint(iterations.back());
  return "; last checkpoint: " + last.string() + ", " + training_.resume_words(last);
}

void RankStepper::compute_filters(SmoothingFilter& filter) {
  filter.compute(state_.gaussians, [this](torch::Tensor& largest) {
    const torch::Tensor bits = largest.view(torch::kInt32);  // in the order of the values
    largest = ranks_.all_gather_rows(bits).amax(0, /*keepdim=*/true).view(torch::kFloat32);
  });
}

}  // namespace b3dgs
