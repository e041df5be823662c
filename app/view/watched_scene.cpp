#include "app/view/watched_scene.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <opencv2/imgproc.hpp>

#include "adaptive/load_statistics.h"
#include "app/common/status_line.h"
#include "app/render/depth_images.h"
#include "core/check.h"
#include "core/text.h"
#include "model/raster_input.h"
#include "raster/kernels.h"
#include "raster/math/lens.h"
#include "scene/cameras/camera_lens.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/images/image.h"
#include "scene/view_image.h"
#include "train/quality/metrics.h"

namespace b3dgs {
namespace {

constexpr double kFullError = 0.25;  // mean absolute difference of a pixel's channels with the brightest colour

void paint_depth(const RenderedView& rendered, double unit, Frame& frame) {
  const torch::Tensor depth = host_copy(rendered.depth), alpha = host_copy(rendered.alpha);
  const DepthRange range = depth_range(depth, alpha);
  frame.image = color_depth(depth, alpha, range);
  frame.legend =
      print_to_string("inverse depth: red %.4g to blue %.4g world units", unit * range.near, unit * range.far);
}

void paint_difference(const Image8& photograph, Frame& frame) {
  Image8 rendered = std::move(frame.image), other = photograph;
  B3DGS_CHECK(other.pixels.size() == rendered.pixels.size(), "a photograph of another size");
  const auto matrix = [](Image8& image) { return cv::Mat(image.height, image.width, CV_8UC3, image.pixels.data()); };
  cv::Mat difference, of_pixels, grey;
  cv::absdiff(matrix(rendered), matrix(other), difference);
  const double squares = cv::norm(difference, cv::NORM_L2SQR), sum = cv::norm(difference, cv::NORM_L1);
  difference.convertTo(difference, CV_32F);
  cv::transform(difference, of_pixels, cv::Matx13f(1, 1, 1));
  of_pixels.convertTo(grey, CV_8U, 1 / (3 * kFullError));
  const auto n = static_cast<double>(rendered.pixels.size());
  const double psnr = squares > 0 ? 10 * std::log10(255.0 * 255.0 * n / squares) : 99;
  frame.image = colored(grey, cv::COLORMAP_INFERNO);
  frame.legend =
      print_to_string("absolute difference, mean %.4f; black 0, yellow %.2f or more; PSNR %.2f dB at %d x %d",
                      sum / n / 255, kFullError, psnr, rendered.width, rendered.height);
}

/// Paints the number of entries of each tile's list, on a logarithmic scale.
void paint_load(const ViewLoad& load, const TileShape& tile, Frame& frame) {
  const torch::Tensor lists = load.tile_lists.contiguous();
  const std::int64_t* entries = lists.data_ptr<std::int64_t>();
  const LoadStatistics statistics = load_statistics(entries, lists.numel());
  const int width = frame.image.width, height = frame.image.height;
  const int n_columns = (width + tile.width - 1) / tile.width;
  const double full = std::log2(1.0 + static_cast<double>(std::max<std::int64_t>(1, statistics.max)));
  cv::Mat tiles(static_cast<int>(lists.numel()) / n_columns, n_columns, CV_8UC1), grey;
  std::transform(entries, entries + lists.numel(), tiles.data, [&](std::int64_t n) {
    return static_cast<std::uint8_t>(std::lround(255 * std::log2(1 + static_cast<double>(n)) / full));
  });
  cv::resize(tiles, grey, {}, tile.width, tile.height, cv::INTER_NEAREST);
  grey = grey(cv::Rect(0, 0, width, height));
  frame.image = colored(grey, cv::COLORMAP_TURBO);
  frame.legend = print_to_string(
      "splats per tile of %d x %d px, logarithmic: black 0, red %s; median %s, 99th percentile %s, Gini %.2f",
      tile.width, tile.height, format_count(statistics.max).c_str(), format_count(statistics.median).c_str(),
      format_count(statistics.p99).c_str(), statistics.gini);
}

/// Returns the point where the view is half opaque or more, or nothing if it is not.
std::optional<std::array<double, 3>> surface_point(const FrameRequest& request, const RenderedView& rendered) {
  constexpr double kLeastAlpha = 0.5;
  const Camera& camera = request.camera;
  const double x = (*request.pick)[0] * camera.width, y = (*request.pick)[1] * camera.height;
  const int column = std::min(camera.width - 1, static_cast<int>(x));
  const int row = std::min(camera.height - 1, static_cast<int>(y));
  const auto alpha = rendered.alpha[row][column].item<double>();
  const std::optional<std::array<double, 3>> ray = LensRays(camera).at(x, y);
  if (!ray || alpha < kLeastAlpha) return std::nullopt;
  const double of_ray = lens_depth(camera.lens, Vec3<double>{(*ray)[0], (*ray)[1], (*ray)[2]});
  const double length = rendered.depth[row][column].item<double>() / alpha / of_ray;
  const Pose& pose = camera.cam_from_world;
  std::array<double, 3> at{};
  for (std::size_t i = 0; i < 3; ++i) at[i] = length * (*ray)[i] - pose.translation[i];
  return rotated_back(pose.rotation, at);
}

}  // namespace

ViewedScene viewed_scene(const Scene& scene, const std::vector<float>& points, const std::string& title) {
  ViewedScene viewed;
  viewed.title = title;
  viewed.frame = scene.frame;
  for (const auto* views : {&scene.train, &scene.test}) {
    for (const View& view : *views) {
      viewed.views.push_back({view.name, view.camera, views == &scene.test, view.image != nullptr});
    }
  }
  viewed.is_metric = scene.georeference.has_value();
  viewed.up = scene_up(scene);
  const CoordinateFrame around = choose_frame({}, {points.begin(), points.end()});
  viewed.center = around.origin;
  viewed.radius = 0.5 * kTypicalDepth * around.unit;  // the median distance of the points
  return viewed;
}

const View& view_at(const Scene& scene, int index) {
  const auto i = static_cast<std::size_t>(index);
  return i < scene.train.size() ? scene.train[i] : scene.test.at(i - scene.train.size());
}

Image8 WatchedScene::photograph(int view, ImageSize size) const {
  const std::shared_ptr<const Image8> image = view_at(source_, view).image->read();
  if (image->width == size.width && image->height == size.height) return *image;
  return resize_image(*image, size.width, size.height);
}

Frame WatchedScene::paint(const FrameRequest& request, const GaussianTensors& gaussians, RenderSettings settings) {
  const double start_s = steady_seconds();
  settings.keep_for_backward = false;
  const RenderedView rendered = rasterizer_.forward(gaussians, to_camera_view(request.camera), settings);
  Frame frame;
  frame.n_gaussians = gaussians.size();
  if (request.mode == FrameMode::kAlpha) {
    frame.image = to_image8(rendered.alpha);
    frame.legend = "alpha: black 0, white 1";
  } else if (request.mode == FrameMode::kDepth) {
    paint_depth(rendered, viewed_.frame.unit, frame);
  } else {
    frame.image = to_image8(rendered.color);
  }
  frame.render_ms = 1000 * (steady_seconds() - start_s);
  if (request.pick) {
    const auto point = surface_point(request, rendered);
    if (point) frame.point = viewed_.frame.to_world(point->data());
  }
  if (request.mode == FrameMode::kDifference) paint_difference(*request.photograph, frame);
  if (request.mode == FrameMode::kLoad) paint_load(rasterizer_.count_load(), settings.tile_shape(), frame);
  return frame;
}

void WatchedModel::run(const std::atomic<int>& stop_signal) {
  const auto paint = [this](const FrameRequest& request) {
    Frame frame = WatchedScene::paint(request, model_.gaussians, model_.settings);
    frame.iteration = model_.iteration;
    return frame;
  };
  while (stop_signal == 0) queue_.serve(paint, std::chrono::milliseconds(100));
}

ViewState WatchedModel::state(int) const {
  ViewState state;
  state.iteration = state.iterations = model_.iteration;
  state.n_gaussians = model_.gaussians.size();
  state.kernel = kernel_name(model_.settings.kernel);
  state.activity = "at rest";
  return state;
}

void WatchedModel::command(ViewCommand) {
  input_error("this is a model at rest: there is no training to command");
}

}  // namespace b3dgs
