#include "dist/control/rank_link.h"

#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <list>
#include <map>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "dist/control/message.h"

namespace b3dgs {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kMaxHello = 4096;  // bytes of the first message, before anything is known of the sender

// The one thread serves all: nobody who sends or connects without end may keep it from the others.
constexpr int kMaxReads = 16;
constexpr int kMaxAccepted = 64;
constexpr std::chrono::milliseconds kAcceptPause{500};

struct Connection {
  explicit Connection(Socket connected) : socket(std::move(connected)) {}

  Socket socket;
  MessageStream received;
  std::string to_send;
  Clock::time_point last_heard = Clock::now();  // of those that have not joined: when they connected
  int rank = -1;                                // -1: has not joined
  bool is_closing = false;                      // once everything is sent
};

struct Member {
  bool has_joined = false;
  bool has_left = false;
};

/// What ranks have sent for one gather or exchange.
struct Round {
  std::string label;
  int first_rank = 0;
  int count = 0;
  std::vector<std::vector<std::string>> parts;  // by sender; for each rank, or one for all
  std::vector<std::uint32_t> request;           // by rank; ids of the requests to answer
  std::vector<bool> is_there;
};

}  // namespace

class RankHub::Server {
 public:
  Server(Socket listening, int size, std::string job, const RankLimits& limits)
      : listening_(std::move(listening)),
        wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
        job_(std::move(job)),
        limits_(limits),
        members_(static_cast<std::size_t>(size)),
        rounds_of_(static_cast<std::size_t>(size), 0) {
    fcntl(listening_.fd(), F_SETFL, fcntl(listening_.fd(), F_GETFL) | O_NONBLOCK);
    thread_ = std::thread([this] { run(); });
  }
  ~Server() {
    is_stopping_ = true;
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = write(wake_.fd(), &one, sizeof one);
    thread_.join();
  }
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

 private:
  int size() const { return static_cast<int>(members_.size()); }

  void run() {
    const auto start = Clock::now();
    const auto beat_interval = limits_.silence / 6;
    auto next_beat = start + beat_interval;
    std::optional<Clock::time_point> stop_at;
    while (true) {
      wait_for_events(std::min(beat_interval, std::chrono::milliseconds(500)));
      const auto now = Clock::now();
      accept_new(now);
      for (Connection& connection : connections_) read_from(connection);
      if (now >= next_beat) {
        for (Connection& connection : connections_) {
          if (connection.rank >= 0) send(connection, {MessageKind::kBeat, 0, ""});
        }
        next_beat = now + beat_interval;
      }
      find_silent(now);
      if (joined_ < size() && now - start > limits_.join) report_missing();
      for (Connection& connection : connections_) flush(connection);
      connections_.remove_if([](const Connection& connection) { return !connection.socket; });
      if (!is_stopping_) continue;
      if (!stop_at) stop_at = now + limits_.silence;
      const bool all_left = std::all_of(members_.begin(), members_.end(),
                                        [](const Member& member) { return !member.has_joined || member.has_left; });
      const bool all_sent = std::all_of(connections_.begin(), connections_.end(),
                                        [](const Connection& connection) { return connection.to_send.empty(); });
      if ((all_left && all_sent) || (failure_ && now > *stop_at)) return;
    }
  }

  void wait_for_events(std::chrono::milliseconds limit) {
    std::vector<pollfd> files{{wake_.fd(), POLLIN, 0}, {listening_.fd(), POLLIN, 0}};
    for (const Connection& connection : connections_) {
      const short events = connection.to_send.empty() ? POLLIN : POLLIN | POLLOUT;
      files.push_back({connection.socket.fd(), events, 0});
    }
    if (is_stopping_) files[0].fd = -1;
    if (Clock::now() < accept_from_) files[1].fd = -1;
    poll(files.data(), files.size(), static_cast<int>(is_stopping_ ? 20 : limit.count()));
  }

  void accept_new(Clock::time_point now) {
    // A launcher may start all ranks anew while this rank 0 still ends: they have to wait for the next one.
    if (failure_ && joined_ == size()) listening_ = Socket();
    for (int i = 0; i < kMaxAccepted; ++i) {
      Socket socket(accept4(listening_.fd(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
      if (!socket) {
        // The connection goes on waiting, and poll() would return at once for it.
        if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM)
          accept_from_ = now + kAcceptPause;
        return;
      }
      const int yes = 1;
      setsockopt(socket.fd(), IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
      connections_.emplace_back(std::move(socket));
    }
  }

  void read_from(Connection& connection) {
    std::array<char, 65536> buffer;
    const int max_reads = connection.is_closing ? 1 : kMaxReads;
    for (int i = 0; i < max_reads && connection.socket; ++i) {
      const ssize_t n = recv(connection.socket.fd(), buffer.data(), buffer.size(), 0);
      if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) {
        lose(connection, "its process ended without saying why (killed?), or the network to it failed");
        return;
      }
      if (connection.is_closing) return;  // read only to notice that the other end closes it
      if (connection.rank >= 0) connection.last_heard = Clock::now();
      connection.received.feed(buffer.data(), static_cast<std::size_t>(n));
      try {
        while (!connection.is_closing) {
          const auto message = connection.received.next(connection.rank < 0 ? kMaxHello : kMaxMessage);
          if (!message) break;
          connection.rank < 0 ? join(connection, *message) : answer(connection, *message);
        }
      } catch (const std::exception& error) {
        lose(connection, error.what());
      }
    }
  }

  void lose(Connection& connection, const std::string& cause) {
    connection.socket = Socket();
    if (connection.rank < 0) return;
    Member& member = members_[static_cast<std::size_t>(connection.rank)];
    if (!member.has_left) fail(connection.rank, cause);
    member.has_left = true;
  }

  void join(Connection& connection, const Message& message) {
    const auto refuse = [&](const std::string& reason) {
      send(connection, {MessageKind::kRefused, 0, BodyWriter().bytes(reason).take()});
      connection.is_closing = true;
    };
    BodyReader body(message.body);
    if (message.kind != MessageKind::kHello || body.bytes() != kProtocol) {
      refuse("rank 0 runs another version of b3dgs");
      return;
    }
    if (body.bytes() != job_) {
      refuse("another job listens there; set MASTER_PORT to a free port (torchrun: --master-port)");
      return;
    }
    const std::int64_t rank = body.number(), their_size = body.number();
    if (their_size != size()) {
      const std::string difference = detail::concat("the ranks disagree on their number: WORLD_SIZE is ", size(),
                                                    " on rank 0 and ", their_size, " on rank ", rank);
      refuse(difference);
      fail(static_cast<int>(rank), difference);
      return;
    }
    if (rank < 0 || rank >= size()) {
      refuse(detail::concat("rank ", rank, " of ", size(), " does not exist"));
      return;
    }
    Member& member = members_[static_cast<std::size_t>(rank)];
    if (member.has_joined) {
      refuse(detail::concat("two processes say that they are rank ", rank, " of ", size()));
      return;
    }
    member.has_joined = true;
    connection.rank = static_cast<int>(rank);
    connection.last_heard = Clock::now();
    if (failure_) {
      send(connection, *failure_);
    } else if (++joined_ == size()) {
      for (Connection& other : connections_) {
        if (other.rank >= 0) send(other, {MessageKind::kWelcome, 0, ""});
      }
    }
  }

  void report_missing() {
    std::string missing;
    int first = -1, n = 0;
    for (int rank = 0; rank < size(); ++rank) {
      if (members_[static_cast<std::size_t>(rank)].has_joined) continue;
      if (first < 0) first = rank;
      if (++n <= 8) missing += (missing.empty() ? "" : ", ") + std::to_string(rank);
    }
    fail(first, detail::concat("did not join within ", limits_.join.count() / 1000, " s (missing: ", missing,
                               n > 8 ? ", ..." : "", "; is the number of ranks, WORLD_SIZE, right?)"));
  }

  void find_silent(Clock::time_point now) {
    for (Connection& connection : connections_) {
      if (now - connection.last_heard <= limits_.silence) continue;
      lose(connection, detail::concat("no sign of life for ", limits_.silence.count() / 1000, " s"));
    }
  }

  void fail(int rank, const std::string& cause) {
    if (failure_) return;
    failure_ = Message{MessageKind::kFailure, 0, BodyWriter().number(rank).bytes(cause).take()};
    for (Connection& connection : connections_) {
      if (connection.rank >= 0) send(connection, *failure_);
    }
  }

  void reply(Connection& connection, const Message& request, std::string body) {
    send(connection, {MessageKind::kReply, request.id, std::move(body)});
  }

  void answer(Connection& connection, const Message& message) {
    BodyReader body(message.body);
    switch (message.kind) {
      case MessageKind::kGather:
        gather(connection.rank, message.id, body);
        return;
      case MessageKind::kSet: {
        const std::string key = body.bytes();
        values_[key] = body.bytes();
        reply(connection, message, "");
        answer_waiting(key);
        return;
      }
      case MessageKind::kGet: {
        const std::string key = body.bytes();
        if (const auto found = values_.find(key); found != values_.end()) {
          reply(connection, message, found->second);
        } else {
          waiting_.emplace(key, std::make_pair(connection.rank, message.id));
        }
        return;
      }
      case MessageKind::kAdd: {
        const std::string key = body.bytes();
        std::string& value = values_[key];  // decimal digits, as in c10d's stores
        const std::int64_t sum = (value.empty() ? 0 : std::stoll(value)) + body.number();
        value = std::to_string(sum);
        reply(connection, message, BodyWriter().number(sum).take());
        answer_waiting(key);
        return;
      }
      case MessageKind::kCheck: {
        bool has_all = true;
        for (std::int64_t n = body.number(); n > 0; --n) has_all = values_.count(body.bytes()) > 0 && has_all;
        reply(connection, message, BodyWriter().number(has_all ? 1 : 0).take());
        return;
      }
      case MessageKind::kDelete:
        reply(connection, message, BodyWriter().number(values_.erase(body.bytes()) > 0 ? 1 : 0).take());
        return;
      case MessageKind::kFail:
        fail(connection.rank, body.bytes());
        reply(connection, message, "");
        return;
      case MessageKind::kBye:
        members_[static_cast<std::size_t>(connection.rank)].has_left = true;
        reply(connection, message, "");
        check_rounds();
        return;
      case MessageKind::kBeat:
        return;
      default:
        throw Error("a message of an unknown kind");
    }
  }

  void answer_waiting(const std::string& key) {
    const auto [begin, end] = waiting_.equal_range(key);
    for (auto row = begin; row != end; ++row) {
      const auto [rank, id] = row->second;
      send_to(rank, {MessageKind::kReply, id, values_[key]});
    }
    waiting_.erase(begin, end);
  }

  void send_to(int rank, const Message& message) {
    for (Connection& connection : connections_) {
      if (connection.rank == rank) send(connection, message);
    }
  }

  void gather(int rank, std::uint32_t id, BodyReader& body) {
    const auto n = static_cast<std::size_t>(size()), row = static_cast<std::size_t>(rank);
    const std::string label = body.bytes();
    Round& round = rounds_[rounds_of_[row]++];
    if (round.parts.empty()) {
      round.label = label;
      round.first_rank = rank;
      round.parts.resize(n);
      round.request.resize(n);
      round.is_there.resize(n);
    }
    if (round.label != label) {
      fail(rank, detail::concat("it is at \"", label, "\", and rank ", round.first_rank, " at \"", round.label, '"'));
      return;
    }
    const std::int64_t n_parts = body.number();
    if (n_parts != 1 && n_parts != size()) throw Error("a damaged message");
    for (std::int64_t i = 0; i < n_parts; ++i) round.parts[row].push_back(body.bytes());
    round.request[row] = id;
    round.is_there[row] = true;
    if (++round.count < size()) {
      check_rounds();
      return;
    }
    for (std::size_t other = 0; other < n; ++other) {
      BodyWriter for_other;
      for (const auto& parts : round.parts) for_other.bytes(parts[parts.size() == 1 ? 0 : other]);
      send_to(static_cast<int>(other), {MessageKind::kReply, round.request[other], for_other.take()});
    }
    rounds_.erase(rounds_.begin());  // ranks take part in every round, so rounds are completed in order
  }

  /// Nobody may wait for a rank that has finished.
  void check_rounds() {
    for (const auto& [number, round] : rounds_) {
      for (std::size_t rank = 0; rank < members_.size(); ++rank) {
        if (!members_[rank].has_left || round.is_there[rank]) continue;
        fail(static_cast<int>(rank),
             detail::concat("it finished, and rank ", round.first_rank, " waits for it at \"", round.label, '"'));
      }
    }
  }

  void send(Connection& connection, const Message& message) {
    if (connection.socket) connection.to_send += to_bytes(message);
  }

  void flush(Connection& connection) {
    while (connection.socket && !connection.to_send.empty()) {
      const ssize_t n = ::send(connection.socket.fd(), connection.to_send.data(), connection.to_send.size(),
                               MSG_NOSIGNAL | MSG_DONTWAIT);
      if (n < 0 && errno == EINTR) continue;
      if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
      if (n < 0) {
        lose(connection, "its process ended without saying why (killed?), or the network to it failed");
        return;
      }
      connection.to_send.erase(0, static_cast<std::size_t>(n));
    }
    if (connection.is_closing && connection.to_send.empty() && connection.socket) {
      shutdown(connection.socket.fd(), SHUT_WR);  // the rank closes it when it has read the message
    }
  }

  Socket listening_, wake_;
  std::string job_;
  RankLimits limits_;
  std::list<Connection> connections_;
  Clock::time_point accept_from_{};
  std::vector<Member> members_;
  int joined_ = 0;
  std::optional<Message> failure_;
  std::map<std::string, std::string> values_;
  std::multimap<std::string, std::pair<int, std::uint32_t>> waiting_;  // by key: rank and id of the request
  std::map<std::int64_t, Round> rounds_;
  std::vector<std::int64_t> rounds_of_;  // rounds that each rank has taken part in
  std::atomic<bool> is_stopping_{false};
  std::thread thread_;
};

RankHub::RankHub(Socket listening, int size, std::string job, const RankLimits& limits)
    : server_(std::make_unique<Server>(std::move(listening), size, std::move(job), limits)) {}

RankHub::~RankHub() = default;

}  // namespace b3dgs
