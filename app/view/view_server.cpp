#include "app/view/view_server.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netinet/in.h>
#include <unistd.h>

#include <algorithm>
#include <memory>
#include <thread>

#include "app/view/view_json.h"
#include "core/check.h"

namespace b3dgs {

/// HTML with style and script inside, which CMake builds from page/. Each answer replaces "@NONCE@" by a new random
/// value.
extern const char* const kViewPage;

namespace {

constexpr int kPortsTried = 20;
constexpr const char* kJpeg = "image/jpeg";
constexpr const char* kPolicy = "Content-Security-Policy";

HttpResponse json_response(const nlohmann::ordered_json& json) {
  return {200, "application/json", json_text(json), {}};
}

HttpResponse page() {
  const std::string nonce = make_token();
  const std::string policy = "default-src 'none'; script-src 'nonce-" + nonce + "'; style-src 'nonce-" + nonce +
                             "'; img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action "
                             "'none'; frame-ancestors 'none'";
  std::string text = kViewPage;
  const std::string mark = "@NONCE@";
  for (std::size_t at = text.find(mark); at != std::string::npos; at = text.find(mark, at)) {
    text.replace(at, mark.size(), nonce);
  }
  return {200, "text/html; charset=utf-8", text, {{kPolicy, policy}}};
}

/// Returns the name of an open page, which is unique.
std::string client_of(const HttpRequest& request) {
  return request.header("x-client").substr(0, 32);
}

bool is_any_address(const std::string& address) {
  return address == "0.0.0.0" || address == "::";
}

/// Returns "[::1]" for "::1", as URLs need it.
std::string in_url(const std::string& address) {
  return address.find(':') != std::string::npos ? "[" + address + "]" : address;
}

/// Returns an IPv4 address at which other machines may reach this one, or "" if there is none.
std::string address_of_this_machine() {
  ifaddrs* all = nullptr;
  if (::getifaddrs(&all) != 0) return "";
  std::string address;
  for (const ifaddrs* own = all; own != nullptr && address.empty(); own = own->ifa_next) {
    const bool is_outside = (own->ifa_flags & IFF_UP) != 0 && (own->ifa_flags & IFF_LOOPBACK) == 0;
    if (!is_outside || own->ifa_addr == nullptr || own->ifa_addr->sa_family != AF_INET) continue;
    char text[INET_ADDRSTRLEN] = "";
    const auto* const in = reinterpret_cast<const sockaddr_in*>(own->ifa_addr);
    if (::inet_ntop(AF_INET, &in->sin_addr, text, sizeof text) != nullptr) address = text;
  }
  ::freeifaddrs(all);
  return address;
}

std::string host_name() {
  char name[256] = "";
  return gethostname(name, sizeof name - 1) == 0 && *name != '\0' ? name : "MACHINE";
}

}  // namespace

ViewServer::ViewServer(FrameSource& source, const ViewServerOptions& options)
    : source_(source), address_(options.address) {
  listen(options.port);
}

ViewServer::~ViewServer() {
  const bool was_stopped = source_.is_stopped();
  source_.close();
  using Clock = ClientLimit::Clock;
  const Clock::time_point start = Clock::now(), give_up = start + std::chrono::milliseconds(2500);
  const auto has_waiting = [&] { return clients_.has_waiting(start - std::chrono::seconds(3)); };
  for (bool waits = has_waiting(); waits && Clock::now() < give_up && source_.is_stopped() == was_stopped;) {
    waits = has_waiting();
    std::this_thread::sleep_for(std::chrono::milliseconds(100));  // also after the last one, so that its answer arrives
  }
}

void ViewServer::listen(const std::optional<int>& wanted) {
  const int first = wanted.value_or(kFirstViewPort), n = wanted ? 1 : kPortsTried;
  for (int i = 0; i < n; ++i) {
    if (const std::optional<int> found = server_.listen(address_, first + i)) {
      port_ = *found;
      return;
    }
  }
  if (first == 0) input_error("cannot listen on ", address_, " (expected an address of this machine)");
  input_error("cannot listen on ", address_, wanted ? detail::concat(" port ", first) : std::string(),
              wanted ? "" : detail::concat(" ports ", first, " to ", first + n - 1),
              " (taken, or not an address of this machine); choose another port, or 0 for any free one");
}

std::optional<HttpResponse> ViewServer::refuse(const HttpRequest& request) {
  const std::string host = request.header("host");
  const bool is_page = request.path == "/";
  std::optional<HttpResponse> refused;
  if (request.headers.count("host") != 1 || !is_own_host(host, address_)) {
    refused = text_response(
        403, "the address of the page: expected localhost, 127.0.0.1 or, with --view ADDRESS:PORT, a numeric address");
  } else if (!is_own_origin(request.header("origin"), host)) {
    refused = text_response(403, "a request from another site");
  } else if (!equal_in_constant_time(is_page ? request.parameter("token") : request.header("x-token"), token_)) {
    refused = text_response(401, "the token is missing or wrong: open the URL that the program has printed");
  } else if (!is_page && !clients_.admit(client_of(request), ClientLimit::Clock::now())) {
    refused = text_response(503, detail::concat(kMaxViewClients, " browsers are looking already, which is the limit"));
  }
  if (refused) complete(*refused);
  return refused;
}

void ViewServer::complete(HttpResponse& response) const {
  const bool has_policy =
      std::any_of(response.headers.begin(), response.headers.end(), [](const auto& h) { return h.first == kPolicy; });
  if (!has_policy) response.headers.emplace_back(kPolicy, "default-src 'none'; frame-ancestors 'none'");
  response.headers.insert(response.headers.end(), {{"X-Content-Type-Options", "nosniff"},
                                                   {"Referrer-Policy", "no-referrer"},
                                                   {"Cross-Origin-Resource-Policy", "same-origin"},
                                                   {"X-Frame-Options", "DENY"},
                                                   {"Cache-Control", "no-store"}});
}

bool ViewServer::is_slow(const HttpRequest& request) const {
  return request.path == "/frame" || request.path == "/photograph";
}

/// Errors become a status and one line.
HttpResponse ViewServer::answer(const HttpRequest& request) {
  HttpResponse response;
  try {
    response = route(request);
  } catch (const InputError& error) {
    response = text_response(400, error.what());
  } catch (const BusyError& error) {
    response = text_response(503, error.what());
  } catch (const std::exception& error) {
    const std::string text = error.what();
    response = text_response(500, detail::one_line(text.substr(0, text.find('\n'))));
  }
  complete(response);
  return response;
}

HttpResponse ViewServer::route(const HttpRequest& request) {
  const std::string asked = request.method + " " + request.path;
  if (asked == "GET /") return page();
  if (asked == "GET /cameras") return json_response(cameras_json(source_.scene()));
  if (asked == "GET /state") {
    const std::string since = request.parameter("since");
    const ViewState state = source_.state(since.empty() ? -1 : parse_whole_number(since, "since"));
    clients_.set_waiting(client_of(request), source_.scene().is_training && !state.has_ended);
    return json_response(state_json(state));
  }
  if (asked == "GET /photograph") return one_at_a_time(request, &ViewServer::photograph);
  if (asked == "POST /frame") return one_at_a_time(request, &ViewServer::frame);
  if (asked == "POST /command") {
    source_.command(parse_command(request.body));
    return json_response(nlohmann::ordered_json::object());
  }
  return text_response(404, "there is nothing at this address: open the URL that the program has printed");
}

HttpResponse ViewServer::one_at_a_time(const HttpRequest& request,
                                       HttpResponse (ViewServer::*picture)(const HttpRequest&)) {
  const std::string client = client_of(request);
  if (!clients_.begin_picture(client)) throw BusyError("another picture is in work; this one follows");
  const auto end = [&](ClientLimit* limit) { limit->end_picture(client); };
  const std::unique_ptr<ClientLimit, decltype(end)> at_end(&clients_, end);
  return (this->*picture)(request);
}

HttpResponse ViewServer::frame(const HttpRequest& request) {
  FrameRequest wanted = parse_frame_request(request.body, source_.scene());
  if (wanted.mode == FrameMode::kDifference) {
    wanted.photograph =
        std::make_shared<Image8>(source_.photograph(wanted.view, {wanted.camera.width, wanted.camera.height}));
  }
  const Frame frame = source_.render(wanted);
  return {200, kJpeg, encode_jpeg(frame.image, wanted.quality), {{"X-Frame", json_text(frame_json(frame))}}};
}

HttpResponse ViewServer::photograph(const HttpRequest& request) {
  const auto number = [&](const char* name) { return parse_whole_number(request.parameter(name), name); };
  const int view = number("view");
  const ImageSize size = fit_view(source_.scene(), view, {number("width"), number("height")}, false);
  if (!source_.scene().views[static_cast<std::size_t>(view)].has_photograph) {
    input_error("view ", view, " has no photograph");
  }
  return {200, kJpeg, encode_jpeg(source_.photograph(view, size), 90), {}};
}

std::string ViewServer::url() const {
  const std::string host = is_any_address(address_) ? "127.0.0.1" : in_url(address_);
  return detail::concat("http://", host, ":", port_, "/?token=", token_);
}

std::string ViewServer::instructions() const {
  const std::string first = "view        " + url();
  if (is_loopback(address_)) {
    return detail::concat(first, "\n            from another machine, first: ssh -N -L ", port_, ":", in_url(address_),
                          ":", port_, " ", host_name());
  }
  if (!is_any_address(address_)) return first;
  const std::string own = address_of_this_machine();
  return detail::concat(first, "\n            from another machine: http://", own.empty() ? "ADDRESS" : own, ":", port_,
                        "/?token=", token_);
}

}  // namespace b3dgs
