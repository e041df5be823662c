#include "scene/images/image_memory.h"

#include "core/check.h"

namespace b3dgs {

std::int64_t image_memory_limit(double host_memory_gb, std::int64_t available_bytes) {
  if (host_memory_gb < 0) return available_bytes / 5 * 4;
  return static_cast<std::int64_t>(std::min(1e9 * host_memory_gb, 9e18));
}

ImageMemory::ImageMemory(const Plan& plan) : plan_(plan), held_(plan.fixed), peak_(plan.fixed) {
  B3DGS_CHECK(plan.limit >= 0 && plan.n_readers >= 1, "limit ", plan.limit, ", readers ", plan.n_readers);
  divide();
}

void ImageMemory::divide() {
  hold_limit_ = plan_.limit;
  if (plan_.largest == 0) return;
  const std::int64_t left = std::max<std::int64_t>(0, plan_.limit - plan_.fixed);
  const std::int64_t wanted = left / 4 / plan_.n_readers / plan_.largest;
  n_buffers_ = static_cast<int>(std::clamp<std::int64_t>(wanted, 1, kMaxBuffers));
  if (plan_.photographs > left) hold_limit_ -= plan_.n_readers * n_buffers_ * plan_.largest;
}

ImageMemory::Use ImageMemory::reserve(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const std::int64_t buffers = std::max(buffers_, plan_.n_readers * plan_.largest);
  if (bytes > plan_.limit - buffers - held_) return nullptr;
  held_ += bytes;
  plan_.fixed += bytes;
  divide();
  note_peak();
  return Use(this, [bytes](ImageMemory* memory) {
    const std::lock_guard<std::mutex> lock_again(memory->mutex_);
    memory->held_ -= bytes;
    memory->plan_.fixed -= bytes;
    memory->divide();
  });
}

bool ImageMemory::try_hold(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (bytes > hold_limit_ - held_) return false;
  held_ += bytes;
  note_peak();
  return true;
}

void ImageMemory::release_held(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  held_ -= bytes;
}

ImageMemory::Use ImageMemory::use_buffers(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  buffers_ += bytes;
  note_peak();
  return Use(this, [bytes](ImageMemory* memory) {
    const std::lock_guard<std::mutex> lock_again(memory->mutex_);
    memory->buffers_ -= bytes;
  });
}

}  // namespace b3dgs
