#include "app/view/view_options.h"

#include <charconv>
#include <iostream>
#include <system_error>

#include "app/view/access.h"
#include "core/check.h"

namespace b3dgs {
namespace {

constexpr const char* kAutoPort = "auto";

/// Returns whether the word is a port, or an address in digits or `localhost` and a port. Anything else after --view is
/// the next argument.
bool is_place(const std::string& word) {
  const std::size_t colon = word.rfind(':');
  const std::string port = word.substr(colon == std::string::npos ? 0 : colon + 1);
  const bool has_port = port == kAutoPort || (!port.empty() && port.find_first_not_of("0123456789") == port.npos);
  if (!has_port || colon == std::string::npos) return has_port;
  const std::string address = word.substr(0, colon);
  const bool has_digits = address.find_first_not_of("0123456789abcdefABCDEF.:[]") == address.npos;
  return address == "localhost" || (!address.empty() && has_digits);
}

}  // namespace

std::unique_ptr<ViewServer> start_view_server(FrameSource& source, const ViewServerOptions& options,
                                              StatusLine& status) {
  auto started = std::make_unique<ViewServer>(source, options);
  if (!is_loopback(options.address)) {
    status.warn("address " + options.address +
                ": other machines can reach the page, and what is sent is not encrypted: whoever reads the token can "
                "watch and stop the training; an ssh tunnel to 127.0.0.1 is safer");
  }
  std::cout << started->instructions() << std::endl;
  return started;
}

ViewServerOptions parse_view_place(const std::string& place) {
  ViewServerOptions options;
  const std::size_t colon = place.rfind(':');
  if (colon != std::string::npos) options.address = place.substr(0, colon);
  if (!options.address.empty() && options.address.front() == '[' && options.address.back() == ']') {
    options.address = options.address.substr(1, options.address.size() - 2);
  }
  const std::string port = place.substr(colon == std::string::npos ? 0 : colon + 1);
  if (port == kAutoPort && !options.address.empty()) return options;
  int number = -1;
  const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), number);
  const bool is_read = error == std::errc() && end == port.data() + port.size();
  if (!is_read || number < 0 || number > 65535 || options.address.empty()) {
    constexpr std::size_t kShown = 80;
    input_error("--view ", place.substr(0, kShown),
                ": not a place for the page (expected PORT or ADDRESS:PORT, such as 127.0.0.1:8080)");
  }
  options.port = number;
  return options;
}

std::vector<std::string> join_view_place(const std::vector<std::string>& words) {
  std::vector<std::string> result;
  for (std::size_t i = 0; i < words.size(); ++i) {
    result.push_back(words[i]);
    if (words[i] != "--view") continue;
    const bool is_followed = i + 1 < words.size() && is_place(words[i + 1]);
    result.back() += "=" + (is_followed ? words[++i] : std::string(kAutoPort));
  }
  return result;
}

}  // namespace b3dgs
