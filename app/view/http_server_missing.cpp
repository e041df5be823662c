// Replaces http_server.cpp if libmicrohttpd was not found.
#include "app/view/http_server.h"
#include "core/check.h"

namespace b3dgs {

struct HttpServer::Impl {};

HttpServer::HttpServer(HttpHandler&, const HttpLimits&) {
  input_error(
      "this program was built without the live view: install libmicrohttpd-dev (0.9.75 or later) and build again");
}

HttpServer::~HttpServer() = default;

std::optional<int> HttpServer::listen(const std::string&, int) {
  return std::nullopt;
}

}  // namespace b3dgs
