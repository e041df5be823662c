#include "train/checkpoint.h"

#include <algorithm>

#include "check.h"
#include "train/checkpoint_file.h"
#include "train/checkpoint_header.h"
#include "train/gaussian_model.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// What has to be equal for view indices and image sizes to mean the same.
Json fingerprint(const Scene& scene) {
  Json views = Json::array();
  for (const View& view : scene.train) {
    views.push_back({{"name", view.name}, {"width", view.camera.width}, {"height", view.camera.height}});
  }
  const Json json = {{"extent", scene.extent}, {"train_views", std::move(views)}};
  // As it comes back from a file: bytes of a name that are no UTF-8 are replaced on the way.
  return Json::parse(json.dump(-1, ' ', false, Json::error_handler_t::replace));
}

void check_fingerprint(const Json& saved, const Scene& scene, const std::string& place) {
  const Json now = fingerprint(scene);
  if (saved == now) return;
  const Json &before = saved.at("train_views"), &after = now.at("train_views");
  const std::string remedy = "; resume with the -s, -i, -r and --eval that it was trained with";
  if (before.size() != after.size()) {
    input_error(place, ": was trained on ", before.size(), " views, the scene has ", after.size(), remedy);
  }
  for (std::size_t i = 0; i < before.size(); ++i) {
    if (before[i] != after[i]) {
      input_error(place, ": training view ", i, " was ", before[i].dump(), ", in the scene it is ", after[i].dump(),
                  remedy);
    }
  }
  input_error(place, ": was trained on a scene of extent ", saved.at("extent").dump(), ", this one has ",
              now.at("extent").dump(), remedy);
}

/// Calls field(name, tensor) for each tensor of a state, in the order of the file.
template <class State, class Field>
void visit_tensors(State& state, Field&& field) {
  const auto visit_groups = [&](const std::string& prefix, auto& groups) {
    for (std::size_t i = 0; i < groups.kNames.size(); ++i) field(prefix + groups.kNames[i], *groups.all()[i]);
  };
  visit_groups("gaussians.", state.gaussians);
  visit_groups("adam_m.", state.adam.m);
  visit_groups("adam_v.", state.adam.v);
  visit_groups("statistics.", state.statistics);
}

/// All tensors have the rows and columns that the header and the config ask for.
void check_shapes(const TrainState& state, std::int64_t n, int sh_degree, const std::string& place) {
  const std::int64_t rest = sh_coefficient_count(sh_degree) - 1;
  visit_tensors(state, [&](const std::string& name, const torch::Tensor& tensor) {
    std::vector<std::int64_t> wanted{n};
    torch::ScalarType type = torch::kFloat32;
    const auto is = [&](const char* group) { return name.substr(name.find('.') + 1) == group; };
    if (is("means") || is("log_scales")) wanted = {n, 3};
    if (is("quats")) wanted = {n, 4};
    if (is("sh0")) wanted = {n, 1, 3};
    if (is("shN")) wanted = {n, rest, 3};
    if (is("view_count") || is("max_radii")) type = torch::kInt32;
    if (tensor.sizes() != torch::IntArrayRef(wanted) || tensor.scalar_type() != type) {
      input_error(place, ": tensor ", name, " is ", tensor.sizes(), " ", tensor.scalar_type(), ", expected ",
                  torch::IntArrayRef(wanted), " ", type);
    }
  });
}

/// Nothing that a step would turn into NaN, or that an index could come from. Tensors are on the CPU.
void check_values(const TrainState& state, const std::string& place) {
  visit_tensors(state, [&](const std::string& name, const torch::Tensor& tensor) {
    const std::int64_t rows = std::max<std::int64_t>(1, tensor.size(0));
    if (tensor.scalar_type() == torch::kInt32) {
      check_tensor_values(tensor.data_ptr<std::int32_t>(), tensor.numel(), name, place);
    } else {
      const bool is_sum = name.rfind("adam_v.", 0) == 0 || name == "statistics.grad_norm_sum";
      check_tensor_values(tensor.data_ptr<float>(), tensor.numel(), std::max<std::int64_t>(1, tensor.numel() / rows),
                          is_sum ? TensorValues::kNotNegative : TensorValues::kFinite, name, place);
    }
  });
  check_quaternions(state.gaussians.quats.data_ptr<float>(), state.gaussians.size(), "gaussians.quats", place);
}

}  // namespace

void write_checkpoint(const std::filesystem::path& path, const TrainConfig& config, const TrainState& state,
                      const Scene& scene) {
  CheckpointFile file;
  file.header = {{"iteration", state.iteration},
                 {"n_gaussians", state.gaussians.size()},
                 {"sh_degree", state.sh_degree},
                 {"adam_steps", state.adam.steps},
                 {"view_order", {{"n_refills", state.view_order.n_refills}, {"remaining", state.view_order.remaining}}},
                 {"loss_average", state.loss_average},
                 {"elapsed_s", state.elapsed_s},
                 {"held_at", state.held_at},
                 {"kernel_selection", state.kernel_selection},
                 {"config", config_to_json(config)},
                 {"scene", fingerprint(scene)}};
  visit_tensors(state, [&](const std::string& name, const torch::Tensor& t) { file.tensors.emplace_back(name, t); });
  write_checkpoint_file(path, file);
}

Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device) {
  const std::string place = path.string();
  CheckpointFile file = read_checkpoint_file(path);
  CheckpointHeader header = parse_checkpoint_header(file.header, place);
  check_fingerprint(header.scene, scene, place);
  Checkpoint checkpoint;
  checkpoint.config = std::move(header.config);
  TrainState& state = checkpoint.state;
  state.iteration = header.iteration;
  state.sh_degree = header.sh_degree;
  state.adam.steps = header.adam_steps;
  state.view_order = std::move(header.view_order);
  state.loss_average = header.loss_average;
  state.elapsed_s = header.elapsed_s;
  state.held_at = header.held_at;
  state.kernel_selection = std::move(header.kernel_selection);
  std::size_t next = 0;
  visit_tensors(state, [&](const std::string& name, torch::Tensor& tensor) {
    if (next == file.tensors.size() || file.tensors[next].first != name) {
      input_error(place, ": tensor ", name, " is missing",
                  next < file.tensors.size() ? ", found " + file.tensors[next].first : std::string());
    }
    tensor = file.tensors[next++].second;
  });
  if (next != file.tensors.size()) input_error(place, ": has the unknown tensor ", file.tensors[next].first);
  check_shapes(state, header.n_gaussians, checkpoint.config.sh_degree, place);
  check_values(state, place);
  visit_tensors(state, [&](const std::string&, torch::Tensor& tensor) { tensor = tensor.to(device); });
  return checkpoint;
}

void remove_superseded_checkpoints(const ModelFolder& folder, int iteration, int keep) {
  const std::vector<int> iterations = folder.checkpoint_iterations();
  const auto n_until =
      static_cast<int>(std::upper_bound(iterations.begin(), iterations.end(), iteration) - iterations.begin());
  for (int i = 0; i < static_cast<int>(iterations.size()); ++i) {
    std::error_code error;  // one that cannot be removed does no harm
    if (i < n_until - keep || i >= n_until) std::filesystem::remove(folder.checkpoint(iterations[i]), error);
  }
}

std::filesystem::path newest_valid_checkpoint(const ModelFolder& folder,
                                              const std::function<void(const std::string&)>& on_message) {
  const std::vector<int> iterations = folder.checkpoint_iterations();
  for (auto it = iterations.rbegin(); it != iterations.rend(); ++it) {
    const std::filesystem::path path = folder.checkpoint(*it);
    try {
      verify_checkpoint_file(path);
      return path;
    } catch (const InputError& error) {
      if (on_message) on_message(std::string("not used: ") + error.what());
    }
  }
  return {};
}

}  // namespace b3dgs
