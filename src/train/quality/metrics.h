// Image quality as usual in 3DGS work. PSNR follows from the mean squared error over all pixels and channels in [0, 1].
// SSIM has an 11 x 11 Gaussian window (sigma 1.5 px, C1 = 0.01^2, C2 = 0.03^2, zero padding) and is averaged over
// pixels and channels. Sharpness is the sum over the pixels of |Laplacian| of the render, divided by that of the
// photograph: below 1 for a soft render, above 1 for needles or noise that the photograph does not show. The Laplacian
// is that of the sum of the channels, at pixels that are valid with their four neighbours. Without any contrast in the
// photograph, sharpness is 1.
#pragma once

#include <torch/types.h>

#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "model/model_folder.h"
#include "scene/images/image.h"

namespace torch::jit {
struct Module;
}

namespace b3dgs {

/// Compares a rendered image [H, W, 3] with the photograph. The image is first clamped to [0, 1] and rounded to 8 bits,
/// as it would be saved. Pixels where `valid` is 0 are ignored; null = all are valid. Returns nothing if no pixel is
/// valid.
std::optional<ImageQuality> image_quality(const torch::Tensor& rendered, const Image8& truth, const Image8* valid);

/// Converts [H, W, 3] or [H, W] float in [0, 1] to 8 bits, clamped and rounded, with 0.5 rounded up and NaN as 0.
/// Images on a GPU are converted there, so that only a quarter of the bytes is copied.
Image8 to_image8(const torch::Tensor& image);

/// Returns a copy in host memory. The copy of a tensor on a GPU is pinned, because copying is then several times as
/// fast.
torch::Tensor host_copy(const torch::Tensor& tensor);

// LPIPS (Zhang et al. 2018) is a perceptual distance between images, computed by a network that the user provides as a
// TorchScript file. Its forward(a, b) takes two float images [1, 3, H, W] in [0, 1] and returns one number. The file
// determines the network and how it scales its inputs. Values of different networks cannot be compared.

class LpipsNetwork {
 public:
  /// Loads the network. @throws InputError if the file is missing or not TorchScript
  LpipsNetwork(const std::filesystem::path& file, torch::Device device);

  /// Returns the LPIPS between a rendered image [H, W, 3], clamped to [0, 1] and rounded to 8 bits, and the photograph.
  /// Pixels where `valid` is 0 are set to black in both; null = all are valid. @throws InputError if the network fails
  /// or does not return one number
  double distance(const torch::Tensor& rendered, const Image8& truth, const Image8* valid) const;

  /// Returns the file's name, to be shown with every value.
  const std::string& name() const { return name_; }

 private:
  torch::Device device_;
  std::shared_ptr<torch::jit::Module> module_;
  std::string name_;
};

// An affine transform of colours is fitted to a photograph. Differences that remain are not due to exposure or white
// balance.

/// A transform [3, 4]: colour' = transform (r, g, b, 1).
using ColorTransform = std::array<std::array<double, 4>, 3>;

inline constexpr ColorTransform kSameColors{{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};

/// Returns the transform of `rendered` [H, W, 3] that minimises the mean squared difference from `truth` over the
/// pixels where `valid` is not 0 (null = all), plus 1e-6 times its squared difference from kSameColors. The latter
/// makes the result unique where the colours do not determine it (an image of one colour, no valid pixel).
ColorTransform fit_colors(const torch::Tensor& rendered, const Image8& truth, const Image8* valid);

/// Returns a transformed copy of `rendered` [H, W, 3].
torch::Tensor transform_colors(const torch::Tensor& rendered, const ColorTransform& transform);

/// Returns a mask of the valid pixels in columns [begin, end): 255 there, 0 elsewhere.
Image8 valid_in_columns(int width, int height, const Image8* valid, int begin, int end);

}  // namespace b3dgs
