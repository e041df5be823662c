// A pool of reusable CUDA events: marks on a stream, read once the device has passed them.
#pragma once

#include <cuda_runtime_api.h>

#include <vector>

namespace b3dgs::cuda {

class EventMarks {
 public:
  EventMarks() = default;
  ~EventMarks();
  EventMarks(const EventMarks&) = delete;
  EventMarks& operator=(const EventMarks&) = delete;

  /// Asynchronous. The caller owns the mark until release().
  int record(cudaStream_t stream);
  void release(int mark) { free_.push_back(mark); }
  bool has_reached(int mark) const;
  void wait(int mark) const;
  /// Both marks must have been reached.
  double ms_between(int from, int to) const;

 private:
  cudaEvent_t event(int mark) const { return events_[static_cast<std::size_t>(mark)]; }
  std::vector<cudaEvent_t> events_;
  std::vector<int> free_;
};

}  // namespace b3dgs::cuda
