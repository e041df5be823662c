#include "view/view_server.h"

#include <httplib.h>
#include <unistd.h>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <regex>
#include <thread>

#include "core/check.h"
#include "view/access.h"
#include "view/page.h"
#include "view/view_json.h"

namespace b3dgs {
namespace {

constexpr int kPortsTried = 20;
constexpr std::size_t kThreads = 16;  // connections that are answered at the same time
constexpr int kTimeoutSeconds = 5;    // for a client to send or take something
constexpr int kKeepAliveSeconds = 2;
constexpr const char* kJson = "application/json";

std::string encode_jpeg(const Image8& image, int quality) {
  const cv::Mat from(image.height, image.width, CV_8UC(image.channels), const_cast<std::uint8_t*>(image.pixels.data()));
  cv::Mat bgr = from;
  if (image.channels == 3) cv::cvtColor(from, bgr, cv::COLOR_RGB2BGR);
  std::vector<unsigned char> bytes;
  if (!cv::imencode(".jpg", bgr, bytes, {cv::IMWRITE_JPEG_QUALITY, quality})) throw Error("a frame cannot be encoded");
  return {bytes.begin(), bytes.end()};
}

void answer(httplib::Response& response, int status, const std::string& line) {
  response.status = status;
  response.set_content(line + "\n", "text/plain; charset=utf-8");
}

/// Runs `work` and turns what it throws into a status and one line.
template <class Work>
void answer_with(httplib::Response& response, Work&& work) {
  try {
    work();
  } catch (const InputError& error) {
    answer(response, 400, error.what());
  } catch (const BusyError& error) {
    answer(response, 503, error.what());
  } catch (const std::exception& error) {
    const std::string text = error.what();
    answer(response, 500, detail::one_line(text.substr(0, text.find('\n'))));
  }
}

std::string replace_all(std::string text, const std::string& from, const std::string& to) {
  for (std::size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
  return text;
}

/// "[::1]" for "::1", as URLs need it.
std::string in_url(const std::string& address) {
  return address.find(':') != std::string::npos ? "[" + address + "]" : address;
}

std::string host_name() {
  char name[256] = "";
  return gethostname(name, sizeof name - 1) == 0 && *name != '\0' ? name : "MACHINE";
}

}  // namespace

struct ViewServer::Impl {
  Impl(FrameSource& source, const ViewServerOptions& options)
      : source(source), address(options.address), token(options.token.empty() ? make_token() : options.token) {}

  void bind(const std::optional<int>& wanted) {
    // The library's own choice, SO_REUSEPORT, would let two servers share a port.
    server.set_socket_options([](socket_t socket) {
      const int yes = 1;
      setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    });
    if (wanted == 0) {
      port = server.bind_to_any_port(address);
      if (port <= 0)
        input_error("--view_address ", address, ": cannot listen there (expected an address of this machine)");
      return;
    }
    const int first = wanted.value_or(kFirstViewPort), n = wanted ? 1 : kPortsTried;
    for (port = first; port < first + n; ++port) {
      if (server.bind_to_port(address, port)) return;
    }
    input_error("cannot listen on ", address, wanted ? detail::concat(" port ", first) : std::string(),
                wanted ? "" : detail::concat(" ports ", first, " to ", first + n - 1),
                " (taken, or not an address of this machine); choose another port, or 0 for any free one");
  }

  void set_limits() {
    server.new_task_queue = [] { return new httplib::ThreadPool(kThreads); };
    server.set_payload_max_length(kMaxViewBody);
    server.set_read_timeout(kTimeoutSeconds);
    server.set_write_timeout(kTimeoutSeconds);
    server.set_keep_alive_timeout(kKeepAliveSeconds);
    server.set_keep_alive_max_count(1000);
    server.set_tcp_nodelay(true);
    server.set_default_headers({{"X-Content-Type-Options", "nosniff"},
                                {"Referrer-Policy", "no-referrer"},
                                {"Cross-Origin-Resource-Policy", "same-origin"},
                                {"X-Frame-Options", "DENY"},
                                {"Cache-Control", "no-store"}});
  }

  /// Refuses a request that is not from the page of the one who was given the URL. Returns whether it was refused.
  bool refuse(const httplib::Request& request, httplib::Response& response) {
    const std::string host = request.get_header_value("Host");
    const bool is_page = request.path == "/";
    if (!is_page) response.set_header("Content-Security-Policy", "default-src 'none'; frame-ancestors 'none'");
    if (request.get_header_value_count("Host") != 1 || !is_own_host(host, address)) {
      answer(response, 403, "the address of the page: expected 127.0.0.1 or another numeric address, not a name");
    } else if (!is_own_origin(request.get_header_value("Origin"), host)) {
      answer(response, 403, "a request from another site");
    } else if (!equal_in_constant_time(is_page ? request.get_param_value("token") : request.get_header_value("X-Token"),
                                       token)) {
      answer(response, 401, "the token is missing or wrong: open the URL that the program has printed");
    } else if (!is_page && !clients.admit(client_of(request), ClientLimit::Clock::now())) {
      answer(response, 503, detail::concat(kMaxViewClients, " browsers are looking already, which is the limit"));
    } else {
      return false;
    }
    return true;
  }

  /// Each open page has a name of its own.
  static std::string client_of(const httplib::Request& request) {
    return request.get_header_value("X-Client").substr(0, 32);
  }

  void send_page(httplib::Response& response) {
    const std::string nonce = make_token();
    response.set_header("Content-Security-Policy",
                        "default-src 'none'; script-src 'nonce-" + nonce + "'; style-src 'nonce-" + nonce +
                            "'; img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
                            "frame-ancestors 'none'");
    response.set_content(replace_all(kViewPage, "@NONCE@", nonce), "text/html; charset=utf-8");
  }

  void send_frame(const httplib::Request& request, httplib::Response& response) {
    FrameRequest wanted = parse_frame_request(request.body, source.scene());
    const std::string client = client_of(request);
    if (!clients.begin_frame(client)) throw BusyError("a frame of this page is in work already");
    const auto end = [&](ClientLimit* limit) { limit->end_frame(client); };
    const std::unique_ptr<ClientLimit, decltype(end)> at_end(&clients, end);
    if (wanted.mode == FrameMode::kDifference) {
      wanted.photograph =
          std::make_shared<Image8>(source.photograph(wanted.view, {wanted.camera.width, wanted.camera.height}));
    }
    const Frame frame = source.render(wanted);
    response.set_header("X-Frame", json_text(frame_json(frame)).c_str());
    response.set_content(encode_jpeg(frame.image, wanted.quality), "image/jpeg");
  }

  void send_photograph(const httplib::Request& request, httplib::Response& response) {
    const auto parameter = [&](const char* name) { return parse_whole_number(request.get_param_value(name), name); };
    const int view = parameter("view");
    const ImageSize size = fit_view(source.scene(), view, {parameter("width"), parameter("height")});
    if (!source.scene().views[static_cast<std::size_t>(view)].has_photograph) {
      input_error("view ", view, " has no photograph");
    }
    response.set_content(encode_jpeg(source.photograph(view, size), 90), "image/jpeg");
  }

  void add_routes() {
    using httplib::Request;
    using httplib::Response;
    using Handled = httplib::Server::HandlerResponse;
    server.set_pre_routing_handler([this](const Request& request, Response& response) {
      return refuse(request, response) ? Handled::Handled : Handled::Unhandled;
    });
    server.Get("/",
               [this](const Request&, Response& response) { answer_with(response, [&] { send_page(response); }); });
    server.Get("/cameras", [this](const Request&, Response& response) {
      answer_with(response, [&] { response.set_content(json_text(cameras_json(source.scene())), kJson); });
    });
    server.Get("/state", [this](const Request& request, Response& response) {
      answer_with(response, [&] {
        const std::string since = request.get_param_value("since");
        const int iteration = since.empty() ? -1 : parse_whole_number(since, "since");
        response.set_content(json_text(state_json(source.state(iteration))), kJson);
      });
    });
    server.Get("/photograph", [this](const Request& request, Response& response) {
      answer_with(response, [&] { send_photograph(request, response); });
    });
    server.Post("/frame", [this](const Request& request, Response& response) {
      answer_with(response, [&] { send_frame(request, response); });
    });
    server.Post("/command", [this](const Request& request, Response& response) {
      answer_with(response, [&] {
        source.command(parse_command(request.body));
        response.set_content("{}", kJson);
      });
    });
    server.set_error_handler([](const Request&, Response& response) {
      if (!response.body.empty()) return;
      std::string line = detail::concat("error ", response.status);
      if (response.status == 404) line = "there is nothing at this address: open the URL that the program has printed";
      if (response.status == 413) line = detail::concat("expected at most ", kMaxViewBody, " bytes");
      answer(response, response.status, line);
    });
  }

  FrameSource& source;
  const std::string address, token;
  int port = 0;
  ClientLimit clients{kMaxViewClients};
  httplib::Server server;
  std::thread thread;
};

ViewServer::ViewServer(FrameSource& source, const ViewServerOptions& options)
    : impl_(std::make_unique<Impl>(source, options)) {
  impl_->set_limits();
  impl_->add_routes();
  impl_->bind(options.port);
  impl_->thread = std::thread([this] { impl_->server.listen_after_bind(); });
  while (!impl_->server.is_running()) std::this_thread::yield();  // stop() before that would have no effect
}

ViewServer::~ViewServer() {
  impl_->source.close();
  impl_->server.stop();
  impl_->thread.join();
}

int ViewServer::port() const {
  return impl_->port;
}

const std::string& ViewServer::token() const {
  return impl_->token;
}

std::string ViewServer::url() const {
  const bool is_any = impl_->address == "0.0.0.0" || impl_->address == "::";
  const std::string host = is_any ? "127.0.0.1" : in_url(impl_->address);
  return detail::concat("http://", host, ":", impl_->port, "/?token=", impl_->token);
}

std::string ViewServer::instructions() const {
  const std::string first = "view        " + url();
  if (is_loopback(impl_->address)) {
    return detail::concat(first, "\n            from another machine, first: ssh -N -L ", impl_->port, ":",
                          in_url(impl_->address), ":", impl_->port, " ", host_name());
  }
  return first;
}

}  // namespace b3dgs
