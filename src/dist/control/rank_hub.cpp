#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <list>
#include <utility>

#include "dist/control/rank_link.h"

namespace b3dgs {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kAcceptPause{500};

/// The other end of a connection.
struct Peer {
  Peer(Socket socket, const RankLimits& limits) : connection(std::move(socket), limits, /*is_trusted=*/false) {}

  Connection connection;    // closed if it is lost
  int rank = -1;            // -1 before it joins
  bool is_refused = false;  // it is told why, and later messages are ignored
  bool has_left = false;
  std::optional<Message> gather;  // its request of the current round, in which others are missing
};

class Server final : public RankHub {
 public:
  Server(Socket listening, int size, std::string job, const RankLimits& limits)
      : listening_(std::move(listening)),
        job_(std::move(job)),
        limits_(limits),
        members_(static_cast<std::size_t>(size), nullptr) {
    fcntl(listening_.fd(), F_SETFL, fcntl(listening_.fd(), F_GETFL) | O_NONBLOCK);
    thread_ = std::thread([this] { run(); });
  }
  ~Server() override {
    is_stopping_ = true;
    wake_.wake();
    thread_.join();
  }

 private:
  int size() const { return static_cast<int>(members_.size()); }

  void run() {
    const auto start = Clock::now();
    std::optional<Clock::time_point> stop_at;
    while (true) {
      wait_for_events();
      accept_one();
      for (Peer& peer : peers_) {
        attempt(peer, [&] { peer.connection.receive([&](const Message& message) { handle(peer, message); }); });
      }
      if (!failure_ && n_joined_ < size() && Clock::now() - start > limits_.join) report_missing();
      for (Peer& peer : peers_) attempt(peer, [&] { peer.connection.flush(); });
      peers_.remove_if([](const Peer& peer) { return !peer.connection.socket() && peer.rank < 0; });
      if (!is_stopping_) continue;
      if (!stop_at) stop_at = Clock::now() + limits_.silence;
      const bool is_done = std::all_of(peers_.begin(), peers_.end(), [](const Peer& peer) {
        return (peer.rank < 0 || peer.has_left) && !peer.connection.has_unsent();
      });
      if (is_done || (failure_ && Clock::now() > *stop_at)) return;
    }
  }

  void wait_for_events() {
    const bool may_accept = Clock::now() >= accept_from_;
    std::vector<pollfd> files{{wake_.fd(), POLLIN, 0}, {may_accept ? listening_.fd() : -1, POLLIN, 0}};
    for (const Peer& peer : peers_) {
      const short events = peer.connection.has_unsent() ? POLLIN | POLLOUT : POLLIN;
      files.push_back({peer.connection.socket().fd(), events, 0});
    }
    poll(files.data(), files.size(), static_cast<int>(limits_.beat().count()));
    wake_.reset();
  }

  /// Accepts one connection at a time, because endless connections must not starve the others.
  void accept_one() {
    // A launcher may restart all ranks while this rank 0 still ends. They have to wait for the next rank 0.
    if (failure_ && n_joined_ == size()) listening_.close();
    Socket socket(accept4(listening_.fd(), nullptr, nullptr, SOCK_CLOEXEC));
    if (socket) {
      peers_.emplace_back(std::move(socket), limits_);
    } else if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
      accept_from_ = Clock::now() + kAcceptPause;  // the connection keeps waiting, so poll() would return at once
    }
  }

  /// Treats an error of a connection as a failure of its rank.
  template <class Work>
  void attempt(Peer& peer, Work&& work) {
    if (!peer.connection.socket()) return;
    try {
      work();
    } catch (const std::exception& error) {
      peer.connection.close();
      if (peer.rank >= 0 && !std::exchange(peer.has_left, true)) fail(peer.rank, error.what());
    }
  }

  void handle(Peer& peer, const Message& message) {
    if (peer.rank >= 0) return answer(peer, message);
    if (peer.is_refused) return;
    const std::string refusal = join(peer, message);
    peer.is_refused = !refusal.empty();
    if (peer.is_refused) peer.connection.queue({MessageKind::kRefused, 0, {refusal}});
  }

  /// Returns why the rank may not join, or "".
  std::string join(Peer& peer, const Message& message) {
    if (message.kind != MessageKind::kHello || message.parts.at(0) != kProtocol) {
      return "rank 0 runs another version of b3dgs";
    }
    if (message.parts.at(1) != job_) {
      return "another job listens there; set MASTER_PORT to a free port (torchrun: --master-port)";
    }
    const int rank = std::stoi(message.parts.at(2)), their_size = std::stoi(message.parts.at(3));
    if (their_size != size()) {
      const std::string difference = detail::concat("the ranks disagree on their number: WORLD_SIZE is ", size(),
                                                    " on rank 0 and ", their_size, " on rank ", rank);
      fail(rank, difference);
      return difference;
    }
    if (rank < 0 || rank >= size()) return detail::concat("rank ", rank, " of ", size(), " does not exist");
    if (member(rank)) return detail::concat("two processes say that they are rank ", rank, " of ", size());
    member(rank) = &peer;
    peer.rank = rank;
    peer.connection.trust();
    if (failure_) {
      peer.connection.queue(*failure_);
    } else if (++n_joined_ == size()) {
      send_to_all({MessageKind::kReply, kHelloId, {}});
    }
    return "";
  }

  void report_missing() {
    std::vector<int> missing;
    for (int rank = 0; rank < size(); ++rank) {
      if (!member(rank)) missing.push_back(rank);
    }
    std::string list = std::to_string(missing[0]);
    for (std::size_t i = 1; i < std::min<std::size_t>(missing.size(), 8); ++i) list += detail::concat(", ", missing[i]);
    fail(missing[0],
         detail::concat("did not join within ", limits_.join.count() / 1000, " s (missing: ", list,
                        missing.size() > 8 ? ", ..." : "", "; is the number of ranks, WORLD_SIZE, right?)"));
  }

  void fail(int rank, const std::string& cause) {
    if (failure_) return;
    failure_ = Message{MessageKind::kFailure, 0, {std::to_string(rank), cause}};
    send_to_all(*failure_);
  }

  void send_to_all(const Message& message) {
    for (Peer* const peer : members_) {
      if (peer) peer->connection.queue(message);
    }
  }

  void answer(Peer& peer, const Message& message) {
    const auto reply = [&](std::vector<std::string> parts) {
      peer.connection.queue({MessageKind::kReply, message.id, std::move(parts)});
    };
    const auto part = [&](std::size_t i) -> const std::string& { return message.parts.at(i); };
    switch (message.kind) {
      case MessageKind::kGather:
        if (message.parts.size() != 2 && message.parts.size() != members_.size() + 1) throw Error("a damaged message");
        peer.gather = message;
        return check_round();
      case MessageKind::kSet:
        reply({});
        return set(part(0), part(1));
      case MessageKind::kGet:
        if (const auto found = values_.find(part(0)); found != values_.end()) return reply({found->second});
        waiting_.emplace(part(0), std::pair(&peer, message.id));
        return;
      case MessageKind::kAdd: {
        const auto found = values_.find(part(0));  // decimal digits, as in c10d's stores
        const std::int64_t before = found == values_.end() ? 0 : std::stoll(found->second);
        const std::string sum = std::to_string(before + std::stoll(part(1)));
        reply({sum});
        return set(part(0), sum);
      }
      case MessageKind::kCheck:
        return reply({std::to_string(values_.count(part(0)))});
      case MessageKind::kDelete:
        return reply({std::to_string(values_.erase(part(0)))});
      case MessageKind::kFail:
        fail(peer.rank, part(0));
        return reply({});
      case MessageKind::kBye:
        peer.has_left = true;
        reply({});
        return check_round();
      default:
        throw Error("a message of an unknown kind");
    }
  }

  void set(const std::string& key, const std::string& value) {
    values_[key] = value;
    const auto [begin, end] = waiting_.equal_range(key);
    for (auto row = begin; row != end; ++row) {
      const auto& [peer, id] = row->second;
      peer->connection.queue({MessageKind::kReply, id, {value}});
    }
    waiting_.erase(begin, end);
  }

  /// Answers the requests of a round when all ranks have sent one. Each waits for its answer before it sends another.
  void check_round() {
    const auto first = std::find_if(members_.begin(), members_.end(), [](Peer* peer) { return peer && peer->gather; });
    if (first == members_.end()) return;
    const std::string& label = (*first)->gather->parts[0];
    bool is_complete = true;
    for (const Peer* const peer : members_) {
      is_complete = is_complete && peer && peer->gather;
      if (!peer) continue;
      if (peer->gather && peer->gather->parts[0] != label) {
        return fail(peer->rank, detail::concat("it is at \"", peer->gather->parts[0], "\", and rank ", (*first)->rank,
                                               " at \"", label, '"'));
      }
      if (peer->has_left && !peer->gather) {
        return fail(peer->rank,
                    detail::concat("it finished, and rank ", (*first)->rank, " waits for it at \"", label, '"'));
      }
    }
    if (!is_complete) return;
    for (std::size_t to = 0; to < members_.size(); ++to) {
      std::vector<std::string> parts;
      for (const Peer* const from : members_) {
        const std::vector<std::string>& sent = from->gather->parts;
        parts.push_back(sent[sent.size() == 2 ? 1 : to + 1]);
      }
      members_[to]->connection.queue({MessageKind::kReply, members_[to]->gather->id, std::move(parts)});
    }
    for (Peer* const peer : members_) peer->gather.reset();
  }

  Peer*& member(int rank) { return members_[static_cast<std::size_t>(rank)]; }

  Socket listening_;
  Waker wake_;
  std::string job_;
  RankLimits limits_;
  std::list<Peer> peers_;
  std::vector<Peer*> members_;  // by rank; null before it joins
  int n_joined_ = 0;
  Clock::time_point accept_from_{};
  std::optional<Message> failure_;
  std::map<std::string, std::string> values_;
  std::multimap<std::string, std::pair<Peer*, std::uint32_t>> waiting_;  // by key: the peer, and the id of its request
  std::atomic<bool> is_stopping_{false};
  std::thread thread_;
};

}  // namespace

std::unique_ptr<RankHub> start_rank_hub(Socket listening, int size, std::string job, const RankLimits& limits) {
  return std::make_unique<Server>(std::move(listening), size, std::move(job), limits);
}

}  // namespace b3dgs
