// Hands frame requests from the server's threads to the one thread that may render.
#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>

#include "view/frame_source.h"

namespace b3dgs {

class FrameQueue {
 public:
  /// Waits for the frame. @throws BusyError if nobody has begun it after `patience`, or the queue is closed; what the
  /// renderer has thrown
  Frame ask(const FrameRequest& request, std::chrono::milliseconds patience);

  /// Whether a request waits. Cheap enough to be asked after every step of a training.
  bool has_request() const;

  /// Answers the oldest request, after waiting for one for at most `wait`. Exceptions go to the one who asked. Returns
  /// whether there was one.
  bool serve(const std::function<Frame(const FrameRequest&)>& render, std::chrono::milliseconds wait);

  /// Ends waiting in ask() and serve(), now and from now on.
  void close();

 private:
  struct Waiting {
    FrameRequest request;
    Frame frame;
    std::exception_ptr error;
    bool is_begun = false, is_done = false;
  };

  mutable std::mutex mutex_;
  std::condition_variable asked_, answered_;
  std::deque<std::shared_ptr<Waiting>> waiting_;
  bool is_closed_ = false;
};

}  // namespace b3dgs
