// Tests the order, capacity and errors of TaskQueue.
#include "core/task_queue.h"

#include <gtest/gtest.h>

#include <atomic>
#include <future>
#include <stdexcept>
#include <string>

namespace b3dgs {
namespace {

TEST(TaskQueue, OneThreadKeepsTheOrder) {
  std::vector<int> done;
  TaskQueue queue(1, 2);
  for (int i = 0; i < 100; ++i) queue.push([&done, i] { done.push_back(i); });
  queue.finish();
  ASSERT_EQ(done.size(), 100u);
  for (int i = 0; i < 100; ++i) EXPECT_EQ(done[static_cast<std::size_t>(i)], i);
}

TEST(TaskQueue, HoldsNoMoreThanItsCapacity) {
  std::atomic<int> n_pushed{0}, n_done{0};
  int most = 0;
  TaskQueue queue(2, 3);
  for (int i = 0; i < 200; ++i) {
    queue.push([&] { ++n_done; });
    ++n_pushed;
    most = std::max(most, n_pushed - n_done);
  }
  queue.finish();
  EXPECT_EQ(n_done, 200);
  EXPECT_LE(most, 2 + 3);
}

TEST(TaskQueue, WaitsForRoom) {
  std::promise<void> go;
  const std::shared_future<void> may_go = go.get_future().share();
  std::atomic<bool> has_room{false};
  TaskQueue queue(1, 1);
  queue.push([&] { may_go.wait(); });
  queue.push([] {});  // returns once the first one runs
  std::thread third([&] {
    queue.push([] {});
    has_room = true;
  });
  EXPECT_FALSE(has_room);
  go.set_value();
  third.join();
  queue.finish();
  EXPECT_TRUE(has_room);
}

TEST(TaskQueue, PassesOnTheFirstErrorAndBeginsNothingAfterIt) {
  std::atomic<int> n_later{0};
  TaskQueue queue(1, 4);
  queue.push([] { throw std::runtime_error("the disk is full"); });
  const auto message = [](const auto& call) -> std::string {
    try {
      call();
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(message([&] { queue.finish(); }), "the disk is full");
  EXPECT_EQ(message([&] { queue.push([&] { ++n_later; }); }), "the disk is full");
  EXPECT_EQ(message([&] { queue.finish(); }), "the disk is full");
  EXPECT_EQ(n_later, 0);
}

TEST(TaskQueue, APushThatWaitsForRoomGetsTheError) {
  std::promise<void> go;
  const std::shared_future<void> may_go = go.get_future().share();
  TaskQueue queue(1, 1);
  queue.push([&] {
    may_go.wait();
    throw std::runtime_error("no");
  });
  queue.push([] {});
  std::thread fails([&] { EXPECT_THROW(queue.push([] {}), std::runtime_error); });
  go.set_value();
  fails.join();
}

TEST(TaskQueue, TheEndDropsWhatHasNotBegun) {
  std::atomic<int> n_done{0};
  std::promise<void> begun, go;
  std::thread ends;
  {
    TaskQueue queue(1, 8);
    queue.push([&] {
      begun.set_value();
      go.get_future().wait();
      ++n_done;
    });
    begun.get_future().wait();
    for (int i = 0; i < 8; ++i) queue.push([&] { n_done += 100; });
    ends = std::thread([&] { go.set_value(); });
  }
  ends.join();
  EXPECT_EQ(n_done % 100, 1) << "the one that had begun";
}

}  // namespace
}  // namespace b3dgs
