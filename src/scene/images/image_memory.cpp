#include "scene/images/image_memory.h"

#include "core/check.h"

namespace b3dgs {

std::int64_t image_memory_limit(double host_memory_gb, std::int64_t available_bytes) {
  if (host_memory_gb < 0) return available_bytes / 5 * 4;
  return static_cast<std::int64_t>(std::min(1e9 * host_memory_gb, 9e18));
}

ImageMemory::ImageMemory(const Plan& plan) : plan_(plan) {
  B3DGS_CHECK(plan.limit >= 0 && plan.n_readers >= 1, "limit ", plan.limit, ", readers ", plan.n_readers);
  add(held_, 0);
}

void ImageMemory::add(std::int64_t& amount, std::int64_t bytes) {
  amount += bytes;
  peak_ = std::max(peak_, plan_.fixed + held_ + buffers_);
  hold_limit_ = plan_.limit;
  if (plan_.largest == 0) return;
  const std::int64_t left = std::max<std::int64_t>(0, plan_.limit - plan_.fixed);
  const std::int64_t wanted = left / 4 / plan_.n_readers / plan_.largest;
  n_buffers_ = static_cast<int>(std::clamp<std::int64_t>(wanted, 1, kMaxBuffers));
  if (plan_.photographs > left) hold_limit_ -= plan_.n_readers * n_buffers_ * plan_.largest;
}

ImageMemory::Use ImageMemory::use(std::int64_t& amount, std::int64_t bytes) {
  add(amount, bytes);
  return Use(this, [&amount, bytes](ImageMemory* memory) {
    const std::lock_guard<std::mutex> lock(memory->mutex_);
    memory->add(amount, -bytes);
  });
}

ImageMemory::Use ImageMemory::reserve(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const std::int64_t buffers = std::max(buffers_, plan_.n_readers * plan_.largest);
  if (bytes > plan_.limit - buffers - plan_.fixed - held_) return nullptr;
  return use(plan_.fixed, bytes);
}

bool ImageMemory::try_hold(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (bytes > hold_limit_ - plan_.fixed - held_) return false;
  add(held_, bytes);
  return true;
}

void ImageMemory::release_held(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  add(held_, -bytes);
}

ImageMemory::Use ImageMemory::use_buffers(std::int64_t bytes) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return use(buffers_, bytes);
}

}  // namespace b3dgs
