// The web server of the live view: one page, and its requests. Without LibTorch.
//
//   GET  /                           the page
//   GET  /cameras                    title and cameras of the scene
//   GET  /state?since=ITERATION      progress and curves
//   POST /frame                      a rendered picture as JPEG; header X-Frame: iteration, count, ms, wait_ms, legend
//   GET  /photograph?view=I&width=W&height=H
//   POST /command                    pause, resume, save, stop
//
// Every request needs the token: ?token=... for the page, the header X-Token for the rest. Errors are one line of text.
// No request names a file.
#pragma once

#include <optional>
#include <string>

#include "app/view/access.h"
#include "app/view/frame_source.h"
#include "app/view/http_server.h"

namespace b3dgs {

struct ViewServerOptions {
  std::string address = "127.0.0.1";
  std::optional<int> port;  // 0: any free one; nothing: the first free one from kFirstViewPort on
};

inline constexpr int kFirstViewPort = 8080;
inline constexpr std::size_t kMaxViewClients = 4;

class ViewServer final : private HttpHandler {
 public:
  /// Listens and answers on its own threads until it is destroyed, which closes `source`. If that was a training, the
  /// destructor waits at most 2.5 s for the pages that follow it to ask for its end, or until
  /// FrameSource::is_stopped(). Otherwise it waits for no client. `source` must outlive it. @throws InputError if the
  /// address or port cannot be used
  ViewServer(FrameSource& source, const ViewServerOptions& options);
  ~ViewServer() override;
  ViewServer(const ViewServer&) = delete;
  ViewServer& operator=(const ViewServer&) = delete;

  int port() const { return port_; }
  const std::string& token() const { return token_; }
  /// Returns "http://127.0.0.1:8080/?token=..."
  std::string url() const;
  /// Returns lines for the user: the URL, and how to reach it from elsewhere.
  std::string instructions() const;

 private:
  /// Rejects requests that do not come from the page of the user who has the URL.
  std::optional<HttpResponse> refuse(const HttpRequest& request) override;
  bool is_slow(const HttpRequest& request) const override;
  HttpResponse answer(const HttpRequest& request) override;
  void complete(HttpResponse& response) const override;

  void listen(const std::optional<int>& wanted);
  HttpResponse route(const HttpRequest& request);
  /// Pictures cost time and memory, so each page has at most one in progress.
  HttpResponse one_at_a_time(const HttpRequest& request, HttpResponse (ViewServer::*picture)(const HttpRequest&));
  HttpResponse frame(const HttpRequest& request);
  HttpResponse photograph(const HttpRequest& request);

  FrameSource& source_;
  const std::string address_;
  const std::string token_ = make_token();
  int port_ = 0;
  ClientLimit clients_{kMaxViewClients};
  HttpServer server_{*this, HttpLimits()};  // the last member, so that its threads end first
};

}  // namespace b3dgs
