#include "dist/control/rank_link.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <utility>

#include "core/text.h"

namespace b3dgs {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kFarewell{5000};

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
    : rank_(rank), size_(size), limits_(limits), connection_(Socket()) {
  const auto end = Clock::now() + limits.join;
  connection_ = Connection(connect_until(address, port, end));
  last_heard_ = Clock::now();
  own_address_ = own_address_of(connection_.socket());
  send({MessageKind::kHello, kHelloId, {kProtocol, job, std::to_string(rank), std::to_string(size)}});
  thread_ = std::thread([this] { run(); });
  std::unique_lock lock(mutex_);
  // The hub gives up after limits.join; this rank may have started later.
  changed_.wait_until(lock, end + limits.silence, [&] { return replies_.count(kHelloId) > 0 || failure_ || refusal_; });
  if (replies_.erase(kHelloId) > 0) return;
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

std::vector<std::string> RankLink::request(MessageKind kind, std::vector<std::string> parts,
                                           std::optional<std::chrono::milliseconds> limit) {
  std::unique_lock lock(mutex_);
  throw_if_failed_locked();
  const std::uint32_t id = next_id_++;
  lock.unlock();
  send({kind, id, std::move(parts)});
  lock.lock();
  const auto is_over = [&] { return replies_.count(id) > 0 || failure_; };
  if (limit) {
    changed_.wait_for(lock, *limit, is_over);
  } else {
    changed_.wait(lock, is_over);
  }
  if (auto reply = replies_.extract(id)) return std::move(reply.mapped());
  throw_if_failed_locked();
  throw Error("no answer from rank 0");
}

std::vector<std::string> RankLink::exchange(const std::string& label, std::vector<std::string> parts) {
  parts.insert(parts.begin(), label);
  return request(MessageKind::kGather, std::move(parts));
}

void RankLink::set(const std::string& key, const std::string& value) {
  request(MessageKind::kSet, {key, value});
}

std::string RankLink::get(const std::string& key, std::chrono::milliseconds limit) {
  return request(MessageKind::kGet, {key}, limit).at(0);
}

std::int64_t RankLink::add(const std::string& key, std::int64_t number) {
  return std::stoll(request(MessageKind::kAdd, {key, std::to_string(number)}).at(0));
}

bool RankLink::check(const std::vector<std::string>& keys) {
  return request(MessageKind::kCheck, keys).at(0) == "1";
}

bool RankLink::remove(const std::string& key) {
  return request(MessageKind::kDelete, {key}).at(0) == "1";
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
    request(kind, {first_line(cause).substr(0, 2000)}, kFarewell);
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

void RankLink::send(const Message& message) {
  const std::lock_guard lock(send_mutex_);
  if (!connection_.has_unsent()) last_sent_ = Clock::now();
  connection_.queue(message);
  try {
    connection_.flush();
  } catch (const Error&) {  // the thread notices it
  }
  if (connection_.has_unsent()) wake_.wake();
}

/// The thread: reads, sends signs of life and what is left, and notices that rank 0 is lost.
void RankLink::run() {
  const auto beat_interval = limits_.silence / 6;
  auto next_beat = Clock::now() + beat_interval;
  std::optional<Clock::time_point> stuck_at;
  while (!is_stopping_) {
    wait_for_events(std::min(beat_interval, std::chrono::milliseconds(500)));
    const auto now = Clock::now();
    if (!has_lost_hub_ && now >= next_beat) {
      send({});
      next_beat = now + beat_interval;
    }
    if (!has_lost_hub_) exchange_bytes();
    const std::lock_guard lock(mutex_);
    if (!failure_ || is_acknowledged_) continue;
    if (!stuck_at) stuck_at = now + limits_.stuck;
    if (now > *stuck_at) end_process();
  }
}

void RankLink::wait_for_events(std::chrono::milliseconds limit) {
  std::array<pollfd, 2> files{pollfd{wake_.fd(), POLLIN, 0}, pollfd{-1, POLLIN, 0}};
  if (!has_lost_hub_) {
    const std::lock_guard lock(send_mutex_);
    files[1].fd = connection_.socket().fd();
    if (connection_.has_unsent()) files[1].events |= POLLOUT;
  }
  poll(files.data(), files.size(), static_cast<int>(limit.count()));
  wake_.reset();
}

void RankLink::exchange_bytes() {
  const std::int64_t limit_s = limits_.silence.count() / 1000;
  try {
    if (connection_.receive([this](const Message& message) { handle(message); })) last_heard_ = Clock::now();
    if (Clock::now() - last_heard_ > limits_.silence)
      throw Error(detail::concat("no sign of life for ", limit_s, " s"));
    const std::lock_guard lock(send_mutex_);
    if (connection_.flush()) last_sent_ = Clock::now();
    if (connection_.has_unsent() && Clock::now() - last_sent_ > limits_.silence) {
      throw Error(detail::concat("it took nothing of a message for ", limit_s, " s"));
    }
  } catch (const std::exception& error) {
    has_lost_hub_ = true;
    note_failure(0, error.what());
  }
}

void RankLink::handle(const Message& message) {
  if (message.kind == MessageKind::kBeat) return;
  if (message.kind == MessageKind::kFailure) {
    note_failure(std::stoi(message.parts.at(0)), message.parts.at(1));
    return;
  }
  const std::lock_guard lock(mutex_);
  if (message.kind == MessageKind::kRefused) {
    refusal_ = message.parts.at(0);
  } else if (message.kind == MessageKind::kReply) {
    replies_[message.id] = message.parts;
  } else {
    throw Error("what listens there is not rank 0 of b3dgs");
  }
  changed_.notify_all();
}

void RankLink::note_failure(int rank, const std::string& cause) {
  std::function<void()> call;
  std::uint32_t id;
  {
    const std::lock_guard lock(mutex_);
    if (failure_ || refusal_) return;
    failure_.emplace(rank, size_, cause);
    id = next_id_++;
    call = std::move(on_failure_);
    on_failure_ = nullptr;
  }
  changed_.notify_all();
  // Rank 0 waits for this farewell before it ends.
  if (!has_lost_hub_) send({MessageKind::kBye, id, {}});
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
  wake_.wake();
  thread_.join();
}

}  // namespace b3dgs
