#include "app/view/frame_source.h"

#include <algorithm>
#include <utility>

namespace b3dgs {

Frame FrameQueue::ask(const FrameRequest& request, std::chrono::milliseconds patience) {
  const auto mine = std::make_shared<Waiting>();
  mine->request = request;
  std::future<Frame> frame = mine->frame.get_future();
  std::unique_lock<std::mutex> lock(mutex_);
  if (is_closed_) throw BusyError("the program is about to end");
  waiting_.push_back(mine);
  asked_.notify_one();
  begun_.wait_for(lock, patience, [&] { return mine->is_begun || is_closed_; });
  if (!mine->is_begun) {
    waiting_.erase(std::remove(waiting_.begin(), waiting_.end(), mine), waiting_.end());
    throw BusyError(is_closed_ ? "the program is about to end" : "the program is busy; the picture follows");
  }
  lock.unlock();
  return frame.get();
}

bool FrameQueue::has_request() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return !waiting_.empty();
}

bool FrameQueue::serve(const std::function<Frame(const FrameRequest&)>& render, std::chrono::milliseconds wait) {
  std::unique_lock<std::mutex> lock(mutex_);
  asked_.wait_for(lock, wait, [&] { return !waiting_.empty() || is_closed_; });
  if (waiting_.empty() || is_closed_) return false;
  const std::shared_ptr<Waiting> next = waiting_.front();
  waiting_.pop_front();
  next->is_begun = true;
  lock.unlock();
  begun_.notify_all();
  try {
    next->frame.set_value(render(next->request));
  } catch (...) {
    next->frame.set_exception(std::current_exception());
  }
  return true;
}

void FrameQueue::close() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_closed_ = true;
  }
  asked_.notify_all();
  begun_.notify_all();
}

}  // namespace b3dgs
