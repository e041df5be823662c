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
  std::vector<ViewQuality> views;         // those that have a valid pixel to compare
  ImageQuality mean;                      // of `views`; 0 if there are none
  bool fits_left_half = false;            // only right halves were measured, with colours fitted to the left ones
  std::string lpips_network{};            // file name; empty: LPIPS was not computed
  std::vector<std::string> unmeasured{};  // names of views without a valid pixel
};

/// "", or what follows a number of views: "; 2 more have no valid pixel (first: b.png)".
inline std::string describe_unmeasured(const Evaluation& evaluation) {
  const std::size_t n = evaluation.unmeasured.size();
  if (n == 0) return "";
  return "; " + std::to_string(n) + (n == 1 ? " more has no valid pixel (" : " more have no valid pixel (first: ") +
         evaluation.unmeasured.front() + ")";
}

}  // namespace b3dgs
