#include "app/view/frame_source.h"

#include <gtest/gtest.h>

#include <thread>

namespace b3dgs {
namespace {

using std::chrono::milliseconds;
constexpr milliseconds kLong{60000};  // a passing test never waits this long

TEST(FrameQueue, AnswersWhoAskedWithTheirFrame) {
  FrameQueue queue;
  EXPECT_FALSE(queue.has_request());
  std::vector<std::thread> askers;
  std::vector<int> answers(4, -1);
  for (int i = 0; i < 4; ++i) {
    askers.emplace_back([&, i] {
      FrameRequest request;
      request.view = i;
      answers[static_cast<std::size_t>(i)] = queue.ask(request, kLong).iteration;
    });
  }
  for (int i = 0; i < 4; ++i) {
    EXPECT_TRUE(queue.serve(
        [](const FrameRequest& request) {
          Frame frame;
          frame.iteration = 10 * request.view;
          return frame;
        },
        kLong));
  }
  for (std::thread& asker : askers) asker.join();
  EXPECT_EQ(answers, (std::vector<int>{0, 10, 20, 30}));
  EXPECT_FALSE(queue.has_request());
}

TEST(FrameQueue, ErrorsGoToWhoAsked) {
  FrameQueue queue;
  std::string what;
  std::thread asker([&] {
    try {
      queue.ask({}, kLong);
    } catch (const NumericError& error) {
      what = error.what();
    }
  });
  EXPECT_TRUE(queue.serve([](const FrameRequest&) -> Frame { throw NumericError("no such picture"); }, kLong));
  asker.join();
  EXPECT_EQ(what, "no such picture");
}

TEST(FrameQueue, ARequestThatNobodyBeginsIsWithdrawn) {
  FrameQueue queue;
  EXPECT_THROW(queue.ask({}, milliseconds(1)), BusyError);
  EXPECT_FALSE(queue.has_request());
  EXPECT_FALSE(queue.serve([](const FrameRequest&) { return Frame(); }, milliseconds(0)));
}

TEST(FrameQueue, ClosingEndsWaiting) {
  FrameQueue queue;
  std::thread asker([&] { EXPECT_THROW(queue.ask({}, kLong), BusyError); });
  while (!queue.has_request()) std::this_thread::yield();
  queue.close();
  asker.join();
  EXPECT_THROW(queue.ask({}, kLong), BusyError);
  EXPECT_FALSE(queue.serve([](const FrameRequest&) { return Frame(); }, kLong));
}

}  // namespace
}  // namespace b3dgs
