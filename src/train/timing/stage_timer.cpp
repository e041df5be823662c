#include "train/timing/stage_timer.h"

#include <algorithm>

#include "core/check.h"

namespace b3dgs {

double StageTimes::host_ms() const {
  double rest = wall_ms;
  for (const std::optional<double>& stage : ms) rest -= stage.value_or(0);
  return std::max(0.0, rest);
}

nlohmann::ordered_json stage_json(const StageTimes& times) {
  nlohmann::ordered_json json = nlohmann::ordered_json::object();
  for (std::size_t i = 0; i < kStageCount; ++i) {
    if (times.ms[i]) json[kStageNames[i]] = *times.ms[i];
  }
  json["host"] = times.host_ms();
  return json;
}

void StageTimer::start(StageTimes::Kind kind) {
  B3DGS_CHECK(!open_, "start() before finish() or cancel()");
  open_ = Record{kind, clock_->mark(), 0, {}};
}

void StageTimer::begin(Stage stage) {
  if (!open_) return;
  end();
  stage_ = stage;
  stage_from_ = clock_->mark();
}

void StageTimer::end() {
  if (!open_ || !stage_) return;
  open_->spans.push_back({*stage_, stage_from_, clock_->mark()});
  stage_.reset();
}

void StageTimer::finish(int n_iterations) {
  if (!open_) return;
  end();
  open_->n_iterations = n_iterations;
  open_->to = clock_->mark();
  finished_.push_back(std::move(*open_));
  open_.reset();
}

void StageTimer::cancel() {
  if (!open_) return;
  end();
  for (const Span& span : open_->spans) {
    clock_->release(span.from);
    clock_->release(span.to);
  }
  clock_->release(open_->from);
  open_.reset();
}

StageTimes StageTimer::read(const Record& record) {
  StageTimes times;
  times.kind = record.kind;
  times.wall_ms = clock_->ms_between(record.from, record.to);
  for (const Span& span : record.spans) {
    std::optional<double>& ms = times.ms[static_cast<std::size_t>(span.stage)];
    ms = ms.value_or(0) + clock_->ms_between(span.from, span.to);
    clock_->release(span.from);
    clock_->release(span.to);
  }
  clock_->release(record.from);
  clock_->release(record.to);
  if (record.n_iterations > 1) {
    times.wall_ms /= record.n_iterations;
    for (std::optional<double>& ms : times.ms) {
      if (ms) *ms /= record.n_iterations;
    }
  }
  return times;
}

std::vector<StageTimes> StageTimer::take() {
  std::vector<StageTimes> known;
  while (!finished_.empty() && clock_->has_reached(finished_.front().to)) {
    known.push_back(read(finished_.front()));
    finished_.pop_front();
  }
  return known;
}

std::vector<StageTimes> StageTimer::wait() {
  if (!finished_.empty()) clock_->wait(finished_.back().to);
  return take();
}

void StageAverage::add(const StageTimes& times) {
  if (times.kind == StageTimes::Kind::kDensityRound) {
    rounds_ms_ += times.wall_ms;
    ++n_rounds_;
    return;
  }
  for (std::size_t i = 0; i < kStageCount; ++i) {
    if (times.ms[i]) step_sums_[i] = step_sums_[i].value_or(0) + *times.ms[i];
  }
  wall_sum_ += times.wall_ms;
  ++n_timed_;
}

std::optional<StageTimes> StageAverage::take(int n_steps) {
  if (n_timed_ == 0) return std::nullopt;
  StageTimes mean;
  for (std::size_t i = 0; i < kStageCount; ++i) {
    if (step_sums_[i]) mean.ms[i] = *step_sums_[i] / n_timed_;
  }
  mean.wall_ms = wall_sum_ / n_timed_;
  if (n_rounds_ > 0) {
    const double share = rounds_ms_ / std::max(1, n_steps);
    std::optional<double>& densify = mean.ms[static_cast<std::size_t>(Stage::kDensify)];
    densify = densify.value_or(0) + share;
    mean.wall_ms += share;
  }
  *this = {};
  return mean;
}

}  // namespace b3dgs
