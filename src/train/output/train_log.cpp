#include "train/output/train_log.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "core/check.h"
#include "core/files/atomic_file.h"
#include "core/files/own_files.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

/// Lines of iterations up to the given one. Incomplete lines, left by a crash, are dropped.
std::string lines_until(const std::filesystem::path& path, int iteration) {
  std::ifstream file(path);
  std::string kept;
  for (std::string line; std::getline(file, line);) {
    const Json json = Json::parse(line, nullptr, /*allow_exceptions=*/false);
    if (!json.is_object() || !json.contains("iteration") || !json["iteration"].is_number_integer()) continue;
    if (json["iteration"].get<std::int64_t>() <= iteration) kept += line + "\n";
  }
  return kept;
}

}  // namespace

TrainLog::TrainLog(std::filesystem::path path, int iteration) : path_(std::move(path)) {
  write_file(path_, lines_until(path_, iteration));
  file_ = ::open(path_.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC);
  if (file_ < 0) io_error(path_.string(), ": cannot be opened for writing: ", std::strerror(errno));
}

TrainLog::~TrainLog() {
  ::close(file_);
}

void TrainLog::write(const TrainLogLine& line) {
  Json json = {{"iteration", line.iteration},
               {"loss", line.loss},
               {"ms", line.ms},
               {"count", line.count},
               {"elapsed_s", line.elapsed_s}};
  if (line.peak_memory_bytes > 0) json["gpu_peak_bytes"] = line.peak_memory_bytes;
  if (line.stages) json["stages_ms"] = stage_json(*line.stages);
  if (line.test_quality) {
    json["test_psnr"] = line.test_quality->psnr;
    json["test_ssim"] = line.test_quality->ssim;
    if (line.test_quality->corrected_psnr) json["test_cc_psnr"] = *line.test_quality->corrected_psnr;
  }
  if (!line.kernel.empty()) json["kernel"] = line.kernel;
  if (!line.backward_kernel.empty()) json["backward_kernel"] = line.backward_kernel;
  append(json);
}

void TrainLog::write_event(int iteration, const char* event, const nlohmann::ordered_json& fields) {
  Json json = {{"iteration", iteration}, {"event", event}};
  json.update(fields);
  append(json);
}

void TrainLog::append(const Json& line) {
  const bool was_waiting = !waiting_.empty();
  waiting_ += line.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
  while (!waiting_.empty()) {
    const ssize_t written = ::write(file_, waiting_.data(), waiting_.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) {
      if (!was_waiting) fault_ = detail::concat(path_.string(), ": cannot write: ", std::strerror(errno));
      return;
    }
    waiting_.erase(0, static_cast<std::size_t>(written));
  }
  add_own_file(path_);
}

}  // namespace b3dgs
