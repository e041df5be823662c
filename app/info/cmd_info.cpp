// b3dgs info: describes a scene folder, a model folder, a PLY or a checkpoint.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "app/common/commands.h"
#include "app/common/single_option.h"
#include "app/common/status_line.h"
#include "app/report/train_report.h"
#include "config/option_layers.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/file_reader.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "model/checkpoint/checkpoint_header.h"
#include "model/edit/edit.h"
#include "model/formats/splat_formats.h"
#include "model/model_folder.h"
#include "scene/scene.h"
#include "scene/scene_model.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Prints text of a file, which may contain line breaks and terminal escape sequences.
void print_text(const std::string& line) {
  std::puts(detail::one_line(line).c_str());
}

template <class... Args>
void print_row(const char* name, const char* format, Args... args) {
  print_text(print_to_string("%-18s", name) + print_to_string(format, args...));
}

/// Returns the 1st, 50th and 99th percentile.
std::array<double, 3> quantiles(std::vector<double> values) {
  if (values.empty()) return {};
  std::sort(values.begin(), values.end());
  const auto at = [&](double share) {
    return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
  };
  return {at(0.01), at(0.5), at(0.99)};
}

/// Prints the bounds of world coordinates, [N, 3].
void print_bounds(const std::vector<double>& positions) {
  constexpr const char* kAxes[3] = {"x", "y", "z"};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (std::size_t i = axis; i < positions.size(); i += 3) values.push_back(positions[i]);
    const std::array<double, 3> q = quantiles(std::move(values));
    const bool is_far = std::abs(q[1]) > 1000 * (q[2] - q[0]);
    print_row(kAxes[axis], is_far ? "%.10g  (%.10g to %.10g)" : "%.4g  (%.4g to %.4g)", q[1], q[0], q[2]);
  }
}

void describe_splats(const std::string& path) {
  const SplatCloud cloud = read_splats(path);
  std::printf("%s: Gaussians; median (1st to 99th percentile)\n", path.c_str());
  print_row("Gaussians", "%s", format_count(cloud.size()).c_str());
  print_row("SH degree", "%d", cloud.sh_degree);
  for (const std::string& note : cloud.notes) print_row("note", "%s", note.c_str());
  if (cloud.size() == 0) return;
  std::vector<double> opacities, scales, shapes;
  for (std::size_t i = 0; i < static_cast<std::size_t>(cloud.size()); ++i) {
    opacities.push_back(opacity_of(cloud, i));
    const float* s = &cloud.log_scales[3 * i];
    const auto [least, most] = std::minmax({s[0], s[1], s[2]});
    scales.push_back(cloud.frame.unit * std::exp(static_cast<double>(most)));
    shapes.push_back(std::exp(static_cast<double>(most) - least));
  }
  print_bounds(world_positions(cloud));
  const auto print = [](const char* name, std::vector<double> values) {
    const std::array<double, 3> q = quantiles(std::move(values));
    print_row(name, "%.3g  (%.3g to %.3g)", q[1], q[0], q[2]);
  };
  print("opacity", std::move(opacities));
  print("longest scale", std::move(scales));
  print("longest/shortest", std::move(shapes));
}

void describe_points(const std::string& path) {
  const WorldPoints points = read_point_ply(path);
  std::printf("%s: points; median (1st to 99th percentile)\n", path.c_str());
  print_row("points", "%s", format_count(points.size()).c_str());
  if (!points.left_out.empty()) print_text("warning: " + points.left_out);
  if (points.size() > 0) print_bounds(points.positions);
}

/// Prints options without paths and device, which are shown elsewhere or depend on the machine.
void print_options(const TrainConfig& config) {
  const nlohmann::ordered_json defaults = config_to_json(preset_options(config)), effective = config_to_json(config);
  std::vector<std::string> lines;
  for (const auto& [name, value] : effective.items()) {
    if (value == defaults.at(name) || name == "source_path" || name == "model_path" || name == "device") continue;
    lines.push_back(print_to_string("  %-24s", name.c_str()) + option_value_text(value));
  }
  const TrainConfig own = resolve_options({{"preset", config.preset}}).config;
  const std::string strategy = own.strategy == config.strategy ? "" : " --strategy " + name_of(config.strategy);
  std::printf("options %s --preset %s%s%s\n", lines.empty() ? "are those of" : "that differ from",
              config.preset.c_str(), strategy.c_str(), lines.empty() ? "" : ":");
  for (const std::string& line : lines) print_text(line);
}

void describe_model(const std::string& path) {
  const ModelFolder folder(path);
  const std::vector<int> saved = folder.ply_iterations();
  if (!folder.has_config() && !saved.empty()) return describe_splats(folder.ply(saved.back()).string());
  const TrainConfig config = folder.read_config();
  print_text(path + ": model of " + config.source_path);
  const auto list = [](const std::vector<int>& iterations) {
    return iterations.empty() ? "none" : list_text(iterations);
  };
  print_row("iterations", "%d", config.iterations);
  print_row("saved", "%s", list(saved).c_str());
  print_row("checkpoints", "%s", list(folder.checkpoint_iterations()).c_str());
  print_row("test views", "%s", config.eval ? "held out (--eval)" : "none");
  print_options(config);
  const std::string floaters = floaters_text(read_train_log(folder.log()));
  if (!floaters.empty()) print_row("floaters", "possible: %s; see docs/recipes.md#floaters", floaters.c_str());
  if (!saved.empty()) describe_splats(folder.ply(saved.back()).string());
}

void describe_scene(const std::string& path) {
  SceneOptions options;
  options.source_path = path;
  options.lenses = TrainConfig{}.lenses;
  options.load_images = false;
  StatusLine status = StatusLine::for_stderr(/*quiet=*/true);
  const Scene scene = open_scene(options, status);
  for (const std::string& line : scene.summary) std::printf("%s\n", line.c_str());
}

void describe_checkpoint(const std::string& path) {
  verify_checkpoint_file(path);
  const nlohmann::ordered_json header = read_checkpoint_header(path);
  std::printf("%s: checkpoint, checksums valid\n", path.c_str());
  print_row("size", "%s", format_bytes(static_cast<std::int64_t>(fs::file_size(path))).c_str());
  if (!header.contains("config")) return;
  const CheckpointHeader training = parse_checkpoint_header(header, path);
  print_row("scene", "%s", training.config.source_path.c_str());
  print_row("iteration", "%d of %d", training.iteration, training.config.iterations);
  print_row("Gaussians", "%s", format_count(training.n_gaussians).c_str());
  if (training.count_cap > 0)
    print_row("capped at", "%s for lack of GPU memory", format_count(training.count_cap).c_str());
  print_row("SH degree", "%d of %d", training.sh_degree, training.config.sh_degree);
  print_row("loss", "%.4f, running average", training.loss_average);
  print_row("training time", "%s", format_duration(training.elapsed_s).c_str());
  if (!training.training_id.empty()) print_row("training ID", "%s", training.training_id.c_str());
  print_options(training.config);
}

void describe_folder(const std::string& path) {
  const fs::path folder = path;
  if (ModelFolder(folder).has_config() || fs::exists(folder / "point_cloud")) return describe_model(path);
  if (fs::exists(folder / "sparse") || holds_scene(folder)) return describe_scene(path);
  input_error("neither a scene nor a model folder: ", path, " (expected sparse/, transforms.json or config.json); ",
              "`b3dgs reconstruct PHOTOS SCENE` makes a scene from photographs");
}

}  // namespace

int run_info(const std::vector<std::string>& words) {
  CommandLine line("info", "Describe a scene folder, model folder, file of Gaussians or checkpoint.",
                   "b3dgs info output/garden");
  SingleOption<std::string> input{
      {"input"}, "", "scene folder, model folder, file of Gaussians (.ply, .spz), points or checkpoint"};
  line.add(input, "Input", {"input"});
  if (!line.parse(words)) return 0;
  const std::string& path = input.value;
  if (path.empty()) input_error("missing argument: INPUT; usage: b3dgs info INPUT");

  if (!fs::exists(path)) input_error("file or folder not found: ", path);
  if (fs::is_directory(path)) {
    describe_folder(path);
    return 0;
  }
  FileReader file(path);
  std::string start(std::min<std::uint64_t>(8, file.remaining()), '\0');  // identifies the format
  file.read_bytes(start.data(), start.size());
  if (start == "B3DGSCKP") {
    describe_checkpoint(path);
  } else if (start.compare(0, 3, "ply") == 0 || splat_format(path)) {
    holds_splats(path) ? describe_splats(path) : describe_points(path);
  } else {
    input_error("unknown file format: ", path, " (expected a PLY, an SPZ or a b3dgs checkpoint); the program ",
                "splat-transform converts other files of Gaussians to PLY");
  }
  return 0;
}

}  // namespace b3dgs
