// Inverse depth maps of the training views (--depths), and the gradient of their loss.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "scene/scene.h"
#include "scene/view_image.h"

namespace b3dgs {

/// Converts the values of an inverse depth map, which a network estimates up to scale and offset, to inverse depths of
/// the scene: 1 / z = scale * value + offset, in 1 / world units.
struct DepthAlignment {
  double scale = 0, offset = 0;
};

inline constexpr std::size_t kMinAlignmentPoints = 11;
// A map is used only if its scale, divided by the median of all scales, is in this range.
inline constexpr double kMinScaleRatio = 0.2, kMaxScaleRatio = 5;

/// Computes the alignment from the map's value at each point that the view sees, and the point's 1 / z. The scale is
/// the ratio of the mean absolute deviations from the median, and the offset maps median to median. Returns nothing for
/// fewer than kMinAlignmentPoints, or if all values or all inverse depths are equal.
std::optional<DepthAlignment> align_depth(const std::vector<double>& values, const std::vector<double>& inverse_depths);

/// Removes alignments whose scale is too far from the median of all scales.
void remove_unlikely_alignments(std::vector<std::optional<DepthAlignment>>& alignments);

/// Returns the path of each training view's map, which need not exist: FOLDER/NAME.png, where NAME is the photograph's
/// name without its extension. A relative folder is looked for in the scene folder, then in the current folder.
/// @throws InputError if there is no such folder
std::vector<std::filesystem::path> depth_map_files(const std::string& folder, const Scene& scene);

/// The maps of a scene, with 2 bytes per pixel. They are kept in host memory within the limit of ImageMemory, and read
/// from disk for each step otherwise. Create this before photographs are cached, because reading photographs from disk
/// costs less.
class DepthPriors {
 public:
  /// Reads the files of `folder` and aligns each map with the points that its view sees (View::points). Views without a
  /// map, and maps that cannot be aligned, are skipped and counted in warnings(). @throws InputError if a map cannot be
  /// read, or no map can be used
  DepthPriors(const std::string& folder, const Scene& scene, torch::Device device, const ProgressFn& progress = {});

  /// Returns warnings of one line each.
  const std::vector<std::string>& warnings() const { return warnings_; }

  /// Returns whether this training view has a map.
  bool has(std::int32_t view) const { return priors_[static_cast<std::size_t>(view)].alignment.has_value(); }
  const std::optional<DepthAlignment>& alignment(std::int32_t view) const {
    return priors_[static_cast<std::size_t>(view)].alignment;
  }

  /// Returns the gradient of weight * mean over valid pixels of |rendered - aligned map| with respect to `rendered`, a
  /// view's inverse depth [H, W], valid until the next call. H and W are the size of the view, which may be reduced.
  /// `valid` [H, W] uint8 with n_valid nonzero pixels, and `map_valid` for the full size, are undefined if all pixels
  /// are valid. Asynchronous on a GPU.
  torch::Tensor gradient(std::int32_t view, const torch::Tensor& rendered, const torch::Tensor& valid,
                         std::int64_t n_valid, const torch::Tensor& map_valid, double weight);

 private:
  struct Prior {
    std::optional<DepthAlignment> alignment;
    torch::Tensor map;           // [H, W] int16 with the bits of uint16, on the host; undefined: read from `file`
    std::filesystem::path file;  // empty: no map
    std::shared_ptr<const ViewImage> image;  // declared before `memory`, which belongs to its scene
    ImageMemory::Use memory;                 // memory reserved for `map`
  };

  /// Reserves host memory for as many maps as fit.
  void reserve_memory();
  torch::Tensor to_host_tensor(const Depth16& map) const;

  torch::Device device_;
  std::vector<Prior> priors_;  // by training view
  std::vector<std::string> warnings_;
  torch::Tensor map_, map_room_, grad_, grad_room_;
};

}  // namespace b3dgs
