#include "app/render/depth_numbers.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "core/check.h"
#include "core/files/atomic_file.h"

namespace b3dgs {

std::vector<float> mean_depths(const torch::Tensor& depth, const torch::Tensor& alpha) {
  const torch::Tensor depth_cpu = depth.cpu().contiguous(), alpha_cpu = alpha.cpu().contiguous();
  B3DGS_CHECK(depth_cpu.sizes() == alpha_cpu.sizes() && depth_cpu.dim() == 2, "depth and alpha are [H, W]");
  const float* sums = depth_cpu.data_ptr<float>();
  const float* alphas = alpha_cpu.data_ptr<float>();
  std::vector<float> means(static_cast<std::size_t>(depth_cpu.numel()));
  for (std::size_t i = 0; i < means.size(); ++i) means[i] = alphas[i] >= kLeastDepthAlpha ? sums[i] / alphas[i] : 0;
  return means;
}

InverseDepth16 inverse_depth_16(const std::vector<float>& depths, ImageSize size, double scale) {
  constexpr double kMax = 65535;
  InverseDepth16 result{Depth16(size.width, size.height), 0};
  B3DGS_CHECK(depths.size() == result.map.values.size() && scale > 0, depths.size(), " depths, scale ", scale);
  for (std::size_t i = 0; i < depths.size(); ++i) {
    if (depths[i] <= 0) continue;
    const double value = std::round(scale / depths[i]);
    result.n_too_near += value > kMax ? 1 : 0;
    result.map.values[i] = static_cast<std::uint16_t>(std::min(value, kMax));
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
