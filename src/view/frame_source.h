// What the server shows: a model at rest or one in training. Without LibTorch, so that the server can be tested alone.
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

/// What a browser asks for: a picture of the Gaussians from a camera.
struct FrameRequest {
  Camera camera;
  int view = -1;  // index in ViewedScene::views whose camera this is; -1: none
  FrameMode mode = FrameMode::kRender;
  int quality = 85;                          // of the JPEG, 1 to 100
  bool is_draft = false;                     // the camera moves, so the next request follows soon
  std::shared_ptr<const Image8> photograph;  // of the camera's size, for kDifference
};

struct Frame {
  Image8 image;
  int iteration = 0;
  std::int64_t n_gaussians = 0;
  double render_ms = 0;
  double wait_s = 0;   // until a training can afford a larger or newer frame
  std::string legend;  // one line that says what the colours mean; empty for kRender
};

/// The frame cannot be made now; the same request may succeed later.
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

/// What does not change while the page is open.
struct ViewedScene {
  std::string title;
  std::vector<ViewedCamera> views;
  std::array<double, 3> center{};  // of what there is to see
  double radius = 1;               // about it
  bool is_training = false;
  CoordinateFrame frame{};  // of cameras and centre; files have world coordinates
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
  bool is_warning = false;  // the notice
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
  /// The curve holds points of iterations above `since` only.
  virtual ViewState state(int since) const = 0;
  /// Waits until the frame has been rendered. @throws BusyError if that takes too long, or the program is about to end
  virtual Frame render(const FrameRequest& request) = 0;
  /// The photograph of a view that has one, resized. @throws InputError if it cannot be read
  virtual Image8 photograph(int view, ImageSize size) const = 0;
  /// @throws InputError if there is no training to command
  virtual void command(ViewCommand command) = 0;
  /// Whether the program was asked to end.
  virtual bool is_stopped() const { return false; }
  /// There are no more frames: render() throws from now on, also where it waits. Does not throw.
  virtual void close() = 0;
};

// Hands frame requests from the server's threads to the one thread that may render.

class FrameQueue {
 public:
  /// Waits for the frame. @throws BusyError if nobody has begun it after `patience`, or the queue is closed; what the
  /// renderer has thrown
  Frame ask(const FrameRequest& request, std::chrono::milliseconds patience);

  /// Whether a request waits. Cheap enough to be asked after every step of a training.
  bool has_request() const;

  /// Answers the oldest request, after waiting for one for at most `wait`. Exceptions go to the one who asked. Returns
  /// whether there was one.
  bool serve(const std::function<Frame(const FrameRequest&)>& render, std::chrono::milliseconds wait);

  /// Ends waiting in ask() and serve(), now and from now on.
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
