#include "train/checkpoint/checkpoint.h"

#include <algorithm>
#include <cmath>
#include <system_error>

#include "core/check.h"
#include "model/checkpoint/checkpoint_header.h"
#include "model/photographs.h"
#include "train/appearance/bilateral_grid_args.h"
#include "train/checkpoint/checkpoint_file.h"
#include "train/density/density_strategy.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Equal up to rounding: the order of a sum may change from version to version.
bool is_same_extent(const Json& before, const Json& after) {
  constexpr double kTolerance = 1e-6;
  const auto a = before.get<double>(), b = after.get<double>();
  return std::abs(a - b) <= kTolerance * std::max(std::abs(a), std::abs(b));
}

/// `json` as it will be read back from a file: invalid UTF-8 is replaced when it is written.
Json as_read_back(const Json& json) {
  return Json::parse(json.dump(-1, ' ', false, Json::error_handler_t::replace));
}

Json describe_views(const Scene& scene) {
  Json views = Json::array();
  for (const View& view : scene.train) {
    views.push_back({{"name", view.name}, {"width", view.camera.width}, {"height", view.camera.height}});
  }
  return as_read_back(views);
}

constexpr const char* kCorrections = "poses.corrections";
const std::string kAppearance = "appearance.";

/// Calls field(name, tensor) for each tensor of a state, in file order.
template <class State, class Field>
void visit_tensors(State& state, Field&& field) {
  const auto visit_groups = [&](const std::string& prefix, auto& groups) {
    for (std::size_t i = 0; i < groups.kNames.size(); ++i) field(prefix + groups.kNames[i], *groups.all()[i]);
  };
  visit_groups("gaussians.", state.gaussians);
  visit_groups("adam_m.", state.adam.m);
  visit_groups("adam_v.", state.adam.v);
  const std::vector<std::string> columns = state.statistics.names();
  for (std::size_t i = 0; i < columns.size(); ++i) field("statistics." + columns[i], *state.statistics.all()[i]);
  if (state.gaussians.filters.defined()) field("gaussians.filters", state.gaussians.filters);
  if (state.poses.is_defined()) {
    field(kCorrections, state.poses.corrections);
    field("poses.adam_m", state.poses.adam_m);
    field("poses.adam_v", state.poses.adam_v);
    field("poses.steps", state.poses.steps);
  }
  visit_appearance(state.appearance, [&](const char* name, auto& tensor) { field(kAppearance + name, tensor); });
  if (state.background.is_defined()) {
    field("background.coefficients", state.background.coefficients);
    field("background.adam_m", state.background.m);
    field("background.adam_v", state.background.v);
  }
}

bool is_of_poses(const std::string& name) {
  return name.rfind("poses.", 0) == 0;
}

/// @throws InputError unless all tensors have the shapes and types that header and config imply
void check_shapes(const TrainState& state, std::int64_t n, const TrainConfig& config, std::int64_t n_views,
                  const std::string& place) {
  const std::int64_t rest = sh_coefficient_count(config.sh_degree) - 1;
  const int background_degree = learned_background_degree(config);
  if (state.background.is_defined() != (background_degree >= 0)) {
    input_error(place, ": --background is ", config.background, ", but the checkpoint has ",
                state.background.is_defined() ? "a" : "no", " learned background; the file is damaged");
  }
  visit_tensors(state, [&](const std::string& name, const torch::Tensor& tensor) {
    std::vector<std::int64_t> wanted{n};
    torch::ScalarType type = torch::kFloat32;
    const auto is = [&](const char* group) { return name.substr(name.find('.') + 1) == group; };
    if (is("means") || is("log_scales")) wanted = {n, 3};
    if (is("quats")) wanted = {n, 4};
    if (is("sh0")) wanted = {n, 1, 3};
    if (is("shN")) wanted = {n, rest, 3};
    if (is("view_count") || is("max_radii") || is("steps")) type = torch::kInt32;
    if (is_of_poses(name)) {
      wanted = {n_views};
      if (!is("steps")) wanted.push_back(kCameraGradients);
    }
    if (name.rfind(kAppearance, 0) == 0) {
      wanted = {n_views, 3, 4};
      if (state.appearance.grids.defined()) wanted = {n_views, kGridLevels, kGridHeight, kGridWidth, kTransformSize};
    }
    if (name.rfind("background.", 0) == 0) wanted = {sh_coefficient_count(background_degree), 3};
    if (tensor.sizes() != torch::IntArrayRef(wanted) || tensor.scalar_type() != type) {
      input_error(place, ": tensor ", name, " is ", tensor.sizes(), " ", tensor.scalar_type(), ", expected ",
                  torch::IntArrayRef(wanted), " ", type);
    }
  });
}

/// @throws InputError if a count or a sum of squares is negative. Tensors are on the CPU.
void check_values(const TrainState& state, const std::string& place) {
  visit_tensors(state, [&](const std::string& name, const torch::Tensor& tensor) {
    if (tensor.scalar_type() == torch::kInt32) {
      check_not_negative(tensor.data_ptr<std::int32_t>(), tensor.numel(), name, place);
    } else if (name.rfind("adam_v.", 0) == 0 || name == "statistics.grad_norm_sum" || name == "poses.adam_v" ||
               name == kAppearance + "v" || name == "background.adam_v") {
      check_not_negative(tensor.data_ptr<float>(), tensor.numel(), name, place);
    } else if (name == kCorrections && !torch::isfinite(tensor).all().item<bool>()) {
      input_error(place, ": tensor ", name, " has values that are not finite");
    }
  });
}

}  // namespace

Json scene_fingerprint(const Scene& scene) {
  Json photographs = Json::array();
  for (const View& view : scene.train) photographs.push_back(photograph_fingerprint(view.file));
  return {{"extent", scene.extent}, {"train_views", describe_views(scene)}, {"photographs", std::move(photographs)}};
}

void check_scene(const Json& header, const Scene& scene, const std::string& place) {
  const std::string remedy = "; resume with the same -s, -i, -r and --eval";
  try {
    const Json &saved = header.at("scene"), &before = saved.at("train_views"), after = describe_views(scene);
    if (before.size() != after.size()) {
      input_error(place, ": trained on ", before.size(), " views, but the scene has ", after.size(), remedy);
    }
    for (std::size_t i = 0; i < before.size(); ++i) {
      if (before[i] != after[i]) {
        input_error(place, ": training view ", i, " was ", before[i].dump(), ", but in the scene it is ",
                    after[i].dump(), remedy);
      }
    }
    if (!is_same_extent(saved.at("extent"), scene.extent)) {
      input_error(place, ": trained on a scene of extent ", saved.at("extent").dump(), ", but this one has extent ",
                  Json(scene.extent).dump(), remedy);
    }
  } catch (const nlohmann::json::exception& error) {
    input_error(place, ": invalid checkpoint header: ", error.what());
  }
}

void check_resume_options(const TrainConfig& saved, int iteration, const TrainConfig& wanted,
                          const std::string& place) {
  if (saved.sh_degree != wanted.sh_degree) {
    input_error(place, ": SH degree ", saved.sh_degree, ", but --sh_degree is ", wanted.sh_degree,
                "; resume with the same degree");
  }
  if (iteration > wanted.iterations) {
    input_error(place, ": iteration ", iteration, " is beyond --iterations ", wanted.iterations,
                "; give a larger --iterations");
  }
}

std::vector<std::string> changed_photographs(const Json& header, const Json& fingerprint) {
  std::vector<std::string> names;
  const Json saved = header.value("scene", Json::object()).value("photographs", Json::array());
  const Json &now = fingerprint.at("photographs"), &views = fingerprint.at("train_views");
  for (std::size_t i = 0; i < std::min(saved.size(), now.size()); ++i) {
    if (!saved[i].is_null() && saved[i] != now[i]) names.push_back(views[i].at("name").get<std::string>());
  }
  return names;
}

Json checkpoint_header(const TrainConfig& config, const TrainState& state, const Json& fingerprint) {
  Json header{{"iteration", state.iteration},
              {"n_gaussians", state.gaussians.size()},
              {"sh_degree", state.sh_degree},
              {"adam_steps", state.adam.steps},
              {"view_order", {{"n_refills", state.view_order.n_refills}, {"remaining", state.view_order.remaining}}},
              {"loss_average", state.loss_average},
              {"elapsed_s", state.elapsed_s},
              {"training_id", state.training_id},
              {"is_density_pending", state.is_density_pending},
              {"n_removed", state.n_removed},
              {"held_at", state.held_at},
              {"kernel_selection", state.kernel_selection},
              {"config", config_to_json(config)},
              {"scene", fingerprint}};
  if (state.step_iterations != 1) header["step_iterations"] = state.step_iterations;
  if (!state.view_skips.views.empty()) header["view_skips"] = skips_to_json(state.view_skips);
  if (state.appearance.is_defined()) header["appearance_steps"] = state.appearance.steps;
  if (state.background.is_defined()) header["background_steps"] = state.background.steps;
  if (state.appearance.grids.defined()) header["appearance_last_steps"] = state.appearance.last_steps;
  return header;
}

std::vector<std::pair<std::string, torch::Tensor>> checkpoint_tensors(const TrainState& state) {
  std::vector<std::pair<std::string, torch::Tensor>> tensors;
  // Poses are in host memory, but the tensors of a checkpoint are written from one device.
  visit_tensors(state, [&](const std::string& name, const torch::Tensor& t) {
    tensors.emplace_back(name, is_of_poses(name) ? t.to(state.gaussians.means.device()) : t);
  });
  return tensors;
}

void write_checkpoint(const std::filesystem::path& path, const TrainConfig& config, const TrainState& state,
                      const Scene& scene) {
  write_checkpoint_file(path, {checkpoint_header(config, state, scene_fingerprint(scene)), checkpoint_tensors(state)});
}

Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device) {
  const std::string place = path.string();
  CheckpointFile file = read_checkpoint_file(path);
  CheckpointHeader header = parse_checkpoint_header(file.header, place);
  check_scene(file.header, scene, place);
  Checkpoint checkpoint;
  checkpoint.config = std::move(header.config);
  TrainState& state = checkpoint.state;
  state.iteration = header.iteration;
  state.step_iterations = header.step_iterations;
  state.sh_degree = header.sh_degree;
  state.adam.steps = header.adam_steps;
  state.view_order = std::move(header.view_order);
  state.view_skips = std::move(header.view_skips);
  state.loss_average = header.loss_average;
  state.elapsed_s = header.elapsed_s;
  state.training_id = std::move(header.training_id);
  state.is_density_pending = header.is_density_pending;
  state.n_removed = header.n_removed;
  state.held_at = header.held_at;
  state.appearance.steps = header.appearance_steps;
  state.appearance.last_steps = std::move(header.appearance_last_steps);
  state.kernel_selection = std::move(header.kernel_selection);
  // Which columns of statistics a checkpoint holds depends on the strategy.
  state.statistics =
      make_density_strategy(checkpoint.config, scene.extent)->make_statistics(/*n_gaussians=*/0, torch::kCPU);
  const auto holds = [&](const std::string& name) {
    return std::any_of(file.tensors.begin(), file.tensors.end(), [&](const auto& t) { return t.first == name; });
  };
  if (holds("gaussians.filters")) state.gaussians.filters = torch::empty({0}, torch::kFloat32);
  if (holds(kCorrections)) state.poses = PoseState::make(/*n_views=*/0);
  if (holds("background.coefficients")) {
    state.background.coefficients = torch::empty({0}, torch::kFloat32);
    state.background.steps = header.background_steps;
  }
  for (const auto& [name, parameters] :
       {std::pair{"exposures", &state.appearance.exposures}, std::pair{"grids", &state.appearance.grids}}) {
    if (!holds(kAppearance + name)) continue;
    for (torch::Tensor* tensor : {parameters, &state.appearance.m, &state.appearance.v}) {
      *tensor = torch::empty({0}, torch::kFloat32);
    }
  }
  if (state.appearance.grids.defined() && state.appearance.last_steps.size() != scene.train.size()) {
    input_error(place, ": appearance_last_steps has ", state.appearance.last_steps.size(), " values, expected ",
                scene.train.size());
  }
  std::size_t next = 0;
  visit_tensors(state, [&](const std::string& name, torch::Tensor& tensor) {
    if (next == file.tensors.size() || file.tensors[next].first != name) {
      input_error(place, ": tensor ", name, " is missing",
                  next < file.tensors.size() ? ", found " + file.tensors[next].first : std::string());
    }
    tensor = file.tensors[next++].second;
  });
  if (next != file.tensors.size()) input_error(place, ": unknown tensor ", file.tensors[next].first);
  check_shapes(state, header.n_gaussians, checkpoint.config, static_cast<std::int64_t>(scene.train.size()), place);
  check_values(state, place);
  visit_tensors(state, [&](const std::string& name, torch::Tensor& tensor) {
    if (!is_of_poses(name)) tensor = tensor.to(device);
  });
  return checkpoint;
}

void remove_superseded_checkpoints(const ModelFolder& folder, const std::string& training_id, int iteration, int keep) {
  std::vector<std::filesystem::path> own;  // the newest first
  const std::vector<int> iterations = folder.checkpoint_iterations();
  for (auto it = iterations.rbegin(); it != iterations.rend(); ++it) {
    if (*it > iteration) continue;
    try {
      const Json header = read_checkpoint_header(folder.checkpoint(*it));
      const std::string other = header.value("training_id", "");
      if (other.empty() || other == training_id) own.push_back(folder.checkpoint(*it));
    } catch (const std::exception&) {
      continue;  // damaged: it cannot be told which training wrote it
    }
  }
  for (std::size_t i = static_cast<std::size_t>(keep); i < own.size(); ++i) {
    std::error_code error;  // ignored: a superseded checkpoint that stays does no harm
    std::filesystem::remove(own[i], error);
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
      if (on_message) on_message(std::string("skipped damaged checkpoint: ") + error.what());
    }
  }
  return {};
}

}  // namespace b3dgs
