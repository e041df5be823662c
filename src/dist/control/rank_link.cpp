#include "dist/control/rank_link.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>

namespace b3dgs {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kFarewell{5000};

std::string first_line(const std::string& text) {
  return text.substr(0, std::min<std::size_t>(text.find('\n'), 2000));
}

Socket connect_until(const std::string& address, int port, Clock::time_point end) {
  std::chrono::milliseconds pause{20};
  while (true) {
    std::optional<Socket> socket = try_to_connect(address, port, std::chrono::milliseconds(5000));
    if (socket) return std::move(*socket);
    if (Clock::now() > end) input_error("rank 0 does not listen at ", address, " port ", port);
    std::this_thread::sleep_for(pause);
    pause = std::min(pause * 2, std::chrono::milliseconds(500));
  }
}

}  // namespace

RankLink::RankLink(const std::string& address, int port, int rank, int size, const std::string& job,
                   const RankLimits& limits)
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
  input_error(where,
              ": what listens there is not rank 0 of b3dgs; set MASTER_PORT to a free port (torchrun: --master-port)");
}

RankLink::~RankLink() {
  close();
  stop();
}

std::string RankLink::request(MessageKind kind, std::string body, std::optional<std::chrono::milliseconds> limit) {
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

std::vector<std::string> RankLink::gather(const std::string& label, const std::string& record) {
  return exchange(label, {record});
}

std::vector<std::string> RankLink::exchange(const std::string& label, const std::vector<std::string>& parts) {
  BodyWriter body;
  body.bytes(label).number(static_cast<std::int64_t>(parts.size()));
  for (const std::string& part : parts) body.bytes(part);
  const std::string answer = request(MessageKind::kGather, body.take());
  BodyReader reader(answer);
  std::vector<std::string> all;
  all.reserve(static_cast<std::size_t>(size_));
  for (int rank = 0; rank < size_; ++rank) all.push_back(reader.bytes());
  return all;
}

void RankLink::set(const std::string& key, const std::string& value) {
  request(MessageKind::kSet, BodyWriter().bytes(key).bytes(value).take());
}

std::string RankLink::get(const std::string& key, std::chrono::milliseconds limit) {
  return request(MessageKind::kGet, BodyWriter().bytes(key).take(), limit);
}

std::int64_t RankLink::add(const std::string& key, std::int64_t number) {
  return BodyReader(request(MessageKind::kAdd, BodyWriter().bytes(key).number(number).take())).number();
}

bool RankLink::check(const std::vector<std::string>& keys) {
  BodyWriter body;
  body.number(static_cast<std::int64_t>(keys.size()));
  for (const std::string& key : keys) body.bytes(key);
  return BodyReader(request(MessageKind::kCheck, body.take())).number() != 0;
}

bool RankLink::remove(const std::string& key) {
  return BodyReader(request(MessageKind::kDelete, BodyWriter().bytes(key).take())).number() != 0;
}

void RankLink::throw_if_failed() {
  const std::lock_guard lock(mutex_);
  throw_if_failed_locked();
}

bool RankLink::wait_for_failure(std::chrono::milliseconds limit) {
  std::unique_lock lock(mutex_);
  return changed_.wait_for(lock, limit, [&] { return failure_.has_value(); });
}

void RankLink::on_failure(std::function<void()> call) {
  std::unique_lock lock(mutex_);
  if (!failure_) {
    on_failure_ = std::move(call);
    return;
  }
  lock.unlock();
  call();
}

void RankLink::leave(MessageKind kind, const std::string& cause) noexcept {
  try {
    {
      const std::lock_guard lock(mutex_);
      if (is_closed_) return;
      is_closed_ = is_acknowledged_ = true;
      on_failure_ = nullptr;
    }
    request(kind, kind == MessageKind::kFail ? BodyWriter().bytes(first_line(cause)).take() : "", kFarewell);
  } catch (const std::exception&) {  // another rank has failed before, or rank 0 does not answer
  }
}

void RankLink::fail(const std::string& cause) noexcept {
  leave(MessageKind::kFail, cause);
}

void RankLink::close() noexcept {
  leave(MessageKind::kBye, "");
}

void RankLink::throw_if_failed_locked() {
  if (!failure_) return;
  is_acknowledged_ = true;
  throw PeerError(*failure_);
}

/// Sends all of it: what follows a part of a message would be read as the rest of it. A connection that fails is
/// noticed by run().
void RankLink::write_message(const Message& message) {
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
void RankLink::run() {
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

void RankLink::read() {
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

void RankLink::handle(const Message& message) {
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

void RankLink::lose_hub(const std::string& cause) {
  has_lost_hub_ = true;
  note_failure(0, cause);
}

void RankLink::note_failure(int rank, const std::string& cause) {
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

void RankLink::end_process() const {
  const std::string line = detail::concat("error: ", failure_->what(), "\n");
  [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, line.data(), line.size());
  _exit(PeerError::kExitCode);
}

void RankLink::stop() {
  if (!thread_.joinable()) return;
  is_stopping_ = true;
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(wake_.fd(), &one, sizeof one);
  thread_.join();
}

}  // namespace b3dgs
