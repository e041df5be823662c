// Tests the messages of a rank when rank 0 is slow to read.
#include <gtest/gtest.h>
#include <poll.h>
#include <pthread.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "dist/control/message.h"
#include "dist/control/rank_link.h"
#include "dist/control/socket.h"
#include "support/expect_error.h"
#include "support/same.h"

namespace b3dgs {
namespace {

using std::chrono::milliseconds;
using test::fails_with;

constexpr milliseconds kUnreached{60000};  // a test fails if it reaches this limit

/// The other end of a link. It lets rank 1 of 2 join and then does what a test requests.
class OtherEnd {
 public:
  explicit OtherEnd(const RankLimits& limits) : listening_(listen_at("127.0.0.1", 0)) {
    const int bytes = 4096;  // inherited by connections, and soon full
    EXPECT_EQ(setsockopt(listening_.fd(), SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes), 0);
    auto link = std::async(std::launch::async, [&limits, port = port_of(listening_)] {
      return std::make_unique<RankLink>("127.0.0.1", port, 1, 2, "job", limits);
    });
    connection_ = Connection(Socket(accept(listening_.fd(), nullptr, nullptr)), limits, /*is_trusted=*/true);
    connection_.queue({MessageKind::kReply, kHelloId, {}});
    connection_.flush();
    EXPECT_FALSE(connection_.has_unsent());
    link_ = link.get();
  }
  RankLink& link() { return *link_; }
  const Socket& connection() const { return connection_.socket(); }
  /// Closes the connection, which ends all waits of the link.
  void hang_up() { connection_.close(); }

  /// Returns the next message of this kind and skips others. Returns nullopt if it does not come.
  std::optional<Message> receive(MessageKind kind) {
    std::optional<Message> found;
    while (!found) {
      pollfd file{connection_.socket().fd(), POLLIN, 0};
      if (poll(&file, 1, static_cast<int>(kUnreached.count())) != 1) return std::nullopt;
      connection_.receive([&](const Message& message) {
        if (message.kind == kind) found = message;
      });
    }
    return found;
  }

 private:
  Socket listening_;
  Connection connection_{Socket(), {}, true};
  std::unique_ptr<RankLink> link_;
};

std::atomic<int> n_signals{0};

TEST(RankLink, ASignalCutsNoMessageShort) {
  RankLimits limits;
  limits.silence = 10 * kUnreached;
  OtherEnd hub(limits);
  const std::string value(20000000, 'v');
  std::thread sender([&] {
    EXPECT_THROW(hub.link().request(MessageKind::kSet, {"key", value}), PeerError) << "no answer";
  });
  int n_waiting = 0;
  while (n_waiting < 1000) {
    ASSERT_EQ(ioctl(hub.connection().fd(), FIONREAD, &n_waiting), 0);
    std::this_thread::yield();
  }
  struct sigaction count {
  }, before{};
  count.sa_handler = [](int) { ++n_signals; };
  count.sa_flags = SA_RESTART;
  ASSERT_EQ(sigaction(SIGUSR1, &count, &before), 0);
  n_signals = 0;
  for (int sent = 0; sent < 200; ++sent) {
    ASSERT_EQ(pthread_kill(sender.native_handle(), SIGUSR1), 0);
    while (n_signals <= sent) std::this_thread::sleep_for(milliseconds(1));
  }
  const std::optional<Message> message = hub.receive(MessageKind::kSet);
  ASSERT_EQ(sigaction(SIGUSR1, &before, nullptr), 0);
  hub.hang_up();
  sender.join();
  ASSERT_TRUE(message);
  ASSERT_EQ(message->parts.size(), 2u);
  EXPECT_EQ(message->parts[0], "key");
  EXPECT_TRUE(test::same(message->parts[1], value));
}

TEST(RankLink, NamesRankZeroIfItTakesNoMessages) {
  const std::string value(20000000, 'v');
  RankLimits limits;
  limits.silence = milliseconds(2000);
  OtherEnd hub(limits);
  std::atomic<bool> is_over{false};
  std::thread signs_of_life([&] {
    const std::string beat = to_bytes({});
    while (!is_over && send(hub.connection().fd(), beat.data(), beat.size(), MSG_NOSIGNAL) > 0) {
      std::this_thread::sleep_for(milliseconds(20));
    }
  });
  EXPECT_TRUE(fails_with<PeerError>({"rank 0 of 2 stopped: it took nothing of a message for 2 s"}, [&] {
    hub.link().request(MessageKind::kSet, {"key", value});
  }));
  is_over = true;
  signs_of_life.join();
}

}  // namespace
}  // namespace b3dgs
