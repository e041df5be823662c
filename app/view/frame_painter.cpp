#include "app/view/frame_painter.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "adaptive/load_statistics.h"
#include "app/colors/depth_colors.h"
#include "core/print.h"
#include "core/text.h"
#include "model/raster_input.h"
#include "train/quality/metrics.h"

namespace b3dgs {
namespace {

constexpr double kFullError = 0.25;  // mean absolute difference of a pixel's channels that has the brightest colour

double now_ms() {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Grey values in the colours of an OpenCV map, as RGB.
Image8 colored(cv::Mat& grey, int map) {
  cv::Mat bgr;
  cv::applyColorMap(grey, bgr, map);
  Image8 image(grey.cols, grey.rows, 3);
  cv::Mat rgb(grey.rows, grey.cols, CV_8UC3, image.pixels.data());
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  return image;
}

std::uint8_t to_byte(double share) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(share, 0.0, 1.0)));
}

void paint_depth(const RenderedView& rendered, double unit, Frame& frame) {
  const DepthRange range = depth_range(rendered.depth, rendered.alpha);
  frame.image = color_depth(rendered.depth, rendered.alpha, range);
  frame.legend =
      print_to_string("inverse depth: red %.4g to blue %.4g world units", unit * range.near, unit * range.far);
}

void paint_difference(const Image8& photograph, Frame& frame) {
  const Image8 rendered = std::move(frame.image);
  B3DGS_CHECK(photograph.pixels.size() == rendered.pixels.size(), "a photograph of another size");
  cv::Mat grey(rendered.height, rendered.width, CV_8UC1);
  double squares = 0, sum = 0;
  for (int y = 0; y < rendered.height; ++y) {
    for (int x = 0; x < rendered.width; ++x) {
      int difference = 0;
      const std::size_t at =
          3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(rendered.width) + static_cast<std::size_t>(x));
      for (std::size_t c = 0; c < 3; ++c) {
        const int d = std::abs(int{rendered.pixels[at + c]} - int{photograph.pixels[at + c]});
        difference += d;
        squares += d * d;
      }
      sum += difference;
      grey.at<std::uint8_t>(y, x) = to_byte(difference / (3 * 255.0) / kFullError);
    }
  }
  const auto n = static_cast<double>(rendered.pixels.size());
  const double psnr = squares > 0 ? 10 * std::log10(255.0 * 255.0 * n / squares) : 99;
  frame.image = colored(grey, cv::COLORMAP_INFERNO);
  frame.legend =
      print_to_string("absolute difference, mean %.4f; black 0, yellow %.2f or more; PSNR %.2f dB at %d x %d",
                      sum / n / 255, kFullError, psnr, rendered.width, rendered.height);
}

/// Entries of each tile's list, on a logarithmic scale.
void paint_load(const ViewLoad& load, const TileShape& tile, Frame& frame) {
  const torch::Tensor lists = load.tile_lists.contiguous();
  const std::int64_t* entries = lists.data_ptr<std::int64_t>();
  const LoadStatistics statistics = load_statistics(entries, lists.numel());
  const int width = frame.image.width, height = frame.image.height;
  const int n_columns = (width + tile.width - 1) / tile.width;
  const double full = std::log2(1.0 + static_cast<double>(std::max<std::int64_t>(1, statistics.max)));
  cv::Mat grey(height, width, CV_8UC1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto n = static_cast<double>(entries[(y / tile.height) * n_columns + x / tile.width]);
      grey.at<std::uint8_t>(y, x) = to_byte(std::log2(1 + n) / full);
    }
  }
  frame.image = colored(grey, cv::COLORMAP_TURBO);
  frame.legend = print_to_string(
      "splats per tile of %d x %d px, logarithmic: black 0, red %s; median %s, 99th percentile %s, Gini %.2f",
      tile.width, tile.height, format_count(statistics.max).c_str(), format_count(statistics.median).c_str(),
      format_count(statistics.p99).c_str(), statistics.gini);
}

}  // namespace

Frame FramePainter::paint(const FrameRequest& request, const GaussianTensors& gaussians, RenderSettings settings) {
  const double start_ms = now_ms();
  settings.keep_for_backward = false;
  const PinholeView view = to_pinhole_view(request.camera);
  const RenderedView rendered = rasterizer_.forward(gaussians, view, settings);
  Frame frame;
  frame.n_gaussians = gaussians.size();
  if (request.mode == FrameMode::kAlpha) {
    frame.image = to_image8(rendered.alpha);
    frame.legend = "alpha: black 0, white 1";
  } else if (request.mode == FrameMode::kDepth) {
    paint_depth(rendered, unit_, frame);
  } else {
    frame.image = to_image8(rendered.color);
  }
  frame.render_ms = now_ms() - start_ms;
  if (request.mode == FrameMode::kDifference) paint_difference(*request.photograph, frame);
  if (request.mode == FrameMode::kLoad) paint_load(rasterizer_.count_load(), settings.tile, frame);
  return frame;
}

}  // namespace b3dgs
