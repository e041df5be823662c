#include "train/timing/timers.h"

#include <algorithm>
#include <chrono>

#include "core/check.h"

#if B3DGS_TORCH_CUDA
#include "core/cuda_handles.h"
#include "raster/torch/torch_cuda.h"
#endif

namespace b3dgs {
namespace {

/// A mark on the CPU, where work is done when its function returns.
class HostMark final : public StageMark {
 public:
  bool is_reached() const override { return true; }
  void wait() const override {}
  double ms_since(const StageMark& from) const override {
    return std::chrono::duration<double, std::milli>(time_ - static_cast<const HostMark&>(from).time_).count();
  }

 private:
  const std::chrono::steady_clock::time_point time_ = std::chrono::steady_clock::now();
};

#if B3DGS_TORCH_CUDA
class DeviceMark final : public StageMark {
 public:
  DeviceMark() { B3DGS_CUDA_CHECK(cudaEventRecord(event_.get(), torch_stream())); }

  bool is_reached() const override {
    const cudaError_t code = cudaEventQuery(event_.get());
    if (code != cudaErrorNotReady) B3DGS_CUDA_CHECK(code);
    if (code != cudaSuccess)
      cudaGetLastError();  // clears the code, which is not an error, before the next launch check
    return code == cudaSuccess;
  }
  void wait() const override { B3DGS_CUDA_CHECK(cudaEventSynchronize(event_.get())); }
  double ms_since(const StageMark& from) const override {
    float ms = 0;
    B3DGS_CUDA_CHECK(cudaEventElapsedTime(&ms, static_cast<const DeviceMark&>(from).event_.get(), event_.get()));
    return ms;
  }

 private:
  const cuda::Event event_ = cuda::make_event(cudaEventDefault);
};
#endif

}  // namespace

StageClock make_stage_clock([[maybe_unused]] torch::Device device) {
#if B3DGS_TORCH_CUDA
  if (device.is_cuda()) return [] { return std::make_unique<DeviceMark>(); };
#endif
  return [] { return std::make_unique<HostMark>(); };
}

double StageTimes::host_ms() const {
  double rest = wall_ms;
  for (const std::optional<double>& stage : ms) rest -= stage.value_or(0);
  return std::max(0.0, rest);
}

void StageTimes::add(const StageTimes& others, double share) {
  for (std::size_t i = 0; i < kStageCount; ++i) {
    if (others.ms[i]) ms[i] = ms[i].value_or(0) + share * *others.ms[i];
  }
  wall_ms += share * others.wall_ms;
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
  open_.emplace();
  open_->kind = kind;
  open_->from = clock_();
}

void StageTimer::begin(Stage stage) {
  if (!open_) return;
  end();
  stage_ = stage;
  stage_from_ = clock_();
}

void StageTimer::end() {
  if (!open_ || !stage_) return;
  open_->spans.push_back({*stage_, std::move(stage_from_), clock_()});
  stage_.reset();
}

void StageTimer::finish(int n_iterations) {
  if (!open_) return;
  end();
  open_->n_iterations = n_iterations;
  open_->to = clock_();
  finished_.push_back(std::move(*open_));
  open_.reset();
}

StageTimes StageTimer::read(const Record& record) {
  StageTimes whole;
  whole.wall_ms = record.to->ms_since(*record.from);
  for (const Span& span : record.spans) {
    std::optional<double>& ms = whole.ms[static_cast<std::size_t>(span.stage)];
    ms = ms.value_or(0) + span.to->ms_since(*span.from);
  }
  StageTimes times;
  times.kind = record.kind;
  times.add(whole, 1.0 / record.n_iterations);
  return times;
}

std::vector<StageTimes> StageTimer::take() {
  std::vector<StageTimes> known;
  while (!finished_.empty() && finished_.front().to->is_reached()) {
    known.push_back(read(finished_.front()));
    finished_.pop_front();
  }
  return known;
}

std::vector<StageTimes> StageTimer::wait() {
  if (!finished_.empty()) finished_.back().to->wait();
  return take();
}

void StageAverage::add(const StageTimes& times) {
  if (times.kind == StageTimes::Kind::kDensityRound) {
    rounds_ms_ += times.wall_ms;
    return;
  }
  steps_.add(times, 1);
  ++n_timed_;
}

std::optional<StageTimes> StageAverage::take(int n_steps) {
  if (n_timed_ == 0) return std::nullopt;
  StageTimes mean, rounds;
  mean.add(steps_, 1.0 / n_timed_);
  rounds.wall_ms = rounds_ms_;
  if (rounds_ms_ > 0) rounds.ms[static_cast<std::size_t>(Stage::kDensify)] = rounds_ms_;
  mean.add(rounds, 1.0 / std::max(1, n_steps));
  *this = {};
  return mean;
}

}  // namespace b3dgs
