// The start of a training on several ranks, and renders of the whole model. While rank 0 evaluates or counts the load,
// the other ranks project their Gaussians on its request.
#include "multi/rank_team.h"

#include "core/json_text.h"
#include "model/checkpoint/checkpoint_header.h"
#include "raster/torch/torch_cuda.h"
#include "scene/scene.h"

namespace b3dgs {

namespace {

using Json = nlohmann::ordered_json;

/// Returns a description of the scene as a list of [what, value]. Entries about a view follow the entry with its name.
Json describe(const Scene& scene, const Json& fingerprint) {
  Json rows = Json::array();
  const auto add = [&](const std::string& what, const Json& value) { rows.push_back(Json::array({what, value})); };
  const auto add_views = [&](const std::string& kind, const std::vector<View>& views) {
    add("number of " + kind + " views", views.size());
    for (std::size_t i = 0; i < views.size(); ++i) {
      const Camera& camera = views[i].camera;
      std::string view = detail::concat(" of ", kind, " view ", i);
      add("name" + view, views[i].name);
      view += " (" + views[i].name + ")";
      add("size" + view, detail::concat(camera.width, " x ", camera.height));
      add("focal length, principal point, lens or pose" + view,
          Json::array({camera.fx, camera.fy, camera.cx, camera.cy, camera.cam_from_world.rotation,
                       camera.cam_from_world.translation, camera.lens.kind, camera.lens.max_angle, camera.lens.k}));
      if (kind == "test") continue;
      add("photograph" + view, Json::array({fingerprint.at("photographs").at(i)}));
      add("mask" + view, Json::array({fingerprint.at("masks").at(i)}));
    }
  };
  add_views("train", scene.train);
  add_views("test", scene.test);
  const std::vector<float>& positions = scene.points.positions;
  const std::uint32_t crc = add_crc(0, positions.data(), positions.size() * sizeof(float));
  add("number of points", scene.points.size());
  add("positions or colours of points",
      Json::array({add_crc(crc, scene.points.colors.data(), scene.points.colors.size())}));
  return rows;
}

/// Returns the first difference between two descriptions that differ.
std::string find_difference(const Json& there, const Json& first) {
  std::size_t i = 0;
  while (i + 1 < there.size() && dump_json(there[i]) == dump_json(first[i]))
    ++i;  // compared as texts, in which 0.0 and -0.0 differ
  const std::string what = there[i][0].get<std::string>();
  const Json &here = there[i][1], &other = first[i][1];
  return here.is_structured() ? what
                              : detail::concat(what, ": ", dump_json(here), " there, ", dump_json(other), " on rank 0");
}

}  // namespace

void use_rank_team(Communicator& ranks, const TrainConfig& config, TrainHooks& hooks, std::int64_t splats_at_a_time) {
  if (ranks.size() == 1) return;
  hooks.make_team = [&ranks, splats_at_a_time](Training& training) {
    return std::make_unique<RankTeam>(training, ranks, splats_at_a_time);
  };
  if (kTorchHasCuda && config.gpu_memory_gb == 0 && ranks.shares_gpus()) {
    device_memory_size();  // creates the CUDA context of this process, which takes memory itself
    ranks.barrier("start of the GPU");
    const std::int64_t free = device_memory_size().free;
    ranks.barrier("free GPU memory");
    hooks.gpu_memory_gb = 1e-9 * static_cast<double>(free) / ranks.n_on_own_gpu();
  }
}

RankTeam::RankTeam(Training& training, Communicator& ranks, std::int64_t splats_at_a_time)
    : Team(training, ranks.is_first()),
      ranks_(ranks),
      splats_at_a_time_(splats_at_a_time),
      splats_(ranks),
      render_plan_(ranks.size()) {
  B3DGS_CHECK(!training.hooks.wants_model, "a training on several ranks cannot be shown");
  can_save_ = false;
  training.find_largest_filter = [&ranks](torch::Tensor& largest) {
    const torch::Tensor bits =
        largest.view(torch::kInt32);  // the bits of non-negative floats are ordered like their values
    const std::vector<std::int64_t> ones(static_cast<std::size_t>(ranks.size()), 1);
    largest = ranks.all_gather_rows(bits, ones).amax(0, /*keepdim=*/true).view(torch::kFloat32);
  };
  check_same_scene();
}

void RankTeam::render_on_first(const std::function<void(const RenderModelFn&)>& work) {
  const RenderModelFn render_model = [this](const CameraView& view, const RenderSettings& settings) {
    return render(view, settings);
  };
  if (renders_on_first_) return work(render_model);
  can_save_ = false;
  training_.update_filters(/*is_due=*/false);  // on all ranks together
  if (!is_first_) return serve_renders();
  renders_on_first_ = true;
  RenderRequest end;
  try {
    work(render_model);
  } catch (const PeerError&) {
    renders_on_first_ = false;
    throw;
  } catch (const std::exception& error) {
    // The other ranks are waiting for a request. All ranks end together, so that a checkpoint can be written.
    renders_on_first_ = false;
    end.kind = RenderRequest::kFailed;
    end.can_save = dynamic_cast<const LossError*>(&error) == nullptr;
    ranks_.exchange_record("render", end);
    ranks_.exchange("failure", error.what());
    can_save_ = end.can_save;
    throw;
  }
  renders_on_first_ = false;
  ranks_.exchange_record("render", end);
}

void RankTeam::serve_renders() {
  for (;;) {
    const RenderRequest request = ranks_.exchange_record("render", RenderRequest{}).front();
    if (request.kind == RenderRequest::kDone) return;
    if (request.kind == RenderRequest::kFailed) {
      can_save_ = request.can_save;
      throw PeerError(0, ranks_.size(), ranks_.exchange("failure", "").front());
    }
    if (request.kind == RenderRequest::kRemove) {
      training_.flush();
      state_.n_removed += remove_invalid_rows(request.row);
      continue;
    }
    try {
      project_and_render(request.view, request.settings);
    } catch (const InvalidGaussianError&) {
      // All ranks get this error, and rank 0 decides.
    } catch (const OutOfMemoryError&) {
      // All ranks get this error as well.
    }
  }
}

RenderedView RankTeam::render(const CameraView& view, const RenderSettings& settings) {
  B3DGS_CHECK(renders_on_first_, "render() outside render_on_first()");
  RenderRequest request;
  request.kind = RenderRequest::kRender;
  request.view = view;
  request.settings = settings;
  request.settings.stages = nullptr;
  ranks_.exchange_record("render", request);
  return project_and_render(view, settings);
}

RenderedView RankTeam::project_and_render(const CameraView& view, const RenderSettings& settings) {
  StepRecord record;
  ViewSplats own;
  record_errors(record, [&] {
    own = with_remedies(training_.remedies(), [&] {
      return training_.rasterizer.project(training_.flushed_state().gaussians, view, settings);
    });
    record.n_splats[0] = own.size();
  });
  const std::vector<StepRecord> records = ranks_.exchange_record("projected", record);
  check_projections(records);
  std::vector<std::vector<std::int64_t>> counts;
  for (const StepRecord& other : records) counts.push_back({other.n_splats[0]});
  std::vector<ViewSplats> splats;
  const std::string lack = lack_of_memory([&] {
    splats_.pack({own}, {0}, owners_.own());
    splats = splats_.to_renderers(counts);
  });
  if (!lack.empty()) {  // this rank cannot retry alone, because the others are in the exchange
    ranks_.stop_others(lack);
    throw PeerError(ranks_.rank(), ranks_.size(), lack);
  }
  if (splats.empty()) return {};
  return training_.rasterizer.forward_splats(splats.front(), view, settings);
}

void RankTeam::check_same_scene() {
  const Scene& scene = training_.scene;
  if (training_.fingerprint.is_null()) training_.fingerprint = scene_identity(training_);
  const std::string own = dump_json(describe(scene, training_.fingerprint));
  const std::string first = ranks_.exchange("scene", is_first_ ? own : "").front();
  std::string difference;
  if (own != first) {
    difference = find_difference(parse_json(own), parse_json(first)) + " (" + scene.source_path + ")";
  }
  const std::vector<std::string> differences = ranks_.exchange("differences of scenes", difference);
  for (std::size_t rank = 0; rank < differences.size(); ++rank) {
    if (differences[rank].empty()) continue;
    input_error("rank ", rank, " of ", ranks_.size(), " and rank 0 read different scenes: ", differences[rank],
                "; this folder must be the same on all machines");
  }
}

}  // namespace b3dgs
