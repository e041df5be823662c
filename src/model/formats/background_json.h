// background.json, beside the PLY of a model that was trained with --background learned or sky:
//
//   {"type": "sky", "sh_degree": 4, "coefficients": [[r, g, b], ...]}
//
// The colour behind the Gaussians in a direction d, a unit vector in the world frame, is
//   sigmoid(sum over k of Y_k(d) * coefficients[k])
// with the real spherical harmonics Y_k in the order and with the signs of 3DGS, continued to degree 4
// (src/train/background/background_args.h). Type "learned" has degree 0, which is one colour; "color" then repeats it
// as RGB from 0 to 1.
#pragma once

#include <filesystem>
#include <optional>
#include <vector>

namespace b3dgs {

struct BackgroundSh {
  std::vector<float> coefficients;  // [K, 3], K = 1 or 25
};

/// Beside a PLY: FOLDER/background.json.
std::filesystem::path background_path(const std::filesystem::path& ply);

/// @throws IoError
void write_background_json(const std::filesystem::path& path, const BackgroundSh& background);

/// Nothing if there is no such file. @throws InputError if it is damaged
std::optional<BackgroundSh> read_background_json(const std::filesystem::path& path);

}  // namespace b3dgs
