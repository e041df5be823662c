#include "adaptive/kernel_timer.h"

#include "core/cuda_check.h"

namespace b3dgs {

class CudaEventTimer::Event {
 public:
  Event() { B3DGS_CUDA_CHECK(cudaEventCreate(&event_)); }
  ~Event() {
    if (event_ != nullptr) cudaEventDestroy(event_);
  }
  Event(Event&& other) noexcept : event_(std::exchange(other.event_, nullptr)) {}
  Event& operator=(Event&&) = delete;
  cudaEvent_t get() const { return event_; }

 private:
  cudaEvent_t event_ = nullptr;
};

struct CudaEventTimer::Span {
  Event start, stop;
};

CudaEventTimer::CudaEventTimer(cudaStream_t stream) : stream_(stream) {}
CudaEventTimer::~CudaEventTimer() = default;

void CudaEventTimer::measure(const std::function<void()>& work) {
  if (n_used_ == spans_.size()) spans_.emplace_back();
  const Span& span = spans_[n_used_++];
  B3DGS_CUDA_CHECK(cudaEventRecord(span.start.get(), stream_));
  work();
  B3DGS_CUDA_CHECK(cudaEventRecord(span.stop.get(), stream_));
}

std::vector<double> CudaEventTimer::finish() {
  const std::size_t n = std::exchange(n_used_, 0);
  std::vector<double> times;
  if (n == 0) return times;
  B3DGS_CUDA_CHECK(cudaEventSynchronize(spans_[n - 1].stop.get()));
  for (std::size_t i = 0; i < n; ++i) {
    float ms = 0;
    B3DGS_CUDA_CHECK(cudaEventElapsedTime(&ms, spans_[i].start.get(), spans_[i].stop.get()));
    times.push_back(ms);
  }
  return times;
}

}  // namespace b3dgs
