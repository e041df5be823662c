#include "app/reconstruct/colmap_program.h"

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "core/check.h"
#include "core/text.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr const char* kInstall =
    "install it: apt install colmap (other systems: https://colmap.github.io/install.html)";

// Number of panoramas before and after each that it is matched with, if not with all. COLMAP's default is 10
// photographs.
constexpr std::size_t kNeighbours = 5;

// The option's name until COLMAP 3.12, and since then.
constexpr const char* kBlockOptions[] = {"ExhaustiveMatching.block_size", "ExhaustivePairing.block_size"};

// Models with larger IDs came with COLMAP 4.
constexpr int kNewestInAllVersions = static_cast<int>(CameraModel::kThinPrismFisheye);

/// Returns whether the name of a camera model occurs in the text as a separate word.
bool has_word(const std::string& text, const std::string& word) {
  const auto is_part = [](char c) { return c == '_' || std::isalnum(static_cast<unsigned char>(c)) != 0; };
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    const std::size_t end = at + word.size();
    if ((at == 0 || !is_part(text[at - 1])) && (end == text.size() || !is_part(text[end]))) return true;
  }
  return false;
}

std::vector<std::string> lines_of(const std::vector<std::string>& command, ProgramLog& log) {
  std::vector<std::string> lines;
  log.run(command, [&](const std::string& line) { lines.push_back(line); });
  return lines;
}

/// Returns the text after `words` in the line, or null if they are not in it.
const char* text_after(const std::string& line, const char* words) {
  const std::size_t at = line.find(words);
  return at == std::string::npos ? nullptr : line.c_str() + at + std::strlen(words);
}

}  // namespace

void check_colmap_is_installed() {
  if (find_program("colmap").empty()) {
    input_error("colmap was not found in PATH, which computes the cameras; ", kInstall);
  }
}

std::set<std::string> options_in_help(const std::vector<std::string>& lines) {
  std::set<std::string> options;
  for (const std::string& line : lines) {
    const std::size_t begin = line.find_first_not_of(' ');
    if (begin == std::string::npos || line.compare(begin, 2, "--") != 0) continue;
    options.insert(line.substr(begin + 2, line.find_first_of(" =", begin) - begin - 2));
  }
  return options;
}

ColmapProgram::ColmapProgram(const ReconstructOptions& options, ColmapFolders folders, ProgramLog& log)
    : options_(options), folders_(std::move(folders)), log_(log) {
  check_colmap_is_installed();
  bool is_version = true;  // until the first empty line
  for (const std::string& line : lines_of({"colmap", "-h"}, log)) {
    const std::size_t begin = line.find_first_not_of(' ');
    is_version = is_version && begin != std::string::npos && line.find("Usage") == std::string::npos;
    if (is_version) version_ += (version_.empty() ? "" : " ") + line.substr(begin);
    for (TextFields words(line); !words.empty();) commands_.emplace(words.word());
  }
  if (version_.find("COLMAP") == std::string::npos) {
    input_error("the program colmap in PATH (", find_program("colmap"), ") does not say that it is COLMAP; ", kInstall);
  }
  check_options();
}

void ColmapProgram::check_options() {
  if (options_.use_gpu == "1" && version_.find("without CUDA") != std::string::npos) {
    input_error("--use_gpu 1: the COLMAP in PATH (", find_program("colmap"), ", ", short_version(),
                ") was built without CUDA; leave --use_gpu out, or install a COLMAP with CUDA");
  }
  const CameraModel model = camera_model_from_name(options_.camera_model, "--camera_model");
  const bool has_faces = model == CameraModel::kEquirectangular;  // COLMAP gets the faces
  if (has_faces || static_cast<int>(model) <= kNewestInAllVersions) return;
  // Newer versions list the models in their help.
  std::string help;
  for (const std::string& line : lines_of({"colmap", "feature_extractor", "-h"}, log_)) help += line + "\n";
  const bool has_list = has_word(help, camera_model_name(CameraModel::kThinPrismFisheye));
  const bool is_known =
      has_list ? has_word(help, options_.camera_model) : std::atoi(text_after(short_version(), "COLMAP")) >= 4;
  if (!is_known) {
    input_error("--camera_model ", options_.camera_model, ": ", short_version(), " in PATH does not know it; ",
                "choose another model, such as OPENCV or OPENCV_FISHEYE, or install a newer COLMAP");
  }
}

std::string ColmapProgram::short_version() const {
  const std::size_t begin = version_.find("COLMAP");
  return version_.substr(begin, version_.find(' ', begin + 7) - begin);
}

bool ColmapProgram::uses_gpu() const {
  if (options_.use_gpu != "auto") return options_.use_gpu == "1";
  std::error_code error;
  const bool has_gpu = fs::exists("/dev/nvidia0", error) || fs::exists("/dev/dxg", error);  // the latter: WSL
  return has_gpu && version_.find("with CUDA") != std::string::npos;
}

const std::set<std::string>& ColmapProgram::options_of(const std::string& command) {
  const auto [known, is_new] = known_.try_emplace(command);
  if (is_new) known->second = options_in_help(lines_of({"colmap", command, "-h"}, log_));
  return known->second;
}

void ColmapProgram::add(std::vector<std::string>& command, const std::vector<std::string>& names,
                        const std::string& value) {
  const std::set<std::string>& known = options_of(command[1]);
  for (const std::string& name : names) {
    if (known.count(name) == 0) continue;
    command.push_back("--" + name);
    command.push_back(value);
    return;
  }
}

std::vector<std::string> ColmapProgram::begin(const std::string& command) const {
  return {"colmap", command, "--database_path", folders_.database.string()};
}

void ColmapProgram::add_device(std::vector<std::string>& command, const std::string& stage) {
  add(command, {"Feature" + stage + ".use_gpu", "Sift" + stage + ".use_gpu"}, uses_gpu() ? "1" : "0");
  if (options_.threads == 0) return;
  add(command, {"Feature" + stage + ".num_threads", "Sift" + stage + ".num_threads"}, std::to_string(options_.threads));
}

void ColmapProgram::use_faces(const std::string& params, std::size_t n_faces) {
  face_params_ = params;
  n_faces_ = n_faces;
}

std::vector<std::string> ColmapProgram::extract_command(const fs::path& list, bool is_single_camera,
                                                        std::optional<std::size_t> camera) {
  const std::string model = face_params_.empty() ? options_.camera_model : "PINHOLE";
  std::vector<std::string> command = begin("feature_extractor");
  command.insert(command.end(), {"--image_path", folders_.images.string(), "--image_list_path", list.string(),
                                 "--ImageReader.camera_model", model});
  if (!face_params_.empty()) add(command, {"ImageReader.camera_params"}, face_params_);
  const char* const sharing = is_single_camera                  ? "ImageReader.single_camera"
                              : options_.camera_per == "folder" ? "ImageReader.single_camera_per_folder"
                                                                : "ImageReader.single_camera_per_image";
  add(command, {sharing}, "1");
  if (camera) add(command, {"ImageReader.existing_camera_id"}, std::to_string(*camera));
  add_device(command, "Extraction");
  add(command, {"SiftExtraction.max_num_features"}, std::to_string(options_.max_features));
  return command;
}

std::vector<std::string> ColmapProgram::match_command(const std::string& matcher, std::size_t n_photographs) {
  std::vector<std::string> command = begin(matcher + "_matcher");
  add_device(command, "Matching");
  if (matcher == "exhaustive") {
    add(command, {kBlockOptions[0], kBlockOptions[1]}, std::to_string(pairs_block(n_photographs)));
  } else if (!face_params_.empty()) {
    add(command, {"SequentialMatching.overlap", "SequentialPairing.overlap"}, std::to_string(kNeighbours * n_faces_));
  }
  return command;
}

std::size_t ColmapProgram::pairs_block(std::size_t n_photographs) {
  // COLMAP reports its progress, and stores its results, once per block of pairs.
  constexpr std::size_t kBlocks = 8, kLeast = 16, kColmaps = 50;
  const std::set<std::string>& known = options_of("exhaustive_matcher");
  const bool can_choose = known.count(kBlockOptions[0]) + known.count(kBlockOptions[1]) > 0;
  return can_choose ? std::clamp<std::size_t>(n_photographs / kBlocks, kLeast, kColmaps) : kColmaps;
}

std::vector<std::string> ColmapProgram::map_command(const std::string& mapper) {
  std::vector<std::string> command = begin(mapper);
  command.insert(command.end(), {"--image_path", folders_.images.string(), "--output_path", folders_.models.string()});
  if (options_.threads > 0) {
    add(command, {"Mapper.num_threads", "GlobalMapper.num_threads"}, std::to_string(options_.threads));
  }
  if (!face_params_.empty()) {
    add(command, {"Mapper.ba_refine_focal_length"}, "0");
    add(command, {"Mapper.ba_refine_extra_params"}, "0");
  }
  return command;
}

std::optional<ColmapStep> colmap_step(const std::string& line) {
  ColmapStep step;
  for (const char* words : {"Processed file [", "Matching image [", "Processing image ["}) {
    const char* const rest = text_after(line, words);
    if (rest && std::sscanf(rest, "%9zu/%9zu", &step.done, &step.total) == 2) return step;
  }
  for (const char* words : {"Matching block [", "Processing block ["}) {
    const char* const rest = text_after(line, words);
    std::size_t row = 0, rows = 0, column = 0, columns = 0;
    if (!rest || std::sscanf(rest, "%9zu/%9zu, %9zu/%9zu", &row, &rows, &column, &columns) != 4 || row == 0) continue;
    const std::size_t at = (row - 1) * columns + column;
    return ColmapStep{text_after(rest, "] in ") ? at : at - std::min<std::size_t>(at, 1), rows * columns};
  }
  const char* const image = text_after(line, "Registering image #");
  const char* const count = image ? std::strrchr(image, '(') : nullptr;  // "(12)" or "(num_reg_frames=12)"
  if (!count || std::sscanf(count + std::strcspn(count, "0123456789"), "%9zu", &step.done) != 1) return std::nullopt;
  return ColmapStep{step.done, 0};
}

std::size_t pairs_in_blocks(std::size_t n_photographs, std::size_t block, std::size_t n_blocks) {
  const std::size_t n_rows = (n_photographs + block - 1) / block;
  std::size_t n_pairs = 0;
  for (std::size_t i = 0; i < std::min(n_blocks, n_rows * n_rows); ++i) {
    const std::size_t row = i / n_rows, column = i % n_rows;
    const std::size_t height = std::min(block, n_photographs - row * block);
    const std::size_t width = std::min(block, n_photographs - column * block);
    // Of photographs at places p and q in their blocks, those with p < q, and below the diagonal also those with p = q.
    for (std::size_t q = 0; q < width; ++q) n_pairs += std::min(height, q + (row > column ? 1 : 0));
  }
  return n_pairs;
}

std::optional<std::size_t> colmap_camera(const std::string& line) {
  const char* const rest = text_after(line, "Camera:");
  std::size_t camera = 0;
  if (!rest || std::sscanf(rest, " #%9zu", &camera) != 1) return std::nullopt;
  return camera;
}

}  // namespace b3dgs
