#include "core/task_queue.h"

#include <system_error>
#include <utility>

namespace b3dgs {

TaskQueue::TaskQueue(int threads, std::size_t capacity) : capacity_(capacity) {
  try {
    for (int i = 0; i < threads; ++i) threads_.emplace_back([this] { run(); });
  } catch (const std::system_error&) {  // the system has no more threads
    if (threads_.empty()) throw;
  }
}

TaskQueue::~TaskQueue() {
  {
    const std::lock_guard lock(mutex_);
    is_ending_ = true;
  }
  changed_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void TaskQueue::push(std::function<void()> task) {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [&] { return waiting_.size() < capacity_ || error_; });
  if (error_) std::rethrow_exception(error_);
  waiting_.push_back(std::move(task));
  changed_.notify_all();
}

void TaskQueue::finish() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [&] { return n_running_ == 0 && (waiting_.empty() || error_); });
  if (error_) std::rethrow_exception(error_);
}

bool TaskQueue::is_busy() const {
  const std::lock_guard lock(mutex_);
  return n_running_ > 0 || !waiting_.empty();
}

void TaskQueue::run() {
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [&] { return is_ending_ || (!waiting_.empty() && !error_); });
    if (is_ending_) return;
    std::function<void()> task = std::move(waiting_.front());
    waiting_.pop_front();
    ++n_running_;
    lock.unlock();
    changed_.notify_all();
    std::exception_ptr error;
    try {
      task();
    } catch (...) {
      error = std::current_exception();
    }
    task = {};  // frees its memory before it counts as done
    lock.lock();
    --n_running_;
    if (error && !error_) error_ = error;
    changed_.notify_all();
  }
}

}  // namespace b3dgs
