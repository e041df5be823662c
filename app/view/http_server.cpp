// Based on libmicrohttpd. One thread runs its event loop and is the only one that uses connections. Other threads
// compute slow answers while their connections are suspended.
#include "app/view/http_server.h"

#include <microhttpd.h>
#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <list>
#include <mutex>
#include <thread>

#include "core/check.h"
#include "core/descriptor.h"
#include "core/text.h"

namespace b3dgs {
namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

constexpr milliseconds kLongestWait{1000};

struct Peer {
  int socket = -1;
  Clock::time_point deadline;  // after this, it is cut
  bool is_allowed = false;     // one of its requests was allowed
  bool is_cut = false;
};

/// A request that is being processed.
struct Exchange {
  HttpRequest request;
  std::optional<HttpResponse> response;
  bool is_in_work = false;
};

HttpRequest::Fields fields_of(MHD_Connection* connection, MHD_ValueKind kind, bool lower) {
  struct Collected {
    HttpRequest::Fields fields;
    bool lower;
  } collected{{}, lower};
  MHD_get_connection_values_n(
      connection, kind,
      [](void* to, MHD_ValueKind, const char* key, size_t key_size, const char* value, size_t value_size) {
        auto& collected = *static_cast<Collected*>(to);
        const std::string name(key, key_size);
        collected.fields.emplace(collected.lower ? lower_case(name) : name,
                                 value ? std::string(value, value_size) : std::string());
        return MHD_YES;
      },
      &collected);
  return std::move(collected.fields);
}

/// Compares a number. Text that is not a number counts as too large.
bool is_larger(const std::string& length, std::size_t limit) {
  if (length.empty()) return false;
  const bool is_number = std::all_of(length.begin(), length.end(), [](char c) { return c >= '0' && c <= '9'; });
  return !is_number || length.size() > 9 || std::stoul(length) > limit;
}

MHD_Result send(MHD_Connection* connection, const HttpResponse& response, bool closes) {
  MHD_Response* sent = MHD_create_response_from_buffer(response.body.size(), const_cast<char*>(response.body.data()),
                                                       MHD_RESPMEM_MUST_COPY);
  if (sent == nullptr) return MHD_NO;
  MHD_add_response_header(sent, MHD_HTTP_HEADER_CONTENT_TYPE, response.type.c_str());
  for (const auto& [name, value] : response.headers) MHD_add_response_header(sent, name.c_str(), value.c_str());
  if (closes) MHD_add_response_header(sent, MHD_HTTP_HEADER_CONNECTION, "close");
  const MHD_Result result = MHD_queue_response(connection, static_cast<unsigned>(response.status), sent);
  MHD_destroy_response(sent);
  return result;
}

}  // namespace

struct HttpServer::Impl {
  Impl(HttpHandler& handler, const HttpLimits& limits) : handler(handler), limits(limits) {}

  /// Returns the port, or nothing if the address cannot be used. Does not share a port with another server.
  std::optional<int> start(const addrinfo& address) {
    const unsigned ip = address.ai_family == AF_INET6 ? MHD_USE_DUAL_STACK : 0;
    daemon = MHD_start_daemon(
        MHD_USE_EPOLL | MHD_ALLOW_SUSPEND_RESUME | ip, 0, nullptr, nullptr, &Impl::on_request, this,
        MHD_OPTION_SOCK_ADDR, address.ai_addr, MHD_OPTION_CONNECTION_LIMIT, static_cast<unsigned>(limits.connections),
        MHD_OPTION_CONNECTION_MEMORY_LIMIT, limits.head_bytes, MHD_OPTION_NOTIFY_CONNECTION, &Impl::on_connection, this,
        MHD_OPTION_NOTIFY_COMPLETED, &Impl::on_completed, this, MHD_OPTION_STRICT_FOR_CLIENT, 1, MHD_OPTION_END);
    if (daemon == nullptr) return std::nullopt;
    events = MHD_get_daemon_info(daemon, MHD_DAEMON_INFO_EPOLL_FD)->epoll_fd;
    loop = std::thread([this] { run(); });
    for (std::size_t i = 0; i < limits.slow_answers; ++i) workers.emplace_back([this] { work(); });
    return MHD_get_daemon_info(daemon, MHD_DAEMON_INFO_BIND_PORT)->port;
  }

  ~Impl() {
    if (daemon == nullptr) return;
    is_ending = true;
    waker.wake();
    loop.join();
    {
      const std::lock_guard<std::mutex> lock(mutex);
      has_ended = true;
    }
    waiting_changed.notify_all();
    for (std::thread& worker : workers) worker.join();
    MHD_stop_daemon(daemon);  // aborts if a connection is suspended; the workers have resumed all that the loop has not
  }

  void run() {
    while (!is_ending) {
      const Clock::time_point now = Clock::now();
      poll_files(now);
      MHD_run(daemon);
      // Decides with the time before this wait. Data that arrived meanwhile was read, however long this thread had to
      // wait.
      for (Peer& peer : peers) {
        if (peer.deadline <= now) cut(peer);
      }
    }
  }

  /// Waits until there is something to do.
  void poll_files(Clock::time_point now) {
    milliseconds wait = kLongestWait;
    for (const Peer& peer : peers) {
      const auto left = std::chrono::duration_cast<milliseconds>(peer.deadline - now) + milliseconds(1);
      if (!peer.is_cut) wait = std::min(wait, left);
    }
    MHD_UNSIGNED_LONG_LONG library_wait = 0;
    if (MHD_get_timeout(daemon, &library_wait) == MHD_YES && library_wait == 0) wait = milliseconds(0);
    pollfd files[] = {{events, POLLIN, 0}, {waker.fd(), POLLIN, 0}};
    poll(files, 2, std::max(0, static_cast<int>(wait.count())));
    if (files[1].revents != 0) waker.reset();
  }

  /// Ends a connection in any state. The loop finds it closed. The socket itself still belongs to the library.
  static void cut(Peer& peer) {
    if (!peer.is_cut) shutdown(peer.socket, SHUT_RDWR);
    peer.is_cut = true;
  }

  /// Makes space for new connections. Closes the oldest one without an allowed request or, if there is none, the
  /// newest.
  void make_room() {
    const auto n_open = std::count_if(peers.begin(), peers.end(), [](const Peer& peer) { return !peer.is_cut; });
    if (static_cast<std::size_t>(n_open) <= limits.connections * 3 / 4) return;
    const auto oldest =
        std::find_if(peers.begin(), peers.end(), [](const Peer& peer) { return !peer.is_cut && !peer.is_allowed; });
    cut(oldest == peers.end() ? peers.back() : *oldest);
  }

  static void on_connection(void* self, MHD_Connection* connection, void** context,
                            MHD_ConnectionNotificationCode code) {
    auto& server = *static_cast<Impl*>(self);
    if (code == MHD_CONNECTION_NOTIFY_STARTED) {
      Peer peer;
      peer.socket = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD)->connect_fd;
      peer.deadline = Clock::now() + server.limits.to_ask;
      server.peers.push_back(peer);
      *context = &server.peers.back();
      server.make_room();
    } else {
      server.peers.remove_if([&](const Peer& peer) { return &peer == *context; });
      *context = nullptr;
    }
  }

  static Peer& peer_of(MHD_Connection* connection) {
    return *static_cast<Peer*>(MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT)->socket_context);
  }

  static void on_completed(void* self, MHD_Connection* connection, void** context, MHD_RequestTerminationCode) {
    delete static_cast<Exchange*>(*context);
    *context = nullptr;
    peer_of(connection).deadline = Clock::now() + static_cast<Impl*>(self)->limits.to_ask;
  }

  static MHD_Result on_request(void* self, MHD_Connection* connection, const char* path, const char* method,
                               const char*, const char* data, size_t* n_bytes, void** context) {
    try {
      return static_cast<Impl*>(self)->go_on(connection, path, method, {data, *n_bytes}, n_bytes, context);
    } catch (const std::exception&) {
      return MHD_NO;  // no memory: the connection is closed
    }
  }

  /// Called when the headers have been read, for each part of the body, at its end, and when a slow answer is ready.
  MHD_Result go_on(MHD_Connection* connection, const char* path, const char* method, std::string_view data,
                   size_t* n_bytes, void** context) {
    Peer& peer = peer_of(connection);
    if (*context == nullptr) {
      auto begun = std::make_unique<Exchange>();
      HttpRequest& request = begun->request;
      request.method = method;
      request.path = path;
      request.headers = fields_of(connection, MHD_HEADER_KIND, true);
      request.parameters = fields_of(connection, MHD_GET_ARGUMENT_KIND, false);
      const std::optional<HttpResponse> refused = refuse(request);
      *context = begun.release();
      if (refused) return send(connection, *refused, true);
      peer.is_allowed = true;
      return MHD_YES;
    }
    Exchange& exchange = *static_cast<Exchange*>(*context);
    if (!data.empty()) {
      if (exchange.request.body.size() + data.size() > limits.body_bytes) return MHD_NO;
      exchange.request.body += data;
      *n_bytes = 0;
      return MHD_YES;
    }
    if (!exchange.is_in_work && handler.is_slow(exchange.request)) {
      exchange.is_in_work = true;
      peer.deadline = Clock::time_point::max();
      MHD_suspend_connection(connection);
      {
        const std::lock_guard<std::mutex> lock(mutex);
        waiting.push_back({connection, &exchange});
      }
      waiting_changed.notify_one();
      return MHD_YES;
    }
    if (!exchange.response) exchange.response = handler.answer(exchange.request);
    peer.deadline = Clock::now() + limits.to_take;
    return send(connection, *exchange.response, false);
  }

  std::optional<HttpResponse> refuse(const HttpRequest& request) {
    std::optional<HttpResponse> refused;
    if (request.headers.count("transfer-encoding") != 0) {
      refused = text_response(411, "expected a body of known length (Content-Length)");
    } else if (is_larger(request.header("content-length"), limits.body_bytes)) {
      refused = text_response(413, detail::concat("expected at most ", limits.body_bytes, " bytes"));
    }
    if (!refused) return handler.refuse(request);
    handler.complete(*refused);
    return refused;
  }

  /// Computes slow answers. Those that wait when the server ends are not begun.
  void work() {
    std::unique_lock<std::mutex> lock(mutex);
    for (;;) {
      waiting_changed.wait(lock, [&] { return has_ended || !waiting.empty(); });
      if (waiting.empty()) return;
      const auto [connection, exchange] = waiting.front();
      waiting.pop_front();
      lock.unlock();
      exchange->response =
          is_ending ? text_response(503, "the program is about to end") : handler.answer(exchange->request);
      MHD_resume_connection(connection);
      waker.wake();  // the library does not end a wait when a connection is resumed
      lock.lock();
    }
  }

  HttpHandler& handler;
  const HttpLimits limits;
  Waker waker;
  MHD_Daemon* daemon = nullptr;
  int events = -1;        // readable when the library has something to do
  std::list<Peer> peers;  // oldest first; only for the loop
  std::thread loop;
  std::vector<std::thread> workers;
  std::mutex mutex;  // protects `waiting` and `has_ended`
  std::condition_variable waiting_changed;
  std::deque<std::pair<MHD_Connection*, Exchange*>> waiting;
  std::atomic<bool> is_ending{false};
  bool has_ended = false;  // the loop has ended
};

HttpServer::HttpServer(HttpHandler& handler, const HttpLimits& limits)
    : impl_(std::make_unique<Impl>(handler, limits)) {}

HttpServer::~HttpServer() = default;

std::optional<int> HttpServer::listen(const std::string& address, int port) {
  addrinfo wanted{}, *found = nullptr;
  wanted.ai_socktype = SOCK_STREAM;
  wanted.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  if (getaddrinfo(address.c_str(), std::to_string(port).c_str(), &wanted, &found) != 0) return std::nullopt;
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> at_end(found, &freeaddrinfo);
  for (const addrinfo* at = found; at != nullptr; at = at->ai_next) {
    if (const std::optional<int> own = impl_->start(*at)) return own;
  }
  return std::nullopt;
}

}  // namespace b3dgs
