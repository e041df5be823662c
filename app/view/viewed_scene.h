// What the page of the live view is told of a scene, and what is the same for a model at rest and a training.
#pragma once

#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "app/view/frame_painter.h"
#include "scene/scene.h"
#include "view/frame_source.h"

namespace b3dgs {

/// The cameras of a scene, training views first, and the part of the world where most of the points are ([N, 3]).
ViewedScene viewed_scene(const Scene& scene, const std::vector<float>& points, const std::string& title);

/// The view behind ViewedScene::views[index].
const View& view_at(const Scene& scene, int index);

class WatchedScene : public FrameSource {
 public:
  const ViewedScene& scene() const override { return viewed_; }
  Frame render(const FrameRequest& request) override { return queue_.ask(request, std::chrono::seconds(20)); }
  Image8 photograph(int view, ImageSize size) const override;
  void close() override { queue_.close(); }

 protected:
  /// `viewed` describes `scene`, which must outlive this.
  WatchedScene(const Scene& scene, ViewedScene viewed, torch::Device device)
      : source_(scene), viewed_(std::move(viewed)), painter_(device, viewed_.frame.unit) {}

  const Scene& source_;
  const ViewedScene viewed_;
  FramePainter painter_;
  FrameQueue queue_;
};

}  // namespace b3dgs
