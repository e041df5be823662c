// Data of single iterations in a model folder: results of evaluations, and moving all of it aside.
#include <algorithm>
#include <sstream>
#include <system_error>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/files/json_file.h"
#include "core/files/own_files.h"
#include "core/json_text.h"
#include "core/text.h"
#include "model/model_folder.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

/// Returns the contents of a results file. Damaged and missing ones are empty, because views can be evaluated again.
Json read_results(const fs::path& path) {
  Json json = read_json(path);
  return json.is_object() ? json : Json::object();
}

Json to_json(const EvaluationSource& source) {
  return {{"split", source.split},           {"width", source.width},   {"height", source.height},
          {"resolution", source.resolution}, {"images", source.images}, {"source_path", source.source_path}};
}

/// Returns N for "ours_N" and "ours_N_VARIANT"; -1 for other names.
int iteration_of(const std::string& name) {
  const auto [iteration, rest] = numbered_name(name, "ours_");
  return rest.empty() || rest.front() == '_' ? iteration : -1;
}

/// Returns checkpoints, PLYs and folders of renders of later iterations.
std::vector<fs::path> later_files(const ModelFolder& folder, int iteration) {
  std::vector<fs::path> files;
  // The newest comes first. If this is interrupted, no remaining checkpoint is newer than a moved one.
  std::vector<int> checkpoints = folder.checkpoint_iterations();
  std::reverse(checkpoints.begin(), checkpoints.end());
  for (const int own : checkpoints) {
    if (own > iteration) files.push_back(folder.checkpoint(own));
  }
  for (const int own : folder.ply_iterations()) {
    if (own > iteration) files.push_back(folder.ply(own).parent_path());
  }
  for (const fs::path& set : folder.image_sets()) {
    std::error_code error;
    for (fs::directory_iterator it(set, error), end; !error && it != end; it.increment(error)) {
      if (iteration_of(it->path().filename().string()) > iteration) files.push_back(it->path());
    }
  }
  return files;
}

/// Returns the log's lines of later iterations.
std::string later_lines(const fs::path& log, int iteration) {
  std::string lines;
  std::istringstream file(read_file_if_there(log).value_or(""));
  for (std::string line; std::getline(file, line);) {
    const Json json = parse_json(line);
    const bool is_line = json.is_object() && json.contains("iteration") && json["iteration"].is_number_integer();
    if (is_line && json["iteration"].get<std::int64_t>() > iteration) lines += line + "\n";
  }
  return lines;
}

}  // namespace

EvaluationSource evaluation_source(const TrainConfig& config, const std::vector<View>& views,
                                   const std::string& split) {
  EvaluationSource source{config.source_path, config.images, config.resolution, 0, 0, split};
  for (const View& view : views) {
    source.width = std::max(source.width, view.camera.width);
    source.height = std::max(source.height, view.camera.height);
  }
  return source;
}

std::string ModelFolder::results_key(int iteration, const std::string& variant, const EvaluationSource& source) const {
  const std::string own = "ours_" + std::to_string(iteration);
  if (variant.empty()) return own;
  const Json results = read_results(root_ / "results.json"), wanted = to_json(source);
  const auto is_free = [&](const std::string& key) {
    if (!results.contains(key) || !results[key].is_object()) return true;
    for (const auto& [name, value] : wanted.items()) {
      if (results[key].value(name, Json()) != value) return false;
    }
    return true;
  };
  std::string key = own + "_" + variant;
  for (int n = 2; !is_free(key); ++n) key = own + "_" + variant + "_" + std::to_string(n);
  return key;
}

std::string describe_quality(int iteration, const Evaluation& evaluation) {
  const ImageQuality& mean = evaluation.mean;
  std::string text = print_to_string("iteration %d: PSNR %.2f dB, SSIM %.4f, sharpness %.2f on %s%zu test views",
                                     iteration, mean.psnr, mean.ssim, mean.sharpness,
                                     evaluation.fits_left_half ? "the right half of " : "", evaluation.views.size());
  if (!evaluation.unmeasured.empty()) {
    text += "; " + std::to_string(evaluation.unmeasured.size()) +
            " without a valid pixel (first: " + evaluation.unmeasured.front() + ")";
  }
  return text;
}

void ModelFolder::check_results() const {
  for (const fs::path& path : results()) read_results(path);
}

void ModelFolder::write_results(const std::string& key, const Evaluation& evaluation,
                                const EvaluationSource& source) const {
  const auto [results_path, per_view_path] = results();
  const FolderTurn turn(root_);
  Json means = read_results(results_path), per_view = read_results(per_view_path);
  means[key] = {{"SSIM", evaluation.mean.ssim},
                {"PSNR", evaluation.mean.psnr},
                {"sharpness", evaluation.mean.sharpness},
                {"views", evaluation.views.size()}};
  means[key].update(to_json(source));
  if (!evaluation.unmeasured.empty()) means[key]["views_without_pixels"] = evaluation.unmeasured;
  const auto of_views = [&](auto&& value) {
    Json json = Json::object();
    for (const ViewQuality& view : evaluation.views) json[view.name] = value(view.quality);
    return json;
  };
  per_view[key] = {{"SSIM", of_views([](const ImageQuality& quality) { return quality.ssim; })},
                   {"PSNR", of_views([](const ImageQuality& quality) { return quality.psnr; })},
                   {"sharpness", of_views([](const ImageQuality& quality) { return quality.sharpness; })}};
  if (evaluation.fits_left_half) means[key]["train_test_exp"] = true;
  if (evaluation.mean.corrected_psnr) {
    means[key]["CC_PSNR"] = *evaluation.mean.corrected_psnr;
    per_view[key]["CC_PSNR"] = of_views([](const ImageQuality& quality) { return quality.corrected_psnr.value(); });
  }
  if (evaluation.mean.lpips) {
    means[key]["LPIPS"] = *evaluation.mean.lpips;
    means[key]["lpips_network"] = evaluation.lpips_network;
    per_view[key]["LPIPS"] = of_views([](const ImageQuality& quality) { return quality.lpips.value(); });
  }
  write_json_file(results_path, means);
  write_json_file(per_view_path, per_view);
}

fs::path set_aside_after(const ModelFolder& folder, int iteration) {
  struct Results {
    fs::path path;
    Json kept = Json::object(), later = Json::object();  // entries up to the iteration, and those after it
  };
  const FolderTurn turn(folder.root());
  std::vector<Results> results;
  bool has_results = false;
  for (const fs::path& path : folder.results()) {
    Results& own = results.emplace_back(Results{path});
    const Json all = read_results(path);
    for (const auto& [key, value] : all.items()) (iteration_of(key) > iteration ? own.later : own.kept)[key] = value;
    has_results = has_results || !own.later.empty();
  }
  std::vector<fs::path> files = later_files(folder, iteration);
  const std::string lines = later_lines(folder.log(), iteration);
  if (files.empty() && !has_results && lines.empty()) return {};

  fs::path aside;
  for (int i = 1; aside.empty() || fs::exists(aside); ++i) {
    aside = folder.root() / "set_aside" / detail::concat("after_iteration_", iteration, "_", i);
  }
  create_folder(aside);
  for (const Results& own : results) {
    if (own.later.empty()) continue;
    write_json_file(aside / own.path.filename(), own.later);
    write_json_file(own.path, own.kept);
  }
  if (!lines.empty()) write_file(aside / folder.log().filename(), lines);
  for (const char* report : {"report", "report.html"}) {
    if (fs::exists(folder.root() / report)) files.insert(files.begin(), folder.root() / report);
  }
  for (const fs::path& path : files) {
    const fs::path to = aside / path.lexically_relative(folder.root());
    create_folder(to.parent_path());
    OwnFiles(folder.root()).move(path, to);
  }
  return aside;
}

}  // namespace b3dgs
