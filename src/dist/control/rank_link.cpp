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
    : rank_(rank),
      size_(size),
      limits_(limits),
      place_(detail::concat(address, " port ", port)),
      // An inherited socket accepts before the hub has started, because rank 0 may be slow to open its GPU.
      connection_(connect_until(address, port, Clock::now() + limits.join), limits, /*is_trusted=*/true, limits.join) {
  own_address_ = own_address_of(connection_.socket());
  thread_ = std::thread([this] { run(); });
  try {
    // The hub gives up after limits.join, but this rank may have started later.
    request(MessageKind::kHello, {kProtocol, job, std::to_string(rank), std::to_string(size)},
            limits.join + limits.silence);
  } catch (...) {
    stop();
    throw;
  }
}

RankLink::~RankLink() {
  close();
  stop();
}

std::vector<std::string> RankLink::request(MessageKind kind, std::vector<std::string> parts,
                                           std::chrono::milliseconds limit) {
  std::unique_lock lock(mutex_);
  throw_if_failed_locked();
  const std::uint32_t id = next_id_++;
  connection_.queue({kind, id, std::move(parts)});
  try {
    connection_.flush();
  } catch (const Error&) {  // the thread notices it
  }
  if (connection_.has_unsent()) wake_.wake();
  changed_.wait_for(lock, limit, [&] { return replies_.count(id) > 0 || failure_; });
  if (auto reply = replies_.extract(id)) return std::move(reply.mapped());
  throw_if_failed_locked();
  input_error("rank ", rank_, " of ", size_, ": no answer from ", place_,
              "; if rank 0 of b3dgs does not listen there, set MASTER_PORT to a free port (torchrun: --master-port)");
}

std::vector<std::string> RankLink::exchange(const std::string& label, std::vector<std::string> parts) {
  parts.insert(parts.begin(), label);
  return request(MessageKind::kGather, std::move(parts));
}

void RankLink::throw_if_failed() {
  const std::lock_guard lock(mutex_);
  throw_if_failed_locked();
}

bool RankLink::wait_for_failure(std::chrono::milliseconds limit) {
  std::unique_lock lock(mutex_);
  return changed_.wait_for(lock, limit, [&] { return failure_ != nullptr; });
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
      if (std::exchange(has_left_, true)) return;
      stuck_at_.reset();
      on_failure_ = nullptr;
    }
    request(kind, {first_line(cause).substr(0, 2000)}, kFarewell);
  } catch (const std::exception&) {  // another rank failed before, or rank 0 does not answer
  }
}

void RankLink::throw_if_failed_locked() {
  if (!failure_) return;
  stuck_at_.reset();
  std::rethrow_exception(failure_);
}

/// The thread reads, sends heartbeats and unsent data, and notices that rank 0 is lost.
void RankLink::run() {
  std::unique_lock lock(mutex_);
  while (!is_stopping_) {
    const short events = connection_.has_unsent() ? POLLIN | POLLOUT : POLLIN;
    std::array<pollfd, 2> files{pollfd{wake_.fd(), POLLIN, 0}, pollfd{connection_.socket().fd(), events, 0}};
    lock.unlock();
    poll(files.data(), files.size(), static_cast<int>(limits_.beat().count()));
    wake_.reset();
    lock.lock();
    try {
      if (connection_.socket()) {
        connection_.receive([this](const Message& message) { handle(message); });
        connection_.flush();
      }
    } catch (const std::exception& error) {
      connection_.close();
      note_failure(std::make_exception_ptr(PeerError(0, size_, error.what())));
    }
    if (!stuck_at_ || Clock::now() < *stuck_at_) continue;
    try {
      std::rethrow_exception(failure_);
    } catch (const std::exception& error) {
      const std::string line = detail::concat("error: ", error.what(), "\n");
      [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, line.data(), line.size());
    }
    _exit(PeerError::kExitCode);
  }
}

void RankLink::handle(const Message& message) {
  switch (message.kind) {
    case MessageKind::kReply:
      replies_[message.id] = message.parts;
      return changed_.notify_all();
    case MessageKind::kFailure:
      return note_failure(
          std::make_exception_ptr(PeerError(std::stoi(message.parts.at(0)), size_, message.parts.at(1))));
    case MessageKind::kRefused:
      return note_failure(std::make_exception_ptr(InputError(detail::one_line(
          detail::concat("rank ", rank_, " of ", size_, " cannot join at ", place_, ": ", message.parts.at(0))))));
    default:
      throw Error("what listens there is not rank 0 of b3dgs");
  }
}

void RankLink::note_failure(std::exception_ptr failure) {
  if (failure_) return;
  failure_ = std::move(failure);
  if (!has_left_) stuck_at_ = Clock::now() + limits_.stuck;
  changed_.notify_all();
  connection_.queue({MessageKind::kBye, next_id_++, {}});                      // rank 0 waits for this before it ends
  if (on_failure_) std::thread(std::exchange(on_failure_, nullptr)).detach();  // this thread must continue if it hangs
}

void RankLink::stop() {
  {
    const std::lock_guard lock(mutex_);
    is_stopping_ = true;
  }
  wake_.wake();
  thread_.join();
}

}  // namespace b3dgs
