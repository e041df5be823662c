#include "train/checkpoint/checkpoint.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <set>
#include <utility>

#include "config/train_options.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "train/appearance/appearance_kernels.h"
#include "train/density/density_strategy.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

// Placeholders for sizes that differ from training to training: Gaussians, training views, SH coefficients above degree
// 0.
constexpr std::int64_t kGaussians = -1, kViews = -2, kRest = -3;

/// In which files a tensor is present.
enum class Presence {
  kAlways,
  kLeads,    // in some files, where it means that a part of the state is present
  kFollows,  // in files with a leading tensor of the same part, which is the name up to the dot
};

enum class Values { kAny, kNotNegative, kFinite };

/// Description of a tensor of the state.
struct Row {
  std::string name;  // name in the file
  torch::Tensor* tensor = nullptr;
  Presence presence = Presence::kAlways;
  std::vector<std::int64_t> shape;
  Values values = Values::kAny;
  torch::ScalarType type = torch::kFloat32;
  bool is_on_host = false;  // even if the Gaussians are on a GPU

  std::string part() const { return name.substr(0, name.find('.')); }
};

/// Returns all tensors of a state, in file order.
std::vector<Row> rows_of(TrainState& state) {
  using Shape = std::vector<std::int64_t>;
  constexpr Presence kAlways = Presence::kAlways, kLeads = Presence::kLeads, kFollows = Presence::kFollows;
  constexpr Values kAny = Values::kAny, kNotNegative = Values::kNotNegative, kFinite = Values::kFinite;
  std::vector<Row> rows;
  const auto add_groups = [&](const std::string& prefix, auto& groups, Values values) {
    const Shape shapes[]{{kGaussians, 3}, {kGaussians, 3},    {kGaussians, 4},
                         {kGaussians},    {kGaussians, 1, 3}, {kGaussians, kRest, 3}};
    for (std::size_t i = 0; i < groups.kNames.size(); ++i) {
      rows.push_back({prefix + groups.kNames[i], groups.all()[i], kAlways, shapes[i], values});
    }
  };
  add_groups("gaussians.", state.gaussians, kAny);
  add_groups("adam_m.", state.adam.m, kAny);
  add_groups("adam_v.", state.adam.v, kNotNegative);
  const std::vector<std::string> columns = state.statistics.names();
  for (std::size_t i = 0; i < columns.size(); ++i) {
    Row row{"statistics." + columns[i], state.statistics.all()[i], kAlways, {kGaussians}};
    if (columns[i] == "view_count" || columns[i] == "max_radii") row.type = torch::kInt32;
    if (columns[i] == "grad_norm_sum" || row.type == torch::kInt32) row.values = kNotNegative;
    rows.push_back(row);
  }
  // Tensors that only some trainings have.
  constexpr torch::ScalarType kFloat = torch::kFloat32, kInt = torch::kInt32;
  constexpr bool kOnHost = true;
  const Shape pose{kViews, kCameraGradients}, exposures{kViews, 3, 4},
      grids{kViews, kGridLevels, kGridHeight, kGridWidth, kTransformSize},
      transforms = state.appearance.grids.defined() ? grids : exposures;
  const Row optional[]{
      {"gaussians.filters", &state.gaussians.filters, kLeads, {kGaussians}},
      {"adam.directions", &state.adam.directions, kLeads, {kGaussians, 4}},
      {"poses.corrections", &state.poses.corrections, kLeads, pose, kFinite, kFloat, kOnHost},
      {"poses.adam_m", &state.poses.adam_m, kFollows, pose, kAny, kFloat, kOnHost},
      {"poses.adam_v", &state.poses.adam_v, kFollows, pose, kNotNegative, kFloat, kOnHost},
      {"poses.steps", &state.poses.steps, kFollows, {kViews}, kNotNegative, kInt, kOnHost},
      {"appearance.exposures", &state.appearance.exposures, kLeads, exposures},
      {"appearance.grids", &state.appearance.grids, kLeads, grids},
      {"appearance.m", &state.appearance.m, kFollows, transforms},
      {"appearance.v", &state.appearance.v, kFollows, transforms, kNotNegative},
  };
  rows.insert(rows.end(), std::begin(optional), std::end(optional));
  return rows;
}

/// Returns the defined tensors of a state, in file order.
std::vector<Row> defined_rows(const TrainState& state) {
  std::vector<Row> rows = rows_of(const_cast<TrainState&>(state));
  rows.erase(std::remove_if(rows.begin(), rows.end(), [](const Row& row) { return !row.tensor->defined(); }),
             rows.end());
  return rows;
}

/// Moves the tensors of a file into the state. @throws InputError unless they are the tensors of a state, in file order
void take_tensors(std::vector<std::pair<std::string, torch::Tensor>>& tensors, TrainState& state,
                  const std::string& place) {
  std::set<std::string> parts;
  std::size_t next = 0;
  for (const Row& row : rows_of(state)) {
    if (row.presence == Presence::kFollows && parts.count(row.part()) == 0) continue;
    if (next < tensors.size() && tensors[next].first == row.name) {
      *row.tensor = std::move(tensors[next++].second);
      parts.insert(row.part());
    } else if (row.presence != Presence::kLeads) {
      input_error(place, ": tensor ", row.name, " is missing",
                  next < tensors.size() ? ", found " + tensors[next].first : std::string());
    }
  }
  if (next != tensors.size()) input_error(place, ": unknown tensor ", tensors[next].first);
}

/// Checks the tensors of a state, which are on the CPU. @throws InputError unless they have the shapes and types that
/// header and config imply, or if a count or a sum of squares is negative
void check_tensors(const TrainState& state, std::int64_t n, const TrainConfig& config, std::int64_t n_views,
                   const std::string& place) {
  if (state.appearance.exposures.defined() && state.appearance.grids.defined()) {
    input_error(place, ": has both exposures and bilateral grids, expected one of them; the file is damaged");
  }
  const std::map<std::int64_t, std::int64_t> sizes{
      {kGaussians, n}, {kViews, n_views}, {kRest, sh_coefficient_count(config.sh_degree) - 1}};
  for (const Row& row : defined_rows(state)) {
    const torch::Tensor& tensor = *row.tensor;
    std::vector<std::int64_t> wanted = row.shape;
    for (std::int64_t& size : wanted) {
      if (size < 0) size = sizes.at(size);
    }
    if (tensor.sizes() != torch::IntArrayRef(wanted) || tensor.scalar_type() != row.type) {
      input_error(place, ": tensor ", row.name, " is ", tensor.sizes(), " ", tensor.scalar_type(), ", expected ",
                  torch::IntArrayRef(wanted), " ", row.type);
    }
    if (row.values == Values::kNotNegative) {
      const torch::Tensor values = tensor.flatten(), negative = torch::nonzero(values < 0);
      if (negative.numel() == 0) continue;
      const auto index = negative[0].item<std::int64_t>();
      input_error(place, ": tensor ", row.name, ": expected values of at least 0, found ", values[index].item<double>(),
                  " at index ", index, "; resume from another checkpoint");
    } else if (row.values == Values::kFinite && !torch::isfinite(tensor).all().item<bool>()) {
      input_error(place, ": tensor ", row.name, " has values that are not finite");
    }
  }
}

}  // namespace

void check_resume_options(const TrainConfig& saved, int iteration, const TrainConfig& wanted,
                          const std::string& place) {
  if (saved.sh_degree != wanted.sh_degree) {
    input_error(place, ": SH degree ", saved.sh_degree, ", but --sh_degree is ", wanted.sh_degree,
                "; resume with the same degree");
  }
  if (iteration > wanted.iterations) {
    input_error(place, ": iteration ", iteration, " is beyond --iterations ", wanted.iterations,
                "; pass a larger --iterations", wanted.max_epochs > 0 ? " or --max_epochs" : "");
  }
}

Json checkpoint_header(const TrainConfig& config, const TrainState& state, const Json& fingerprint) {
  Json header{{"iteration", state.iteration},
              {"n_gaussians", state.n_gaussians()},
              {"sh_degree", state.sh_degree},
              {"adam_steps", state.adam.steps},
              {"view_order", {{"n_refills", state.view_order.n_refills}, {"remaining", state.view_order.remaining}}},
              {"loss_average", state.loss_average},
              {"elapsed_s", state.elapsed_s},
              {"training_id", state.training_id},
              {"step_iterations", state.step_iterations},
              {"n_density_pending", state.n_density_pending},
              {"n_removed", state.n_removed},
              {"count_cap", state.count_cap},
              {"kernel_selection", state.kernel_selection},
              {"config", config_to_json(config)},
              {"scene", fingerprint}};
  // With several ranks, each has its own ratios, which are not saved.
  if (!state.n_of_all_ranks && !state.view_ratios.is_empty()) header["view_ratios"] = ratios_to_json(state.view_ratios);
  if (state.appearance.is_defined()) header["appearance_steps"] = state.appearance.steps;
  if (state.appearance.grids.defined()) header["appearance_last_steps"] = state.appearance.last_steps;
  return header;
}

std::vector<CheckpointTensor> checkpoint_tensors(const TrainState& state) {
  std::vector<CheckpointTensor> tensors;
  for (const Row& row : defined_rows(state)) {
    // All tensors of a checkpoint must be on one device to be written.
    tensors.push_back({{row.name, row.tensor->scalar_type(), row.tensor->sizes().vec()},
                       row.is_on_host ? row.tensor->to(state.gaussians.means.device()) : *row.tensor});
  }
  return tensors;
}

std::int64_t checkpoint_bytes(const TrainState& state) {
  std::int64_t bytes = 0;
  for (const Row& row : defined_rows(state)) {
    bytes += row.tensor->element_size() * row_elements(*row.tensor) *
             (row.shape.front() == kGaussians ? state.n_gaussians() : row.tensor->size(0));
  }
  return bytes;
}

Checkpoint read_checkpoint(const std::filesystem::path& path, const Scene& scene, torch::Device device) {
  const std::string place = path.string();
  CheckpointFile file = read_checkpoint_file(path);
  CheckpointHeader header = parse_checkpoint_header(file.header, place);
  check_scene(file.header, scene, place);
  Checkpoint checkpoint;
  checkpoint.config = std::move(header.config);
  TrainState& state = checkpoint.state;
  static_cast<StateValues&>(state) = header;
  state.adam.steps = header.adam_steps;
  state.appearance.steps = header.appearance_steps;
  state.appearance.last_steps = std::move(header.appearance_last_steps);
  checkpoint.header = std::move(file.header);
  // The columns of statistics in a checkpoint depend on the strategy.
  state.statistics =
      make_density_strategy(checkpoint.config, scene.extent)->make_statistics(/*n_gaussians=*/0, torch::kCPU);
  take_tensors(file.tensors, state, place);
  if (state.appearance.grids.defined() && state.appearance.last_steps.size() != scene.train.size()) {
    input_error(place, ": appearance_last_steps has ", state.appearance.last_steps.size(), " values, expected ",
                scene.train.size());
  }
  check_tensors(state, header.n_gaussians, checkpoint.config, static_cast<std::int64_t>(scene.train.size()), place);
  for (const Row& row : defined_rows(state)) {
    if (!row.is_on_host) *row.tensor = row.tensor->to(device);
  }
  return checkpoint;
}

namespace {

/// Returns whether --checkpoint_iterations of the training that wrote the checkpoint names an iteration of its last
/// step.
bool was_requested(const Json& header) {
  const int last = header.at("iteration"), n = header.at("step_iterations");
  const auto requested = header.at("config").at("checkpoint_iterations").get<std::vector<int>>();
  return std::any_of(requested.begin(), requested.end(), [&](int own) { return last - n < own && own <= last; });
}

}  // namespace

void remove_superseded_checkpoints(const ModelFolder& folder, const std::string& training_id, int iteration, int keep) {
  std::vector<std::filesystem::path> own;  // the newest first
  const std::vector<int> iterations = folder.checkpoint_iterations();
  for (auto it = iterations.rbegin(); it != iterations.rend(); ++it) {
    if (*it > iteration) continue;
    try {
      const Json header = read_checkpoint_header(folder.checkpoint(*it));
      const std::string other = header.value("training_id", "");
      if ((other.empty() || other == training_id) && !was_requested(header)) own.push_back(folder.checkpoint(*it));
    } catch (const std::exception&) {
      continue;  // damaged, so the training that wrote it is unknown
    }
  }
  for (std::size_t i = static_cast<std::size_t>(keep); i < own.size(); ++i) remove_own_file(own[i]);
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
