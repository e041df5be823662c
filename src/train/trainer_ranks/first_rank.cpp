// What rank 0 alone does while the others help: it evaluates and times kernels, for which it renders views of the whole
// model; the others project their Gaussians on its request.

#include "train/trainer_impl.h"

namespace b3dgs {

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
    record.first_invalid = owners.row_of_model(error.row());
  }
  const std::vector<ProjectRecord> records = ranks->exchange_record("projected", record);
  check_valid(records);
  std::vector<std::vector<std::int64_t>> counts;
  for (const ProjectRecord& other : records) counts.push_back({other.n_splats});
  const std::vector<ViewSplats> drawn = splats->to_drawers({own}, counts, {0}, owners.own());
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

}  // namespace b3dgs
