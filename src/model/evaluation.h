// How closely the renders of a model match the photographs.
#pragma once

#include <string>
#include <vector>

namespace b3dgs {

struct ImageQuality {
  double psnr = 0;  // dB
  double ssim = 0;
};

struct ViewQuality {
  std::string name;
  ImageQuality quality;
};

struct Evaluation {
  std::vector<ViewQuality> views;
  ImageQuality mean;
};

}  // namespace b3dgs
