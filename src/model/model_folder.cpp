#include "model/model_folder.h"

#include <zlib.h>

#include <algorithm>
#include <charconv>
#include <random>
#include <system_error>

#include "config/option_layers.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/files/json_file.h"
#include "core/files/own_files.h"
#include "core/json_text.h"
#include "core/text.h"
#include "model/cameras/cameras_json.h"
#include "model/formats/splat_formats.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

/// Returns the iterations N of the files iteration_N in a folder, ascending; empty if the folder does not exist.
std::vector<int> list_iterations(const fs::path& folder, const std::string& suffix) {
  std::vector<int> iterations;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    const auto [iteration, rest] = numbered_name(it->path().filename().string(), "iteration_");
    if (iteration >= 0 && rest == suffix) iterations.push_back(iteration);
  }
  std::sort(iterations.begin(), iterations.end());
  return iterations;
}

/// Returns a Python string literal.
std::string python_string(const std::string& text) {
  std::string literal = "'";
  for (const char c : text) {
    if (c == '\\' || c == '\'') literal += '\\';
    literal += c;
  }
  return literal + "'";
}

/// Returns a namespace as Python prints it, for scripts of the original and the SIBR viewer.
std::string cfg_args(const TrainConfig& config) {
  const auto boolean = [](bool value) { return value ? "True" : "False"; };
  return detail::concat("Namespace(sh_degree=", config.sh_degree, ", source_path=", python_string(config.source_path),
                        ", model_path=", python_string(config.model_path), ", images=", python_string(config.images),
                        ", depths=", python_string(config.depths), ", resolution=", config.resolution,
                        ", white_background=", boolean(config.white_background),
                        ", train_test_exp=", boolean(config.train_test_exp),
                        ", data_device='cpu', eval=", boolean(config.eval), ")");
}

/// Returns null if there is none.
Json member_of(const fs::path& file, const char* name) {
  const Json json = read_json(file);
  return json.is_object() && json.contains(name) ? json[name] : Json();
}

}  // namespace

std::pair<int, std::string> numbered_name(const std::string& name, std::string_view prefix) {
  int number = -1;
  if (name.compare(0, prefix.size(), prefix) != 0) return {-1, ""};
  const char* const end = name.data() + name.size();
  const auto result = std::from_chars(name.data() + prefix.size(), end, number);
  return {number, std::string(result.ptr, end)};
}

void write_json_file(const fs::path& path, const Json& json, int indent) {
  write_file(path, dump_json(json, indent) + "\n");
}

std::vector<int> ModelFolder::ply_iterations() const {
  std::vector<int> iterations = list_iterations(root_ / "point_cloud", "");
  std::error_code error;  // ignored: files without a readable status are not overwritten
  const auto has_no_ply = [&](int i) { return fs::status(ply(i), error).type() == fs::file_type::not_found; };
  iterations.erase(std::remove_if(iterations.begin(), iterations.end(), has_no_ply), iterations.end());
  return iterations;
}

std::vector<int> ModelFolder::checkpoint_iterations() const {
  return list_iterations(root_ / "checkpoints", ".b3dgs");
}

std::string ModelFolder::training_id() const {
  const Json id = member_of(root_ / "training.json", "training_id");
  return id.is_string() ? id.get<std::string>() : "";
}

std::optional<double> ModelFolder::training_unit() const {
  const Json unit = member_of(root_ / "training.json", "unit");
  return unit.is_number() && unit > 0 ? std::optional(unit.get<double>()) : std::nullopt;
}

void ModelFolder::write_training(const std::string& id, double unit) const {
  write_json_file(root_ / "training.json", {{"training_id", id}, {"unit", unit}});
}

void ModelFolder::write_inputs(const TrainConfig& config, const Scene& scene) const {
  write_point_ply(root_ / "input.ply", scene.points, scene.frame);
  write_json_file(cameras(), cameras_to_json(scene.test, scene.train, scene.frame), -1);
  Json fingerprints = Json::object();
  for (const std::vector<View>* views : {&scene.train, &scene.test}) {
    for (const View& view : *views) fingerprints[view.name] = photograph_fingerprint(view.file);
  }
  write_json_file(photographs(), fingerprints, -1);
  write_file(root_ / "cfg_args", cfg_args(config));
  write_json_file(root_ / "config.json", config_to_json(config));
  if (scene.georeference) {
    write_georeference(root_, *scene.georeference);
  } else {
    clear(root_ / Georeference::kFile);
  }
}

void ModelFolder::write_poses(const Scene& scene, const std::vector<View>& refined_train) const {
  write_json_file(cameras(), cameras_to_json(scene.test, refined_train, scene.frame), -1);
  write_json_file(poses(), poses_to_json(scene.train, refined_train, scene.frame), 1);
}

void ModelFolder::clear(const fs::path& file) const {
  remove_own_file(file);
  make_way(file);
}

bool ModelFolder::has_config() const {
  return fs::exists(root_ / "config.json");
}

TrainConfig ModelFolder::read_config() const {
  const fs::path path = root_ / "config.json";
  if (!fs::exists(path)) {
    input_error(path.string(), ": cannot be opened; is ", root_.string(), " a model folder of b3dgs train?");
  }
  const Json json = read_json(path);
  if (json.is_discarded()) input_error(path.string(), ": not valid JSON; the file is damaged");
  TrainConfig config;
  config_from_json(config, json, path.string());
  return config;
}

bool may_continue_in(const ModelFolder& folder, const fs::path& checkpoint, const std::string& training_id) {
  if (!folder.holds_model()) return true;
  const std::string own = folder.training_id();
  if (!training_id.empty() && !own.empty()) return training_id == own;
  std::error_code error;
  return fs::equivalent(checkpoint.parent_path(), folder.checkpoint(0).parent_path(), error);
}

void check_training_id(const ModelFolder& folder, const fs::path& checkpoint, const std::string& training_id) {
  if (may_continue_in(folder, checkpoint, training_id)) return;
  input_error(folder.root().string(), ": holds the model of another training than ", checkpoint.string(),
              "; choose another folder with -m, or replace the model with --overwrite");
}

std::string claim_training_id(const ModelFolder& folder, const fs::path& checkpoint, const std::string& training_id) {
  if (!checkpoint.empty()) {
    check_training_id(folder, checkpoint, training_id);
  } else if (folder.holds_model()) {
    input_error(folder.root().string(), ": holds the model of another training; resume that one, or train into ",
                "another folder");
  }
  if (folder.holds_model() && !folder.training_id().empty()) return folder.training_id();
  std::random_device random;
  std::string id;
  for (int i = 0; i < 16; ++i) id += "0123456789abcdef"[random() % 16];
  return id;
}

std::int64_t free_disk_bytes(const fs::path& folder) {
  std::error_code error;
  const fs::space_info space = fs::space(folder, error);
  return error ? -1 : static_cast<std::int64_t>(space.available);
}

std::int64_t ply_bytes(std::int64_t n_gaussians, int sh_degree) {
  constexpr std::int64_t kFloatBytes = 4, kNormals = 3;
  const std::int64_t parameters = 11 + 3 * std::int64_t{sh_coefficient_count(sh_degree)};
  return kFloatBytes * n_gaussians * (parameters + kNormals);
}

std::string disk_warning(const fs::path& folder, std::int64_t free_bytes, const FirstFiles& files, int n_checkpoints) {
  const std::int64_t wanted = files.ply_bytes + (n_checkpoints + 1) * files.checkpoint_bytes;
  if (free_bytes < 0 || free_bytes >= wanted) return "";
  return detail::concat(
      folder.string(), ": ", format_bytes(free_bytes), " free on this disk, expected ", format_bytes(wanted),
      " or more: the size of a PLY and ", n_checkpoints + 1, " checkpoints of the ", files.n_gaussians,
      " Gaussians that training starts with, before densification; free some space, or ", "lower --max_gaussians");
}

Json photograph_fingerprint(const std::string& path) {
  constexpr std::size_t kPiece = std::size_t{64} << 10;
  // In these formats, a change of a pixel changes the size of the file or its end. PNG ends with a checksum of its
  // pixels.
  const std::string extension = lower_case(fs::path(path).extension().string());
  constexpr std::array<std::string_view, 4> kCompressed{".jpg", ".jpeg", ".png", ".webp"};
  const bool is_compressed = std::find(kCompressed.begin(), kCompressed.end(), extension) != kCompressed.end();
  std::error_code error;
  if (path.empty() || !fs::exists(path, error)) return nullptr;
  FileReader file(path);
  const std::uint64_t bytes = file.remaining();
  std::string piece(kPiece, '\0');
  const auto add_piece = [&](uLong crc) {
    const auto length = static_cast<std::size_t>(std::min<std::uint64_t>(kPiece, file.remaining()));
    file.read_bytes(piece.data(), length);
    return ::crc32_z(crc, reinterpret_cast<const Bytef*>(piece.data()), length);
  };
  const uLong start = add_piece(0);
  uLong rest = 0;
  if (bytes > 2 * kPiece && is_compressed) file.skip(bytes - 2 * kPiece);
  while (file.remaining() > 0) rest = add_piece(rest);
  return {{"bytes", bytes}, {"crc32", start}, {"rest_crc32", rest}};
}

bool is_same_photograph(const Json& before, const Json& now) {
  if (!before.is_object() || !now.is_object()) return before == now;
  return before.value("bytes", Json()) == now.value("bytes", Json()) &&
         before.value("crc32", Json()) == now.value("crc32", Json()) &&
         (!before.contains("rest_crc32") || before.at("rest_crc32") == now.value("rest_crc32", Json()));
}

std::vector<std::string> changed_views(const fs::path& file, const std::vector<View>& views) {
  const Json saved = read_json(file);
  std::vector<std::string> names;
  if (!saved.is_object()) return names;
  for (const View& view : views) {
    const Json before = saved.value(view.name, Json());
    if (!before.is_null() && !is_same_photograph(before, photograph_fingerprint(view.file))) {
      names.push_back(view.name);
    }
  }
  return names;
}

}  // namespace b3dgs
