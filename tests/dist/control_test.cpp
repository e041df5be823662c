// Tests the connections over which ranks learn of each other, with ranks as threads of this process.
#include <arpa/inet.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <ctime>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "core/check.h"
#include "dist/control/message.h"
#include "dist/control/rank_link.h"
#include "dist/control/socket.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

using std::chrono::milliseconds;
using test::fails_with;

constexpr milliseconds kLong{60000};  // a test fails if it reaches this limit

/// A hub, and ranks that join it.
class Job {
 public:
  explicit Job(int size, const RankLimits& limits = {}) : size_(size), limits_(limits) {
    Socket listening = listen_at("127.0.0.1", 0);
    port_ = port_of(listening);
    hub_ = start_rank_hub(std::move(listening), size, "job", limits);
  }

  int port() const { return port_; }
  std::unique_ptr<RankLink> join(int rank) const { return join(rank, size_, "job"); }
  std::unique_ptr<RankLink> join(int rank, int size, const std::string& job) const {
    return std::make_unique<RankLink>("127.0.0.1", port_, rank, size, job, limits_);
  }

  /// Makes a connection that has said hello and does nothing else.
  Socket join_without_link(int rank) const {
    Socket socket = std::move(*try_to_connect("127.0.0.1", port_, kLong));
    say(socket,
        to_bytes({MessageKind::kHello, kHelloId, {kProtocol, "job", std::to_string(rank), std::to_string(size_)}}));
    return socket;
  }

  static void say(const Socket& socket, const std::string& bytes) {
    ASSERT_EQ(send(socket.fd(), bytes.data(), bytes.size(), MSG_NOSIGNAL), static_cast<ssize_t>(bytes.size()));
  }

  /// Calls body(link) as every rank, and rethrows the exception of the lowest rank.
  void run(const std::function<void(RankLink&)>& body) const {
    std::vector<std::future<void>> ranks;
    for (int rank = 0; rank < size_; ++rank) {
      ranks.push_back(std::async(std::launch::async, [this, rank, &body] { body(*join(rank)); }));
    }
    for (std::future<void>& rank : ranks) rank.wait();
    for (std::future<void>& rank : ranks) rank.get();
  }

 private:
  int size_, port_ = 0;
  RankLimits limits_;
  std::unique_ptr<RankHub> hub_;
};

TEST(Control, GathersRecordsOfAnySize) {
  Job(4).run([](RankLink& link) {
    const auto record = [](int rank) {
      return std::string(rank == 1 ? 0 : rank == 2 ? 3000000 : 10, static_cast<char>(rank));
    };
    for (int round = 0; round < 5; ++round) {
      const std::vector<std::string> all = link.exchange("step", {record(link.rank())});
      ASSERT_EQ(all.size(), 4u);
      for (int rank = 0; rank < 4; ++rank) EXPECT_EQ(all[static_cast<std::size_t>(rank)], record(rank));
    }
  });
}

TEST(Control, ExchangesAPartForEachRank) {
  Job(3).run([](RankLink& link) {
    const auto part = [](int from, int to) { return std::string(static_cast<std::size_t>(from * 3 + to), 'a'); };
    std::vector<std::string> parts;
    for (int to = 0; to < 3; ++to) parts.push_back(part(link.rank(), to));
    if (link.rank() == 2) parts = {"for all"};
    for (int round = 0; round < 3; ++round) {
      const std::vector<std::string> expected{part(0, link.rank()), part(1, link.rank()), "for all"};
      EXPECT_EQ(link.exchange("step", parts), expected);
    }
  });
}

TEST(Control, OneRankAlone) {
  Job(1).run([](RankLink& link) { EXPECT_EQ(link.exchange("x", {"y"}), std::vector<std::string>{"y"}); });
}

TEST(Control, SharesValues) {
  Job(2).run([](RankLink& link) {
    const auto ask = [&](MessageKind kind, const std::vector<std::string>& parts, milliseconds limit = kLong) {
      return link.request(kind, parts, limit);
    };
    using Answer = std::vector<std::string>;
    if (link.rank() == 0) {
      EXPECT_EQ(ask(MessageKind::kGet, {"set later"}), Answer{"value"});
      EXPECT_EQ(ask(MessageKind::kCheck, {"set later"}), Answer{"1"});
      EXPECT_EQ(ask(MessageKind::kCheck, {"unknown"}), Answer{"0"});
      EXPECT_EQ(ask(MessageKind::kDelete, {"set later"}), Answer{"1"});
      EXPECT_EQ(ask(MessageKind::kDelete, {"set later"}), Answer{"0"});
      EXPECT_TRUE(fails_with<Error>({"no answer"}, [&] { ask(MessageKind::kGet, {"never set"}, milliseconds(50)); }));
    } else {
      ask(MessageKind::kSet, {"set later", "value"});
    }
    link.exchange("before add", {""});
    ask(MessageKind::kAdd, {"sum", std::to_string(10 + link.rank())});
    link.exchange("after add", {""});
    EXPECT_EQ(ask(MessageKind::kAdd, {"sum", "0"}), Answer{"21"}) << "decimal digits, as c10d expects";
    EXPECT_EQ(ask(MessageKind::kGet, {"sum"}), Answer{"21"});
    link.exchange("end", {""});
  });
}

TEST(Control, TellsAllWhyARankStops) {
  Job(4).run([](RankLink& link) {
    if (link.rank() == 2) {
      link.fail("out of memory: 4 GB\nstack trace");
      link.fail("a later cause");
    } else {
      EXPECT_TRUE(fails_with<PeerError>({"rank 2 of 4 stopped: out of memory: 4 GB"}, [&] {
        link.rank() == 1 ? link.request(MessageKind::kGet, {"key"}) : link.exchange("step", {""});
      }));
      EXPECT_TRUE(fails_with<PeerError>({"rank 2 of 4"}, [&] { link.throw_if_failed(); })) << "from then on";
      EXPECT_TRUE(fails_with<PeerError>({"rank 2 of 4"}, [&] { link.exchange("a", {"b"}); }));
    }
  });
}

TEST(Control, CallsBackOnFailure) {
  Job(2).run([](RankLink& link) {
    if (link.rank() == 1) {
      EXPECT_FALSE(link.wait_for_failure(milliseconds(1)));
      std::promise<void> called;
      link.on_failure([&] { called.set_value(); });
      link.request(MessageKind::kSet, {"has callback", ""});
      EXPECT_EQ(called.get_future().wait_for(kLong), std::future_status::ready);
      EXPECT_TRUE(link.wait_for_failure(kLong));
    } else {
      link.request(MessageKind::kGet, {"has callback"});
      link.fail("stop");
    }
  });
}

TEST(Control, NamesARankThatVanishes) {
  const Job job(2);
  Socket vanishing = job.join_without_link(1);
  const auto link = job.join(0);
  std::future<void> rank0 = std::async(std::launch::async, [&] {
    EXPECT_TRUE(
        fails_with<PeerError>({"rank 1 of 2 stopped: its process ended"}, [&] { link->exchange("step", {""}); }));
  });
  vanishing.close();
  rank0.get();
}

TEST(Control, NamesARankThatIsSilent) {
  RankLimits limits;
  limits.silence = milliseconds(3000);
  const Job job(2, limits);
  const Socket silent = job.join_without_link(1);
  const auto link = job.join(0);
  EXPECT_TRUE(fails_with<PeerError>({"rank 1 of 2 stopped: no sign of life"}, [&] { link->exchange("step", {""}); }));
}

TEST(Control, RankZeroMayStartLongAfterTheOthers) {
  RankLimits limits;
  limits.silence = milliseconds(3000);
  Socket listening = listen_at("127.0.0.1", 0);
  std::vector<std::future<std::size_t>> ranks;
  for (int rank = 0; rank < 2; ++rank) {
    ranks.push_back(std::async(std::launch::async, [rank, limits, port = port_of(listening)] {
      return RankLink("127.0.0.1", port, rank, 2, "job", limits).exchange("step", {""}).size();
    }));
  }
  std::this_thread::sleep_for(limits.silence * 3 / 2);
  const std::unique_ptr<RankHub> hub = start_rank_hub(std::move(listening), 2, "job", limits);
  for (std::future<std::size_t>& rank : ranks) EXPECT_EQ(rank.get(), 2u);
}

TEST(Control, NamesRankZeroIfTheHubVanishes) {
  Socket listening = listen_at("127.0.0.1", 0);
  std::future<void> rank1 = std::async(std::launch::async, [port = port_of(listening)] {
    RankLink link("127.0.0.1", port, 1, 2, "job", {});
    EXPECT_TRUE(
        fails_with<PeerError>({"rank 0 of 2 stopped: its process ended"}, [&] { link.exchange("step", {""}); }));
  });
  {
    const Socket connection(accept(listening.fd(), nullptr, nullptr));
    Job::say(connection, to_bytes({MessageKind::kReply, kHelloId, {}}));
    std::string hello(64, '\0');
    ASSERT_GT(recv(connection.fd(), hello.data(), hello.size(), 0), 0);
  }
  rank1.get();
}

TEST(Control, ARankThatLeavesIsNoFailure) {
  Job(3).run([](RankLink& link) {
    if (link.rank() == 0) return;  // the hub stays until all have left
    link.request(MessageKind::kSet, {std::to_string(link.rank()), "x"});
    link.request(MessageKind::kGet, {std::to_string(3 - link.rank())});
    link.throw_if_failed();
  });
}

TEST(Control, NobodyWaitsForARankThatHasLeft) {
  Job(2).run([](RankLink& link) {
    if (link.rank() == 1) return;
    EXPECT_TRUE(
        fails_with<PeerError>({"rank 1 of 2 stopped: it finished", "\"step\""}, [&] { link.exchange("step", {""}); }));
  });
}

TEST(Control, NoticesRanksAtDifferentPlaces) {
  Job(2).run([](RankLink& link) {
    EXPECT_TRUE(fails_with<PeerError>({"\"step\"", "\"density\""},
                                      [&] { link.exchange(link.rank() == 0 ? "step" : "density", {""}); }));
  });
}

TEST(Control, RefusesStrangers) {
  const Job job(2);
  EXPECT_TRUE(fails_with<InputError>({"another job", "MASTER_PORT"}, [&] { job.join(1, 2, "another"); }));
  const Socket garbage = std::move(*try_to_connect("127.0.0.1", job.port(), kLong));
  Job::say(garbage, "GET / HTTP/1.1\r\nHost: rank0\r\n\r\n");
  const Socket nothing = std::move(*try_to_connect("127.0.0.1", job.port(), kLong));
  job.run([&](RankLink& link) {
    EXPECT_EQ(link.exchange("step", {"x"}).size(), 2u) << "strangers disturb nobody";
    if (link.rank() == 0) {
      EXPECT_TRUE(fails_with<InputError>({"two processes say that they are rank 1 of 2"}, [&] { job.join(1); }));
    }
    link.exchange("end", {""});
  });
}

// The flood is never read to its end, and is dropped after a while.
TEST(Control, AFloodFromAStrangerDisturbsNobody) {
  RankLimits limits;
  limits.silence = milliseconds(3000);
  const Job job(2, limits);
  const Socket stranger = std::move(*try_to_connect("127.0.0.1", job.port(), kLong));
  ASSERT_EQ(fcntl(stranger.fd(), F_SETFL, 0), 0) << "waits for room to send";
  std::string flood;
  for (int i = 0; i < 100000; ++i) flood += to_bytes({});
  std::atomic<int> n_sent{0};
  std::future<void> sender = std::async(std::launch::async, [&] {
    while (send(stranger.fd(), flood.data(), flood.size(), MSG_NOSIGNAL) > 0) ++n_sent;
  });
  while (n_sent < 10) std::this_thread::yield();
  EXPECT_NO_THROW(job.run([](RankLink& link) { EXPECT_EQ(link.exchange("step", {"x"}).size(), 2u); }));
  EXPECT_EQ(sender.wait_for(kLong), std::future_status::ready);
  shutdown(stranger.fd(), SHUT_RDWR);
}

TEST(Control, WithoutFileDescriptorsItWaitsForOne) {
  const Job job(1);
  const Socket waiting(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<std::uint16_t>(job.port()));
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const int lowest_free = dup(waiting.fd());
  ASSERT_GE(lowest_free, 0);
  ASSERT_EQ(close(lowest_free), 0);
  const rlimit none{static_cast<rlim_t>(lowest_free), before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &none), 0);
  const bool has_connected = connect(waiting.fd(), reinterpret_cast<sockaddr*>(&address), sizeof address) == 0;
  const std::clock_t start = std::clock();  // processor time of all threads
  std::this_thread::sleep_for(milliseconds(2000));
  const std::clock_t used = std::clock() - start;
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_TRUE(has_connected);
  EXPECT_LT(static_cast<double>(used), 0.2 * CLOCKS_PER_SEC) << "it asks again and again";
  job.run([](RankLink& link) { EXPECT_EQ(link.exchange("step", {"x"}).size(), 1u); });
}

TEST(Control, AJobThatHasFailedAcceptsNobody) {
  const Job job(2);
  std::future<void> rank1 = std::async(std::launch::async, [&] { job.join(1)->fail("tired"); });
  const auto rank0 = job.join(0);
  EXPECT_TRUE(rank0->wait_for_failure(kLong));
  rank1.get();
  // A rank of the next attempt would wait for the next rank 0.
  const auto end = std::chrono::steady_clock::now() + kLong;
  while (try_to_connect("127.0.0.1", job.port(), kLong)) ASSERT_LT(std::chrono::steady_clock::now(), end);
}

TEST(Control, RefusesAnotherNumberOfRanks) {
  const Job job(2);
  std::future<void> rank0 = std::async(std::launch::async, [&] {
    EXPECT_TRUE(fails_with<PeerError>({"rank 1 of 2 stopped: ", "WORLD_SIZE is 2 on rank 0 and 4 on rank 1"},
                                      [&] { job.join(0); }));
  });
  EXPECT_TRUE(fails_with<InputError>({"WORLD_SIZE is 2 on rank 0 and 4 on rank 1"}, [&] { job.join(1, 4, "job"); }));
  rank0.get();
}

TEST(Control, NamesRanksThatDoNotJoin) {
  RankLimits limits;
  limits.join = milliseconds(1000);
  const Job job(4, limits);
  std::future<void> rank2 = std::async(std::launch::async, [&] {
    EXPECT_TRUE(fails_with<PeerError>({"did not join within 1 s", "WORLD_SIZE"}, [&] { job.join(2); }));
  });
  EXPECT_TRUE(fails_with<PeerError>({"rank 1 of 4 stopped: did not join within 1 s", "3; "}, [&] { job.join(0); }));
  rank2.get();
}

TEST(Control, RankZeroThatDoesNotListen) {
  RankLimits limits;
  limits.join = milliseconds(100);
  const int free_port = port_of(listen_at("127.0.0.1", 0));
  EXPECT_TRUE(fails_with<InputError>({"rank 0 does not listen at 127.0.0.1 port"},
                                     [&] { RankLink("127.0.0.1", free_port, 1, 2, "job", limits); }));
  EXPECT_TRUE(fails_with<InputError>({"address of rank 0 not found", "no.such.host.invalid"},
                                     [&] { RankLink("no.such.host.invalid", free_port, 1, 2, "job", limits); }));
}

TEST(Sockets, ListenOnlyAtTheAddressGiven) {
  const Socket listening = listen_at("127.0.0.1", 0);
  EXPECT_EQ(own_address_of(listening), "127.0.0.1");
  EXPECT_TRUE(try_to_connect("127.0.0.1", port_of(listening), kLong));
  EXPECT_FALSE(try_to_connect("127.0.0.2", port_of(listening), kLong)) << "the same machine by another address";
}

TEST(Sockets, NameAnOccupiedPort) {
  const Socket listening = listen_at("127.0.0.1", 0);
  const std::string port = std::to_string(port_of(listening));
  EXPECT_TRUE(fails_with<InputError>({"port " + port + " of 127.0.0.1 is occupied", "MASTER_PORT"},
                                     [&] { listen_at("127.0.0.1", port_of(listening)); }));
  EXPECT_TRUE(fails_with<InputError>({"cannot listen at 192.0.2.1"}, [] { listen_at("192.0.2.1", 0); }));
}

TEST(Sockets, NameAnUnknownAddress) {
  EXPECT_TRUE(fails_with<InputError>({"not found"}, [] { listen_at("no.such.host.invalid", 0); }));
}

TEST(Sockets, InterfaceWithAnAddress) {
  EXPECT_FALSE(interface_with("127.0.0.1").empty());
  EXPECT_EQ(interface_with("192.0.2.1"), "") << "an address for documentation";
}

/// Returns both ends of a connection.
std::pair<Socket, Connection> connect_pair(bool is_trusted) {
  int files[2];
  EXPECT_EQ(socketpair(AF_UNIX, SOCK_STREAM, 0, files), 0);
  return {Socket(files[0]), Connection(Socket(files[1]), {}, is_trusted)};
}

TEST(Connections, AssembleMessagesFromPieces) {
  const std::string bytes =
      to_bytes({MessageKind::kSet, 7, {"key", "", "-5"}}) + to_bytes({}) + to_bytes({MessageKind::kBye, 8, {}});
  auto [there, here] = connect_pair(/*is_trusted=*/true);
  std::vector<Message> messages;
  for (const char byte : bytes) {
    Job::say(there, std::string(1, byte));
    here.receive([&](const Message& message) { messages.push_back(message); });
  }
  ASSERT_EQ(messages.size(), 2u) << "without the sign of life";
  EXPECT_EQ(messages[0].kind, MessageKind::kSet);
  EXPECT_EQ(messages[0].id, 7u);
  EXPECT_EQ(messages[0].parts, (std::vector<std::string>{"key", "", "-5"}));
  EXPECT_EQ(messages[1].kind, MessageKind::kBye);
}

TEST(Connections, RefuseMessagesOfAbsurdLength) {
  constexpr std::size_t kHeader = 12, kSize = 8;  // header of the message and of its part
  const std::string bytes = to_bytes({MessageKind::kSet, 0, {std::string(kMaxUntrustedBytes - kSize, 'x')}});
  const auto receive = [](const std::string& sent) {
    auto [there, here] = connect_pair(/*is_trusted=*/false);
    Job::say(there, sent);
    here.receive([](const Message&) {});
  };
  EXPECT_NO_THROW(receive(bytes));
  EXPECT_THROW(receive(to_bytes({MessageKind::kSet, 0, {std::string(kMaxUntrustedBytes, 'x')}}).substr(0, kHeader)),
               Error);
  for (const char high : {'\x01', '\xff'}) {  // byte of the part's size
    std::string absurd = bytes;
    absurd[kHeader + kSize - 1] = high;
    EXPECT_THROW(receive(absurd), Error);
  }
  std::string cut = to_bytes({MessageKind::kSet, 0, {"", ""}});
  cut[0] = kSize + 1;
  EXPECT_THROW(receive(cut), Error) << "half the size of a part";
}

}  // namespace
}  // namespace b3dgs
