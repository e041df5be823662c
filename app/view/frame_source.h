// The source of the server's frames: a finished model or one in training. Without LibTorch, so that the server can be
// tested alone.
#pragma once

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/check.h"
#include "scene/cameras/camera.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/images/image.h"

namespace b3dgs {

enum class FrameMode { kRender, kDifference, kDepth, kAlpha, kLoad };

/// A browser's request for a picture of the Gaussians from a camera.
struct FrameRequest {
  Camera camera;
  int view = -1;  // index in ViewedScene::views whose camera this is; -1: none
  FrameMode mode = FrameMode::kRender;
  int quality = 85;                             // of the JPEG, 1 to 100
  bool is_draft = false;                        // the camera moves, so the next request follows soon
  std::shared_ptr<const Image8> photograph;     // of the camera's size, for kDifference
  std::optional<std::array<double, 2>> pick{};  // a place in the frame, 0 to 1 from its upper left corner
};

struct Frame {
  Image8 image;
  int iteration = 0;
  std::int64_t n_gaussians = 0;
  double render_ms = 0;
  double wait_s = 0;                             // until a training can afford a larger or newer frame
  std::string legend;                            // one line that says what the colours mean; empty for kRender
  std::optional<std::array<double, 3>> point{};  // of the surface at FrameRequest::pick, in coordinates of files
};

/// Thrown if the frame cannot be rendered now. The same request may succeed later.
class BusyError : public Error {
 public:
  using Error::Error;
};

/// A camera of the scene that the page can jump to.
struct ViewedCamera {
  std::string name;
  Camera camera;
  bool is_test = false;
  bool has_photograph = false;
};

/// Data that does not change while the page is open.
struct ViewedScene {
  std::string title;
  std::vector<ViewedCamera> views;
  std::array<double, 3> center{};  // centre of the visible region
  double radius = 1;               // its approximate radius
  bool is_training = false;
  CoordinateFrame frame{};                    // of cameras and centre; files have world coordinates
  std::optional<std::array<double, 3>> up{};  // direction in which the page is upright
  bool is_metric = false;                     // coordinates of files are in metres
};

struct CurvePoint {
  int iteration = 0;
  double loss = 0;
  std::int64_t n_gaussians = 0;
};

struct PsnrPoint {
  int iteration = 0;
  double psnr = 0;  // dB, mean over the test views
};

struct ViewState {
  int iteration = 0, iterations = 0;
  double loss = 0;  // running average
  std::int64_t n_gaussians = 0;
  std::string kernel;       // forward kernel in use
  std::string activity;     // such as "training", "paused", "finished", "stopped", "failed"
  std::string notice;       // one line about the last command, an error or what to do next; may be empty
  bool is_warning = false;  // whether the notice is a warning
  double iterations_per_second = 0;
  std::optional<double> eta_s;
  bool is_paused = false, has_ended = false;
  std::vector<CurvePoint> curve;  // ascending iterations
  std::vector<PsnrPoint> psnr;
};

enum class ViewCommand { kPause, kResume, kSave, kStop };

/// All functions may be called from several threads.
class FrameSource {
 public:
  virtual ~FrameSource() = default;

  virtual const ViewedScene& scene() const = 0;
  /// Returns the state. The curve has only points of iterations above `since`.
  virtual ViewState state(int since) const = 0;
  /// Waits until the frame has been rendered. @throws BusyError if that takes too long, or the program is about to end
  virtual Frame render(const FrameRequest& request) = 0;
  /// Returns the resized photograph of a view that has one. @throws InputError if it cannot be read
  virtual Image8 photograph(int view, ImageSize size) const = 0;
  /// @throws InputError if there is no training
  virtual void command(ViewCommand command) = 0;
  /// Returns whether the program was asked to end.
  virtual bool is_stopped() const { return false; }
  /// Ends the frames. From now on, render() throws, also while it waits. Does not throw.
  virtual void close() = 0;
};

// Passes frame requests from the server's threads to the one thread that may render.

class FrameQueue {
 public:
  /// Waits for the frame. @throws BusyError if nobody has begun it after `patience`, or the queue is closed; errors
  /// from the renderer
  Frame ask(const FrameRequest& request, std::chrono::milliseconds patience);

  /// Returns whether a request waits. Cheap enough to call after every step of a training.
  bool has_request() const;

  /// Answers the oldest request, after waiting at most `wait` for one. Exceptions are passed to the requesting thread.
  /// Returns whether there was a request.
  bool serve(const std::function<Frame(const FrameRequest&)>& render, std::chrono::milliseconds wait);

  /// Ends waiting in ask() and serve(), now and in the future.
  void close();

 private:
  struct Waiting {
    FrameRequest request;
    std::promise<Frame> frame;
    bool is_begun = false;
  };

  mutable std::mutex mutex_;
  std::condition_variable asked_, begun_;
  std::deque<std::shared_ptr<Waiting>> waiting_;
  bool is_closed_ = false;
};

}  // namespace b3dgs
