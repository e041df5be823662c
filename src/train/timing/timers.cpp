#include "train/timing/timers.h"

#include <algorithm>
#include <chrono>
#include <vector>

#include "core/check.h"

#if B3DGS_TORCH_CUDA
#include "raster/torch/torch_cuda.h"
#include "train/timing/event_marks.h"
#endif

namespace b3dgs {
namespace {

/// Work on the CPU is done when its function returns: a mark is a clock reading.
class HostClock final : public StageClock {
 public:
  int mark() override {
    if (free_.empty()) {
      free_.push_back(static_cast<int>(times_.size()));
      times_.emplace_back();
    }
    const int mark = free_.back();
    free_.pop_back();
    times_[static_cast<std::size_t>(mark)] = Clock::now();
    return mark;
  }
  void release(int mark) override { free_.push_back(mark); }
  bool has_reached(int) override { return true; }
  void wait(int) override {}
  double ms_between(int from, int to) override {
    const auto at = [&](int mark) { return times_[static_cast<std::size_t>(mark)]; };
    return std::chrono::duration<double, std::milli>(at(to) - at(from)).count();
  }

 private:
  using Clock = std::chrono::steady_clock;
  std::vector<Clock::time_point> times_;
  std::vector<int> free_;
};

#if B3DGS_TORCH_CUDA
class DeviceClock final : public StageClock {
 public:
  int mark() override { return marks_.record(torch_stream()); }
  void release(int mark) override { marks_.release(mark); }
  bool has_reached(int mark) override { return marks_.has_reached(mark); }
  void wait(int mark) override { marks_.wait(mark); }
  double ms_between(int from, int to) override { return marks_.ms_between(from, to); }

 private:
  cuda::EventMarks marks_;
};
#endif

}  // namespace

std::unique_ptr<StageClock> make_stage_clock(torch::Device device) {
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) return std::make_unique<DeviceClock>();
#endif
  B3DGS_CHECK(device.is_cpu(), "this build has no stage clock for ", device.str());
  return std::make_unique<HostClock>();
}

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
