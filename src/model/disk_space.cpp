#include "model/disk_space.h"

#include "core/check.h"
#include "core/text.h"
#include "model/formats/splat_cloud.h"

namespace b3dgs {

std::int64_t free_disk_bytes(const std::filesystem::path& folder) {
  std::error_code error;
  const std::filesystem::space_info space = std::filesystem::space(folder, error);
  return error ? -1 : static_cast<std::int64_t>(space.available);
}

std::int64_t ply_bytes(std::int64_t n_gaussians, int sh_degree) {
  constexpr std::int64_t kFloatBytes = 4, kNormals = 3;
  const std::int64_t parameters = 11 + 3 * std::int64_t{sh_coefficient_count(sh_degree)};
  return kFloatBytes * n_gaussians * (parameters + kNormals);
}

std::string disk_warning(const std::filesystem::path& folder, std::int64_t free_bytes, const FirstFiles& files,
                         int n_checkpoints) {
  const std::int64_t wanted = files.ply_bytes + (n_checkpoints + 1) * files.checkpoint_bytes;
  if (free_bytes < 0 || free_bytes >= wanted) return "";
  return detail::concat(
      folder.string(), ": ", format_bytes(free_bytes), " free on this disk, expected ", format_bytes(wanted),
      " or more: the size of a PLY and ", n_checkpoints + 1, " checkpoints of the ", files.n_gaussians,
      " Gaussians that training starts with, before densification; free some space, or ", "lower --max_gaussians");
}

}  // namespace b3dgs
