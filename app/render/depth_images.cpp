#include "app/render/depth_images.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"

namespace b3dgs {
namespace {

constexpr std::int64_t kDepthSamples = 20000;  // number of examined Gaussians
constexpr double kLeastLogitOpacity = -2;      // more transparent ones do not form a surface
constexpr std::size_t kPixelSamples = 10000;
constexpr float kOpaque = 0.5f;
constexpr double kPercentile = 0.02;

/// Returns a range whose inverse depths differ, so that it can be scaled.
DepthRange range_of(std::vector<double>& depths) {
  std::sort(depths.begin(), depths.end());
  const auto at = [&](double share) {
    return depths[static_cast<std::size_t>(share * static_cast<double>(depths.size() - 1))];
  };
  const double near = at(kPercentile);
  return {near, std::max(at(1 - kPercentile), 1.001 * near)};
}

}  // namespace

Image8 colored(const cv::Mat& grey, int map) {
  cv::Mat bgr;
  cv::applyColorMap(grey, bgr, map);
  Image8 image(grey.cols, grey.rows, 3);
  cv::Mat rgb(grey.rows, grey.cols, CV_8UC3, image.pixels.data());
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  return image;
}

DepthRange visible_depth_range(const SplatCloud& splats, const std::vector<Camera>& cameras, double near_plane) {
  std::vector<double> depths;
  const std::int64_t stride = std::max<std::int64_t>(1, splats.size() / kDepthSamples);
  const std::size_t camera_stride = std::max<std::size_t>(1, cameras.size() / 50);
  for (std::size_t c = 0; c < cameras.size(); c += camera_stride) {
    const Camera& camera = cameras[c];
    for (std::int64_t i = 0; i < splats.size(); i += stride) {
      if (splats.logit_opacities[static_cast<std::size_t>(i)] < kLeastLogitOpacity) continue;
      const auto place = camera.project(&splats.means[static_cast<std::size_t>(3 * i)]);
      if (place && place->depth > near_plane) depths.push_back(place->depth);
    }
  }
  if (depths.empty()) return {near_plane, 2 * near_plane};
  return range_of(depths);
}

DepthRange depth_range(const torch::Tensor& depth, const torch::Tensor& alpha) {
  const torch::Tensor depth_cpu = depth.cpu().contiguous(), alpha_cpu = alpha.cpu().contiguous();
  const float* depths = depth_cpu.data_ptr<float>();
  const float* alphas = alpha_cpu.data_ptr<float>();
  const auto n = static_cast<std::size_t>(depth_cpu.numel());
  std::vector<double> samples;
  for (std::size_t i = 0; i < n; i += 1 + n / kPixelSamples) {
    if (alphas[i] > kOpaque && depths[i] > 0) samples.push_back(double{depths[i]} / alphas[i]);
  }
  return samples.empty() ? DepthRange{1, 2} : range_of(samples);
}

Image8 color_depth(const torch::Tensor& depth, const torch::Tensor& alpha, const DepthRange& range) {
  const torch::Tensor depth_cpu = depth.cpu().contiguous(), alpha_cpu = alpha.cpu().contiguous();
  B3DGS_CHECK(depth_cpu.sizes() == alpha_cpu.sizes() && depth_cpu.dim() == 2, "depth and alpha are [H, W]");
  cv::Mat nearness(static_cast<int>(depth_cpu.size(0)), static_cast<int>(depth_cpu.size(1)), CV_8UC1, cv::Scalar(0));
  const float* depths = depth_cpu.data_ptr<float>();
  const float* alphas = alpha_cpu.data_ptr<float>();
  const auto is_seen = [&](std::size_t i) { return alphas[i] > 0 && depths[i] > 0; };
  for (std::size_t i = 0; i < nearness.total(); ++i) {
    if (!is_seen(i)) continue;
    const double inverse = alphas[i] / depths[i];
    const double share = (inverse - 1 / range.far) / (1 / range.near - 1 / range.far);
    nearness.data[i] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(share, 0.0, 1.0)));
  }
  Image8 image = colored(nearness, cv::COLORMAP_TURBO);
  for (std::size_t i = 0; i < image.pixels.size(); ++i) {
    const float weight = is_seen(i / 3) ? std::clamp(alphas[i / 3], 0.0f, 1.0f) : 0;
    image.pixels[i] = static_cast<std::uint8_t>(std::lround(image.pixels[i] * weight));
  }
  return image;
}

Image8 color_normals(const torch::Tensor& normal) {
  const torch::Tensor normal_cpu = normal.cpu().contiguous();
  B3DGS_CHECK(normal_cpu.dim() == 3 && normal_cpu.size(2) == 3, "normals are [H, W, 3]");
  Image8 image(static_cast<int>(normal_cpu.size(1)), static_cast<int>(normal_cpu.size(0)), 3);
  const float* normals = normal_cpu.data_ptr<float>();
  const auto level = [](float value) {
    return static_cast<std::uint8_t>(std::lround(127.5f * (1 + std::clamp(value, -1.0f, 1.0f))));
  };
  for (std::size_t i = 0; i < image.pixels.size(); i += 3) {
    const float x = normals[i], y = normals[i + 1], z = normals[i + 2];
    if (x == 0 && y == 0 && z == 0) continue;
    image.pixels[i] = level(x);
    image.pixels[i + 1] = level(-y);
    image.pixels[i + 2] = level(-z);
  }
  return image;
}

std::vector<float> mean_depths(const torch::Tensor& depth, const torch::Tensor& alpha) {
  const torch::Tensor means =
      torch::where(alpha >= kLeastDepthAlpha, depth / alpha, torch::zeros_like(depth)).cpu().contiguous();
  return {means.data_ptr<float>(), means.data_ptr<float>() + means.numel()};
}

InverseDepth16 inverse_depth_16(const std::vector<float>& depths, ImageSize size, double scale) {
  constexpr double kMax = 65535;
  InverseDepth16 result{Depth16(size.width, size.height), 0};
  B3DGS_CHECK(depths.size() == result.map.pixels.size() && scale > 0, depths.size(), " depths, scale ", scale);
  for (std::size_t i = 0; i < depths.size(); ++i) {
    if (depths[i] <= 0) continue;
    const double value = std::round(scale / depths[i]);
    result.n_too_near += value > kMax ? 1 : 0;
    result.map.pixels[i] = static_cast<std::uint16_t>(std::min(value, kMax));
  }
  return result;
}

void write_depth_scale(const std::filesystem::path& folder, double scale) {
  const nlohmann::ordered_json json{{"format", "16-bit inverse depth"},
                                    {"depth", "scale / value, along the camera's z axis, world units; 0: nothing seen"},
                                    {"scale", scale}};
  write_file(folder / "depth.json", json.dump(2) + "\n");
}

}  // namespace b3dgs
