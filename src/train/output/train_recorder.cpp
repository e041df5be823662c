#include "train/output/train_recorder.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <sstream>

#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"
#include "core/files/own_files.h"
#include "core/json_text.h"
#include "core/text.h"
#include "train/checkpoint/checkpoint.h"

namespace b3dgs {

void TrainRecorder::report_progress(const char* activity) const {
  const TrainState& state = source_.state;
  if (!source_.listeners.on_progress) return;
  source_.listeners.on_progress({state.iteration, source_.config.iterations, state.loss_average, state.n_gaussians(),
                                 state.count_cap, source_.time.train_s(), activity});
}

void TrainRecorder::say(const std::string& message) const {
  if (source_.listeners.on_message) source_.listeners.on_message(message);
}

void TrainRecorder::warn(const std::string& message) const {
  if (source_.listeners.on_warning) source_.listeners.on_warning(message);
}

void TrainRecorder::open_log() {
  log_ = std::make_unique<TrainLog>(source_.folder.log(), source_.state.iteration);
  logged_iteration_ = staged_iteration_ = source_.state.iteration;
}

void TrainRecorder::log_event(int iteration, const char* event, const nlohmann::ordered_json& fields) {
  if (!log_) return;
  nlohmann::ordered_json line{{"iteration", iteration}, {"event", event}};
  line.update(fields);
  log_->write(line);
}

void TrainRecorder::log_iteration(const std::optional<ImageQuality>& test_quality, const std::string& kernel) {
  const TrainState& state = source_.state;
  logged_ms_ = 1e3 * (source_.time.train_s() - logged_s_) / std::max(1, state.iteration - logged_iteration_);
  nlohmann::ordered_json line{{"iteration", state.iteration},
                              {"loss", state.loss_average},
                              {"ms", logged_ms_},
                              {"count", state.n_gaussians()},
                              {"elapsed_s", elapsed_s()}};
  const std::int64_t peak_memory = source_.memory.use().peak_reserved;
  if (peak_memory > 0) line["gpu_peak_bytes"] = peak_memory;
  collect_stage_times();
  if (const auto stages = stages_.take(state.iteration - staged_iteration_)) {
    line["stages_ms"] = stage_json(*stages);
    staged_iteration_ = state.iteration;
  }
  if (test_quality) {
    line["test_psnr"] = test_quality->psnr;
    line["test_ssim"] = test_quality->ssim;
    line["test_sharpness"] = test_quality->sharpness;
    if (test_quality->corrected_psnr) line["test_cc_psnr"] = *test_quality->corrected_psnr;
  }
  line["kernel"] = kernel;
  log_->write(line);
  if (const std::string fault = log_->take_fault(); !fault.empty()) {
    warn(fault + "; log lines are kept in memory until it can be written");
  }
  logged_iteration_ = state.iteration;
  logged_s_ = source_.time.train_s();
}

void TrainRecorder::add_evaluation(const Evaluation& evaluation, const EvaluationSource& source) {
  const int iteration = source_.state.iteration;
  if (evaluation.views.empty()) {
    return warn("iteration " + std::to_string(iteration) +
                ": nothing was measured: the masks leave no valid pixel in any test view");
  }
  outputs_.evaluations.emplace_back(iteration, evaluation);
  if (source_.listeners.on_evaluation) source_.listeners.on_evaluation(iteration, evaluation);
  try_to_write([&] { source_.folder.write_results(source_.folder.results_key(iteration), evaluation, source); });
  std::string message = describe_quality(iteration, evaluation);
  if (const auto corrected = evaluation.mean.corrected_psnr) {
    message += print_to_string("; colour-corrected PSNR %.2f dB", *corrected);
  }
  say(message);
}

void TrainRecorder::add_stage_times(const std::vector<StageTimes>& known) {
  for (const StageTimes& times : known) {
    stages_.add(times);
    if (source_.listeners.on_stage_times) source_.listeners.on_stage_times(times);
  }
}

bool TrainRecorder::has_room_for_copy(std::int64_t bytes) const {
  const std::optional<std::int64_t> limit = source_.memory.limit();
  // Leaves the same amount of memory to the training.
  return !is_end() && (!limit || *limit - source_.memory.use().reserved >= 2 * bytes);
}

WrittenFile TrainRecorder::new_file(WrittenFile::Kind kind) const {
  const int iteration = source_.state.iteration;
  const ModelFolder& folder = source_.folder;
  return {kind, iteration, kind == WrittenFile::Kind::kPly ? folder.ply(iteration) : folder.checkpoint(iteration), ""};
}

void TrainRecorder::wait_at_end() {
  if (!is_end()) return;
  writer_.wait();
  collect_files();
}

void TrainRecorder::write_ply(const GaussianTensors& gaussians) {
  outputs_.n_saved = gaussians.size();
  writer_.write_ply(new_file(WrittenFile::Kind::kPly), gaussians, source_.frame,
                    has_room_for_copy(ply_bytes(gaussians.size(), source_.config.sh_degree)));
  wait_at_end();
}

void TrainRecorder::write_checkpoint(const nlohmann::ordered_json& header,
                                     const std::vector<CheckpointTensor>& tensors) {
  checkpoint_s_ = source_.time.train_s();
  std::int64_t bytes = 0;
  for (const CheckpointTensor& tensor : tensors) {
    if (tensor.values.defined()) bytes += static_cast<std::int64_t>(tensor.values.nbytes());
  }
  writer_.write_checkpoint(new_file(WrittenFile::Kind::kCheckpoint), header, tensors, has_room_for_copy(bytes));
  wait_at_end();
}

bool TrainRecorder::is_checkpoint_due() const {
  const double interval_s = 60 * source_.config.checkpoint_minutes;
  return interval_s > 0 && !writer_.is_busy() && source_.time.train_s() - checkpoint_s_ >= interval_s;
}

void TrainRecorder::collect_files() {
  for (const WrittenFile& file : writer_.take()) handle(file);
}

void TrainRecorder::handle(const WrittenFile& file) {
  const TrainState& state = source_.state;
  const bool is_checkpoint = file.kind == WrittenFile::Kind::kCheckpoint;
  if (file.error.empty()) {  // an earlier attempt may have failed
    std::vector<std::filesystem::path>& missing = outputs_.not_written;
    missing.erase(std::remove(missing.begin(), missing.end(), file.path), missing.end());
    const auto is_this = [&](const WrittenFile& other) { return other.path == file.path; };
    failed_.erase(std::remove_if(failed_.begin(), failed_.end(), is_this), failed_.end());
    if (!is_checkpoint) {
      outputs_.ply = file.path;
      return;
    }
    outputs_.checkpoint = file.path;
    remove_superseded_checkpoints(source_.folder, state.training_id, file.iteration, source_.config.keep_checkpoints);
    return;
  }
  outputs_.not_written.push_back(file.path);
  // A stopped training continues from its checkpoint. Its PLY is only for viewers.
  const bool is_needed = is_checkpoint ? is_end() : is_complete();
  if (is_needed && file.iteration == state.iteration) {
    failed_.push_back(file);
  } else if (is_checkpoint) {
    warn(file.error + "; training continues, the next checkpoint is written as scheduled" + last_checkpoint());
  } else {
    warn(file.error + (is_ending_ ? "" : "; training continues without this PLY"));
  }
}

void TrainRecorder::require_checkpoint() {
  const auto found = std::find_if(failed_.begin(), failed_.end(),
                                  [](const WrittenFile& file) { return file.kind == WrittenFile::Kind::kCheckpoint; });
  if (found == failed_.end()) return;
  const std::string error = found->error;
  failed_.erase(found);
  throw IoError(error + last_checkpoint());
}

void TrainRecorder::finish_files() {
  writer_.wait();
  collect_files();
  if (!failed_.empty()) throw IoError(failed_.front().error + remedy());
}

std::string TrainRecorder::remedy() const {
  const ModelFolder& folder = source_.folder;
  const std::filesystem::path ply = folder.ply(source_.state.iteration);
  const bool has_checkpoint = !outputs_.checkpoint.empty();
  std::string text;
  if (outputs_.ply == ply) {
    text = detail::concat("; the PLY of iteration ", source_.state.iteration, " is complete: ", ply.string(),
                          "; only the checkpoint is missing, without which this model cannot be trained longer");
    if (!has_checkpoint) return text;
  }
  std::string command = source_.listeners.resume_command;
  if (command.empty() && has_checkpoint) command = "--resume auto";
  text += last_checkpoint() + "; ";
  if (!command.empty()) return text + "continue with " + command;
  // A new training in this folder would need --overwrite, and would replace the existing model.
  return text + "start the training again" + (folder.holds_model() ? " in another folder (-m)" : "");
}

std::string TrainRecorder::last_checkpoint() const {
  return "; last checkpoint: " + (outputs_.checkpoint.empty() ? "none was written" : outputs_.checkpoint.string());
}

namespace {

using Json = nlohmann::ordered_json;

/// Returns the lines up to the given iteration. Incomplete lines, which a crash leaves behind, are dropped.
std::string lines_until(const std::filesystem::path& path, int iteration) {
  std::istringstream file(read_file_if_there(path).value_or(""));
  std::string kept;
  for (std::string line; std::getline(file, line);) {
    const Json json = parse_json(line);
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

void TrainLog::write(const Json& line) {
  const bool was_waiting = !waiting_.empty();
  waiting_ += dump_json(line) + "\n";
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
