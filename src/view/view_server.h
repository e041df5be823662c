// The web server of the live view: one page, and what it asks for. Without LibTorch.
//
//   GET  /                           the page
//   GET  /cameras                    title and cameras of the scene
//   GET  /state?since=ITERATION      progress and curves
//   POST /frame                      a rendered picture as JPEG; header X-Frame: iteration, count, ms, legend
//   GET  /photograph?view=I&width=W&height=H
//   POST /command                    pause, resume, save, stop
//
// Every request needs the token: ?token=... for the page, the header X-Token for the rest. Errors are one line of text.
// No request names a file.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "view/frame_source.h"
#include "view/http_server.h"

namespace b3dgs {

struct ViewServerOptions {
  std::string address = "127.0.0.1";
  std::optional<int> port;  // 0: any free one; nothing: the first free one from kFirstViewPort on
  std::string token;        // empty: a random one
  HttpLimits limits;
};

inline constexpr int kFirstViewPort = 8080;
inline constexpr std::size_t kMaxViewClients = 4;

class ViewServer {
 public:
  /// Listens and answers on threads of its own until it is destroyed, which closes `source` and waits for no client.
  /// `source` must outlive it. @throws InputError if the address or port cannot be used
  ViewServer(FrameSource& source, const ViewServerOptions& options);
  ~ViewServer();
  ViewServer(const ViewServer&) = delete;
  ViewServer& operator=(const ViewServer&) = delete;

  int port() const;
  const std::string& token() const;
  /// "http://127.0.0.1:8080/?token=..."
  std::string url() const;
  /// What to tell the user: the URL, and how to reach it from elsewhere; a line each.
  std::string instructions() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace b3dgs
