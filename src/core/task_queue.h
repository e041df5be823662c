// Threads with a bounded queue of tasks. They write files, for example, while the next images are computed.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace b3dgs {

class TaskQueue {
 public:
  /// At most `capacity` tasks wait, and push() blocks beyond that. Tasks begin in the order in which they were pushed.
  /// With one thread, they also end in it. Starts fewer threads if the system has no more.
  /// @throws std::system_error if it has none
  TaskQueue(int threads, std::size_t capacity);
  /// Waits for the tasks that have begun, and drops the others.
  ~TaskQueue();
  TaskQueue(const TaskQueue&) = delete;
  TaskQueue& operator=(const TaskQueue&) = delete;

  /// Waits for capacity. @throws the exception of a task, after which no task begins
  void push(std::function<void()> task);

  /// Waits until all tasks have ended. @throws like push()
  void finish();

  /// Returns whether a task waits or has not ended.
  bool is_busy() const;

 private:
  void run();

  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::function<void()>> waiting_;
  std::size_t n_running_ = 0;
  std::exception_ptr error_;  // the first one
  bool is_ending_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace b3dgs
