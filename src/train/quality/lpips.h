// LPIPS (Zhang et al. 2018), a perceptual distance between images, computed by a network that the user provides: a
// TorchScript file whose forward(a, b) takes two float images [1, 3, H, W] in [0, 1] and returns one number. The file
// determines the network and how it scales its inputs; values of different networks cannot be compared.
#pragma once

#include <torch/types.h>

#include <filesystem>
#include <memory>
#include <string>

#include "scene/images/image.h"

namespace b3dgs {

class LpipsNetwork {
 public:
  /// @throws InputError if the file is missing or not TorchScript
  LpipsNetwork(const std::filesystem::path& file, torch::Device device);
  ~LpipsNetwork();

  /// LPIPS between a rendered image [H, W, 3], clamped to [0, 1] and rounded to 8 bits, and the photograph. Pixels
  /// where `valid` is 0 are set to black in both; null = all are valid. @throws InputError if the network fails or does
  /// not return one number
  double distance(const torch::Tensor& rendered, const Image8& truth, const Image8* valid) const;

  /// The file's name, to be shown with every value.
  const std::string& name() const { return name_; }

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
  std::string name_;
};

}  // namespace b3dgs
