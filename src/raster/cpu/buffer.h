// Memory that only grows and is not initialised: passes write every element before they read it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>

namespace b3dgs::cpu {

template <class T>
class Buffer {
 public:
  /// At least n elements with undefined contents. Reallocates, with a quarter to spare, only if n exceeds the capacity.
  T* resize(std::int64_t n) {
    if (n > capacity_) {
      const std::int64_t grown = n + n / 4;
      data_.reset();
      data_.reset(static_cast<T*>(::operator new(static_cast<std::size_t>(grown) * sizeof(T), kAlignment)));
      capacity_ = grown;
    }
    return data_.get();
  }
  T* data() const { return data_.get(); }

 private:
  static constexpr std::align_val_t kAlignment{64};
  struct Free {
    void operator()(T* memory) const { ::operator delete(memory, kAlignment); }
  };
  std::unique_ptr<T[], Free> data_;
  std::int64_t capacity_ = 0;
};

}  // namespace b3dgs::cpu
