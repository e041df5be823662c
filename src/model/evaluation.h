// How closely the renders of a model match the photographs.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace b3dgs {

struct ImageQuality {
  double psnr = 0;  // dB
  double ssim = 0;
  std::optional<double> corrected_psnr{};  // dB, of the render with its colours fitted to the photograph
  std::optional<double> lpips{};           // by Evaluation::lpips_network
};

struct ViewQuality {
  std::string name;
  ImageQuality quality;
};

struct Evaluation {
  std::vector<ViewQuality> views;
  ImageQuality mean;
  bool fits_left_half = false;  // only right halves were measured, with colours fitted to the left ones
  std::string lpips_network{};  // file name; empty: LPIPS was not computed
};

}  // namespace b3dgs
