#include "dist/control/rank_link.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <map>
#include <mutex>
#include <thread>

#include "dist/control/message.h"
#include "dist/control/socket.h"

namespace b3dgs {

namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kFarewell{5000};

std::string first_line(const std::string& text) {
  return text.substr(0, std::min<std::size_t>(text.find('\n'), 2000));
}

}  // namespace

class RankLink::Client {
 public:
  Client(const std::string& address, int port, int rank, int size, const std::string& job, const RankLimits& limits)
      : rank_(rank), size_(size), limits_(limits), wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    const auto end = Clock::now() + limits.join;
    socket_ = connect_until(address, port, end);
    own_address_ = own_address_of(socket_);
    last_heard_ = Clock::now();
    write_message({MessageKind::kHello, 0, BodyWriter().bytes(kProtocol).bytes(job).number(rank).number(size).take()});
    thread_ = std::thread([this] { run(); });
    std::unique_lock lock(mutex_);
    // The hub gives up after limits.join; this rank may have started later.
    changed_.wait_until(lock, end + limits.silence, [&] { return is_welcome_ || failure_ || refusal_; });
    if (is_welcome_) return;
    is_acknowledged_ = true;
    const std::optional<PeerError> failure = failure_;
    const std::string where = detail::concat("rank ", rank, " of ", size, " cannot join at ", address, " port ", port);
    const std::string refusal = refusal_.value_or("");
    lock.unlock();
    stop();
    if (!refusal.empty()) input_error(where, ": ", refusal);
    if (failure) throw PeerError(*failure);
    input_error(
        where, ": what listens there is not rank 0 of b3dgs; set MASTER_PORT to a free port (torchrun: --master-port)");
  }
  ~Client() { stop(); }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }
  const std::string& own_address() const { return own_address_; }

  /// Sends a request and waits for its answer.
  std::string request(MessageKind kind, std::string body, std::optional<std::chrono::milliseconds> limit = {}) {
    std::unique_lock lock(mutex_);
    throw_if_failed_locked();
    const std::uint32_t id = next_id_++;
    lock.unlock();
    write_message({kind, id, std::move(body)});
    lock.lock();
    const auto is_over = [&] { return replies_.count(id) > 0 || failure_; };
    if (limit) {
      changed_.wait_for(lock, *limit, is_over);
    } else {
      changed_.wait(lock, is_over);
    }
    if (const auto found = replies_.find(id); found != replies_.end()) {
      std::string reply = std::move(found->second);
      replies_.erase(found);
      return reply;
    }
    throw_if_failed_locked();
    throw Error("no answer from rank 0");
  }

  void throw_if_failed() {
    const std::lock_guard lock(mutex_);
    throw_if_failed_locked();
  }

  bool wait_for_failure(std::chrono::milliseconds limit) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, limit, [&] { return failure_.has_value(); });
  }

  void on_failure(std::function<void()> call) {
    std::unique_lock lock(mutex_);
    if (!failure_) {
      on_failure_ = std::move(call);
      return;
    }
    lock.unlock();
    call();
  }

  void fail(const std::string& cause) noexcept {
    try {
      {
        const std::lock_guard lock(mutex_);
        if (is_closed_) return;
        is_closed_ = is_acknowledged_ = true;
        on_failure_ = nullptr;
      }
      request(MessageKind::kFail, BodyWriter().bytes(first_line(cause)).take(), kFarewell);
    } catch (const std::exception&) {  // another rank has failed before, or rank 0 does not answer
    }
  }

  void close() noexcept {
    try {
      {
        const std::lock_guard lock(mutex_);
        if (is_closed_) return;
        is_closed_ = is_acknowledged_ = true;
        on_failure_ = nullptr;
      }
      request(MessageKind::kBye, "", kFarewell);
    } catch (const std::exception&) {
    }
  }

 private:
  static Socket connect_until(const std::string& address, int port, Clock::time_point end) {
    std::chrono::milliseconds pause{20};
    while (true) {
      std::optional<Socket> socket = try_to_connect(address, port, std::chrono::milliseconds(5000));
      if (socket) return std::move(*socket);
      if (Clock::now() > end) input_error("rank 0 does not listen at ", address, " port ", port);
      std::this_thread::sleep_for(pause);
      pause = std::min(pause * 2, std::chrono::milliseconds(500));
    }
  }

  void throw_if_failed_locked() {
    if (!failure_) return;
    is_acknowledged_ = true;
    throw PeerError(*failure_);
  }

  /// Sends all of it: what follows a part of a message would be read as the rest of it. A connection that fails is
  /// noticed by run().
  void write_message(const Message& message) {
    const std::string bytes = to_bytes(message);
    const std::lock_guard lock(write_mutex_);
    auto end = Clock::now() + limits_.silence;
    std::size_t sent = 0;
    while (sent < bytes.size() && !is_stuck_) {
      const ssize_t n = send(socket_.fd(), bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL | MSG_DONTWAIT);
      if (n > 0) {
        sent += static_cast<std::size_t>(n);
        end = Clock::now() + limits_.silence;
      } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
        const auto rest = std::chrono::ceil<std::chrono::milliseconds>(end - Clock::now());
        pollfd file{socket_.fd(), POLLOUT, 0};
        if (rest.count() <= 0) {
          is_stuck_ = true;
        } else {
          poll(&file, 1, static_cast<int>(rest.count()));  // may end early, by a signal
        }
      } else if (errno != EINTR) {
        return;
      }
    }
  }

  /// The thread: reads, sends signs of life, and notices that rank 0 is lost.
  void run() {
    const auto beat_interval = limits_.silence / 6;
    auto next_beat = Clock::now() + beat_interval;
    std::optional<Clock::time_point> stuck_at;
    while (!is_stopping_) {
      const bool is_connected = !has_lost_hub_;
      std::array<pollfd, 2> files{pollfd{wake_.fd(), POLLIN, 0}, pollfd{is_connected ? socket_.fd() : -1, POLLIN, 0}};
      poll(files.data(), files.size(), static_cast<int>(std::min<std::int64_t>(beat_interval.count(), 500)));
      if (is_connected) read();
      const auto now = Clock::now();
      if (!has_lost_hub_ && now >= next_beat) {
        write_message({MessageKind::kBeat, 0, ""});
        next_beat = now + beat_interval;
      }
      if (!has_lost_hub_ && is_stuck_) {
        lose_hub(detail::concat("it took nothing of a message for ", limits_.silence.count() / 1000, " s"));
      }
      if (!has_lost_hub_ && now - last_heard_ > limits_.silence) {
        lose_hub(detail::concat("no sign of life for ", limits_.silence.count() / 1000, " s"));
      }
      const std::lock_guard lock(mutex_);
      if (!failure_ || is_acknowledged_) continue;
      if (!stuck_at) stuck_at = now + limits_.stuck;
      if (now > *stuck_at) end_process();
    }
  }

  void read() {
    std::array<char, 65536> buffer;
    while (true) {
      const ssize_t n = recv(socket_.fd(), buffer.data(), buffer.size(), MSG_DONTWAIT);
      if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) {
        lose_hub("its process ended without saying why (killed?), or the network to it failed");
        return;
      }
      last_heard_ = Clock::now();
      received_.feed(buffer.data(), static_cast<std::size_t>(n));
      try {
        while (std::optional<Message> message = received_.next(kMaxMessage)) handle(*message);
      } catch (const Error& error) {
        lose_hub(error.what());
        return;
      }
    }
  }

  void handle(const Message& message) {
    BodyReader body(message.body);
    switch (message.kind) {
      case MessageKind::kBeat:
        return;
      case MessageKind::kWelcome: {
        const std::lock_guard lock(mutex_);
        is_welcome_ = true;
        break;
      }
      case MessageKind::kRefused: {
        const std::lock_guard lock(mutex_);
        refusal_ = body.bytes();
        break;
      }
      case MessageKind::kReply: {
        const std::lock_guard lock(mutex_);
        replies_[message.id] = message.body;
        break;
      }
      case MessageKind::kFailure: {
        const std::int64_t rank = body.number();
        note_failure(static_cast<int>(rank), body.bytes());
        return;
      }
      default:
        throw Error("what listens there is not rank 0 of b3dgs");
    }
    changed_.notify_all();
  }

  void lose_hub(const std::string& cause) {
    has_lost_hub_ = true;
    note_failure(0, cause);
  }

  void note_failure(int rank, const std::string& cause) {
    std::function<void()> call;
    {
      const std::lock_guard lock(mutex_);
      if (failure_ || refusal_) return;
      failure_.emplace(rank, size_, cause);
      call = std::move(on_failure_);
      on_failure_ = nullptr;
    }
    changed_.notify_all();
    // Rank 0 waits for this farewell before it ends.
    if (!has_lost_hub_) write_message({MessageKind::kBye, 0, ""});
    if (call) std::thread(std::move(call)).detach();  // this thread must go on if it hangs
  }

  [[noreturn]] void end_process() const {
    const std::string line = detail::concat("error: ", failure_->what(), "\n");
    [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, line.data(), line.size());
    _exit(PeerError::kExitCode);
  }

  void stop() {
    if (!thread_.joinable()) return;
    is_stopping_ = true;
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = write(wake_.fd(), &one, sizeof one);
    thread_.join();
  }

  int rank_, size_;
  RankLimits limits_;
  Socket wake_, socket_;
  std::string own_address_;
  std::mutex write_mutex_;
  std::atomic<bool> is_stuck_{false};  // within a message

  // of the thread
  MessageStream received_;
  Clock::time_point last_heard_;
  bool has_lost_hub_ = false;

  std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  bool is_welcome_ = false;
  std::optional<std::string> refusal_;
  std::optional<PeerError> failure_;
  bool is_acknowledged_ = false;  // this rank's own thread knows of the failure, or has finished
  bool is_closed_ = false;
  std::function<void()> on_failure_;
  std::uint32_t next_id_ = 1;
  std::map<std::uint32_t, std::string> replies_;

  std::atomic<bool> is_stopping_{false};
  std::thread thread_;
};

RankLink::RankLink(const std::string& address, int port, int rank, int size, const std::string& job,
                   const RankLimits& limits)
    : client_(std::make_unique<Client>(address, port, rank, size, job, limits)) {}

RankLink::~RankLink() {
  close();
}

int RankLink::rank() const {
  return client_->rank();
}
int RankLink::size() const {
  return client_->size();
}
std::string RankLink::own_address() const {
  return client_->own_address();
}

std::vector<std::string> RankLink::gather(const std::string& label, const std::string& record) {
  return exchange(label, {record});
}

std::vector<std::string> RankLink::exchange(const std::string& label, const std::vector<std::string>& parts) {
  BodyWriter request;
  request.bytes(label).number(static_cast<std::int64_t>(parts.size()));
  for (const std::string& part : parts) request.bytes(part);
  const std::string answer = client_->request(MessageKind::kGather, request.take());
  BodyReader body(answer);
  std::vector<std::string> all;
  all.reserve(static_cast<std::size_t>(size()));
  for (int rank = 0; rank < size(); ++rank) all.push_back(body.bytes());
  return all;
}

void RankLink::set(const std::string& key, const std::string& value) {
  client_->request(MessageKind::kSet, BodyWriter().bytes(key).bytes(value).take());
}

std::string RankLink::get(const std::string& key, std::chrono::milliseconds limit) {
  return client_->request(MessageKind::kGet, BodyWriter().bytes(key).take(), limit);
}

std::int64_t RankLink::add(const std::string& key, std::int64_t number) {
  return BodyReader(client_->request(MessageKind::kAdd, BodyWriter().bytes(key).number(number).take())).number();
}

bool RankLink::check(const std::vector<std::string>& keys) {
  BodyWriter body;
  body.number(static_cast<std::int64_t>(keys.size()));
  for (const std::string& key : keys) body.bytes(key);
  return BodyReader(client_->request(MessageKind::kCheck, body.take())).number() != 0;
}

bool RankLink::remove(const std::string& key) {
  return BodyReader(client_->request(MessageKind::kDelete, BodyWriter().bytes(key).take())).number() != 0;
}

std::string RankLink::compare_set(const std::string& key, const std::string& expected, const std::string& desired) {
  return client_->request(MessageKind::kCompareSet, BodyWriter().bytes(key).bytes(expected).bytes(desired).take());
}

std::int64_t RankLink::count() {
  return BodyReader(client_->request(MessageKind::kCount, "")).number();
}

void RankLink::throw_if_failed() {
  client_->throw_if_failed();
}
bool RankLink::wait_for_failure(std::chrono::milliseconds limit) {
  return client_->wait_for_failure(limit);
}
void RankLink::on_failure(std::function<void()> call) {
  client_->on_failure(std::move(call));
}
void RankLink::fail(const std::string& cause) noexcept {
  client_->fail(cause);
}
void RankLink::close() noexcept {
  client_->close();
}

}  // namespace b3dgs
