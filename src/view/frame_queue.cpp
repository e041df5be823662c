#include "view/frame_source.h"

#include <algorithm>
#include <utility>

namespace b3dgs {

Frame FrameQueue::ask(const FrameRequest& request, std::chrono::milliseconds patience) {
  const auto mine = std::make_shared<Waiting>();
  mine->request = request;
  std::unique_lock<std::mutex> lock(mutex_);
  if (is_closed_) throw BusyError("the program is about to end");
  waiting_.push_back(mine);
  asked_.notify_one();
  answered_.wait_for(lock, patience, [&] { return mine->is_done || mine->is_begun || is_closed_; });
  if (!mine->is_begun) {
    waiting_.erase(std::remove(waiting_.begin(), waiting_.end(), mine), waiting_.end());
    throw BusyError(is_closed_ ? "the program is about to end" : "no time for a frame; try again");
  }
  answered_.wait(lock, [&] { return mine->is_done; });
  if (mine->error) std::rethrow_exception(mine->error);
  return std::move(mine->frame);
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
  answered_.notify_all();
  try {
    next->frame = render(next->request);
  } catch (...) {
    next->error = std::current_exception();
  }
  lock.lock();
  next->is_done = true;
  lock.unlock();
  answered_.notify_all();
  return true;
}

void FrameQueue::close() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_closed_ = true;
  }
  asked_.notify_all();
  answered_.notify_all();
}

}  // namespace b3dgs
