#include "train/timing/event_marks.h"

#include "core/cuda_check.h"

namespace b3dgs::cuda {

EventMarks::~EventMarks() {
  for (const cudaEvent_t event : events_) cudaEventDestroy(event);
}

int EventMarks::record(cudaStream_t stream) {
  if (free_.empty()) {
    cudaEvent_t event = nullptr;
    B3DGS_CUDA_CHECK(cudaEventCreate(&event));
    free_.push_back(static_cast<int>(events_.size()));
    events_.push_back(event);
  }
  const int mark = free_.back();
  free_.pop_back();
  B3DGS_CUDA_CHECK(cudaEventRecord(event(mark), stream));
  return mark;
}

bool EventMarks::has_reached(int mark) const {
  const cudaError_t code = cudaEventQuery(event(mark));
  if (code == cudaErrorNotReady) {
    cudaGetLastError();  // clears the code, which is no error, for the next launch check
    return false;
  }
  B3DGS_CUDA_CHECK(code);
  return true;
}

void EventMarks::wait(int mark) const {
  B3DGS_CUDA_CHECK(cudaEventSynchronize(event(mark)));
}

double EventMarks::ms_between(int from, int to) const {
  float ms = 0;
  B3DGS_CUDA_CHECK(cudaEventElapsedTime(&ms, event(from), event(to)));
  return ms;
}

}  // namespace b3dgs::cuda
