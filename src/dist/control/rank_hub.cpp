#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <list>
#include <utility>

#include "dist/control/rank_link.h"

namespace b3dgs {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kMaxHello = 4096;  // bytes of the first message, before anything is known of the sender

// The one thread serves all: nobody who connects without end may keep it from the others.
constexpr int kMaxAccepted = 64;
constexpr std::chrono::milliseconds kAcceptPause{500};

/// The other end of a connection.
struct Peer {
  explicit Peer(Socket socket) : connection(std::move(socket), kMaxHello) {}

  Connection connection;
  Clock::time_point last_heard = Clock::now();  // of those that have not joined: when they connected
  int rank = -1;                                // -1: has not joined
  bool is_refused = false;                      // it is told why; what it sends from then on is ignored
};

struct Member {
  Peer* peer = nullptr;
  bool has_joined = false, has_left = false;
  std::int64_t n_rounds = 0;  // that it has taken part in
};

/// What ranks have sent for one gather.
struct Round {
  int first_rank = 0;
  std::vector<std::optional<Message>> requests;  // by rank

  const std::string& label() const { return requests[static_cast<std::size_t>(first_rank)]->parts[0]; }
};

}  // namespace

class RankHub::Server {
 public:
  Server(Socket listening, int size, std::string job, const RankLimits& limits)
      : listening_(std::move(listening)),
        job_(std::move(job)),
        limits_(limits),
        members_(static_cast<std::size_t>(size)) {
    fcntl(listening_.fd(), F_SETFL, fcntl(listening_.fd(), F_GETFL) | O_NONBLOCK);
    thread_ = std::thread([this] { run(); });
  }
  ~Server() {
    is_stopping_ = true;
    wake_.wake();
    thread_.join();
  }
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

 private:
  int size() const { return static_cast<int>(members_.size()); }
  Member& member(int rank) { return members_[static_cast<std::size_t>(rank)]; }

  void run() {
    const auto start = Clock::now();
    const auto beat_interval = limits_.silence / 6;
    auto next_beat = start + beat_interval;
    std::optional<Clock::time_point> stop_at;
    while (true) {
      wait_for_events(std::min(beat_interval, std::chrono::milliseconds(500)));
      const auto now = Clock::now();
      accept_new(now);
      for (Peer& peer : peers_) read_from(peer);
      if (now >= next_beat) {
        send_to_all({});
        next_beat = now + beat_interval;
      }
      find_silent(now);
      if (joined_ < size() && now - start > limits_.join) report_missing();
      for (Peer& peer : peers_) attempt(peer, [&] { peer.connection.flush(); });
      peers_.remove_if([](const Peer& peer) { return !peer.connection.socket(); });
      if (!is_stopping_) continue;
      if (!stop_at) stop_at = now + limits_.silence;
      const bool all_left = std::all_of(members_.begin(), members_.end(),
                                        [](const Member& member) { return !member.has_joined || member.has_left; });
      const bool all_sent =
          std::none_of(peers_.begin(), peers_.end(), [](const Peer& peer) { return peer.connection.has_unsent(); });
      if ((all_left && all_sent) || (failure_ && now > *stop_at)) return;
    }
  }

  void wait_for_events(std::chrono::milliseconds limit) {
    std::vector<pollfd> files{{wake_.fd(), POLLIN, 0}, {listening_.fd(), POLLIN, 0}};
    for (const Peer& peer : peers_) {
      const short events = peer.connection.has_unsent() ? POLLIN | POLLOUT : POLLIN;
      files.push_back({peer.connection.socket().fd(), events, 0});
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
      peers_.emplace_back(std::move(socket));
    }
  }

  void read_from(Peer& peer) {
    attempt(peer, [&] {
      const bool is_heard = peer.connection.receive([&](const Message& message) {
        if (peer.is_refused) return;
        peer.rank < 0 ? join(peer, message) : answer(peer, message);
      });
      if (is_heard && peer.rank >= 0) peer.last_heard = Clock::now();
    });
  }

  /// What goes wrong with a connection is a failure of its rank.
  template <class Work>
  void attempt(Peer& peer, Work&& work) {
    try {
      if (peer.connection.socket()) work();
    } catch (const std::exception& error) {
      lose(peer, error.what());
    }
  }

  void lose(Peer& peer, const std::string& cause) {
    peer.connection.close();
    if (peer.rank < 0) return;
    Member& lost = member(peer.rank);
    lost.peer = nullptr;
    if (!lost.has_left) fail(peer.rank, cause);
    lost.has_left = true;
  }

  void join(Peer& peer, const Message& message) {
    const auto refuse = [&](const std::string& reason) {
      peer.connection.queue({MessageKind::kRefused, 0, {reason}});
      peer.is_refused = true;
    };
    if (message.kind != MessageKind::kHello || message.parts.at(0) != kProtocol) {
      refuse("rank 0 runs another version of b3dgs");
      return;
    }
    if (message.parts.at(1) != job_) {
      refuse("another job listens there; set MASTER_PORT to a free port (torchrun: --master-port)");
      return;
    }
    const int rank = std::stoi(message.parts.at(2)), their_size = std::stoi(message.parts.at(3));
    if (their_size != size()) {
      const std::string difference = detail::concat("the ranks disagree on their number: WORLD_SIZE is ", size(),
                                                    " on rank 0 and ", their_size, " on rank ", rank);
      refuse(difference);
      fail(rank, difference);
      return;
    }
    if (rank < 0 || rank >= size()) {
      refuse(detail::concat("rank ", rank, " of ", size(), " does not exist"));
      return;
    }
    if (member(rank).has_joined) {
      refuse(detail::concat("two processes say that they are rank ", rank, " of ", size()));
      return;
    }
    member(rank).has_joined = true;
    member(rank).peer = &peer;
    peer.rank = rank;
    peer.connection.allow(kMaxMessage);
    if (failure_) {
      peer.connection.queue(*failure_);
    } else if (++joined_ == size()) {
      send_to_all({MessageKind::kReply, kHelloId, {}});
    }
  }

  void report_missing() {
    std::string missing;
    int first = -1, n = 0;
    for (int rank = 0; rank < size(); ++rank) {
      if (member(rank).has_joined) continue;
      if (first < 0) first = rank;
      if (++n <= 8) missing += (missing.empty() ? "" : ", ") + std::to_string(rank);
    }
    fail(first, detail::concat("did not join within ", limits_.join.count() / 1000, " s (missing: ", missing,
                               n > 8 ? ", ..." : "", "; is the number of ranks, WORLD_SIZE, right?)"));
  }

  void find_silent(Clock::time_point now) {
    for (Peer& peer : peers_) {
      if (now - peer.last_heard <= limits_.silence) continue;
      lose(peer, detail::concat("no sign of life for ", limits_.silence.count() / 1000, " s"));
    }
  }

  void fail(int rank, const std::string& cause) {
    if (failure_) return;
    failure_ = Message{MessageKind::kFailure, 0, {std::to_string(rank), cause}};
    send_to_all(*failure_);
  }

  void send_to_all(const Message& message) {
    for (const Member& member : members_) {
      if (member.peer != nullptr) member.peer->connection.queue(message);
    }
  }

  void reply(int rank, std::uint32_t id, std::vector<std::string> parts) {
    if (Peer* const peer = member(rank).peer) peer->connection.queue({MessageKind::kReply, id, std::move(parts)});
  }

  void answer(const Peer& peer, const Message& message) {
    const auto reply_with = [&](std::vector<std::string> parts) { reply(peer.rank, message.id, std::move(parts)); };
    const auto part = [&](std::size_t i) -> const std::string& { return message.parts.at(i); };
    switch (message.kind) {
      case MessageKind::kGather:
        return gather(peer.rank, message);
      case MessageKind::kSet:
        reply_with({});
        return set(part(0), part(1));
      case MessageKind::kGet:
        if (const auto found = values_.find(part(0)); found != values_.end()) return reply_with({found->second});
        waiting_.emplace(part(0), std::make_pair(peer.rank, message.id));
        return;
      case MessageKind::kAdd: {
        const auto found = values_.find(part(0));  // decimal digits, as in c10d's stores
        const std::int64_t before = found == values_.end() ? 0 : std::stoll(found->second);
        const std::string sum = std::to_string(before + std::stoll(part(1)));
        reply_with({sum});
        return set(part(0), sum);
      }
      case MessageKind::kCheck: {
        const bool has_all = std::all_of(message.parts.begin(), message.parts.end(),
                                         [&](const std::string& key) { return values_.count(key) > 0; });
        return reply_with({has_all ? "1" : "0"});
      }
      case MessageKind::kDelete:
        return reply_with({std::to_string(values_.erase(part(0)))});
      case MessageKind::kFail:
        fail(peer.rank, part(0));
        return reply_with({});
      case MessageKind::kBye:
        member(peer.rank).has_left = true;
        reply_with({});
        return check_rounds();
      case MessageKind::kBeat:
        return;
      default:
        throw Error("a message of an unknown kind");
    }
  }

  void set(const std::string& key, const std::string& value) {
    values_[key] = value;
    const auto [begin, end] = waiting_.equal_range(key);
    for (auto row = begin; row != end; ++row) reply(row->second.first, row->second.second, {value});
    waiting_.erase(begin, end);
  }

  void gather(int rank, const Message& message) {
    if (message.parts.size() != 2 && message.parts.size() != members_.size() + 1) throw Error("a damaged message");
    Round& round = rounds_[member(rank).n_rounds++];
    if (round.requests.empty()) {
      round.first_rank = rank;
      round.requests.resize(members_.size());
    } else if (round.label() != message.parts[0]) {
      fail(rank, detail::concat("it is at \"", message.parts[0], "\", and rank ", round.first_rank, " at \"",
                                round.label(), '"'));
      return;
    }
    round.requests[static_cast<std::size_t>(rank)] = message;
    if (std::any_of(round.requests.begin(), round.requests.end(), [](const auto& request) { return !request; })) {
      check_rounds();
      return;
    }
    for (std::size_t to = 0; to < members_.size(); ++to) {
      std::vector<std::string> parts;
      for (const auto& from : round.requests) parts.push_back(from->parts[from->parts.size() == 2 ? 1 : to + 1]);
      reply(static_cast<int>(to), round.requests[to]->id, std::move(parts));
    }
    rounds_.erase(rounds_.begin());  // ranks take part in every round, so rounds are completed in order
  }

  /// Nobody may wait for a rank that has finished.
  void check_rounds() {
    for (const auto& [number, round] : rounds_) {
      for (std::size_t rank = 0; rank < members_.size(); ++rank) {
        if (!members_[rank].has_left || round.requests[rank]) continue;
        fail(static_cast<int>(rank),
             detail::concat("it finished, and rank ", round.first_rank, " waits for it at \"", round.label(), '"'));
      }
    }
  }

  Socket listening_;
  Waker wake_;
  std::string job_;
  RankLimits limits_;
  std::list<Peer> peers_;
  Clock::time_point accept_from_{};
  std::vector<Member> members_;
  int joined_ = 0;
  std::optional<Message> failure_;
  std::map<std::string, std::string> values_;
  std::multimap<std::string, std::pair<int, std::uint32_t>> waiting_;  // by key: rank and id of the request
  std::map<std::int64_t, Round> rounds_;
  std::atomic<bool> is_stopping_{false};
  std::thread thread_;
};

RankHub::RankHub(Socket listening, int size, std::string job, const RankLimits& limits)
    : server_(std::make_unique<Server>(std::move(listening), size, std::move(job), limits)) {}

RankHub::~RankHub() = default;

}  // namespace b3dgs
