#include "train/depth/depth_priors.h"

#include <algorithm>
#include <cmath>
#include <mutex>

#include "core/check.h"
#include "core/files/unicode_names.h"
#include "core/parallel.h"
#include "core/text.h"
#include "raster/torch/tensors.h"
#include "raster/torch/torch_cuda.h"
#include "train/depth/depth_loss.h"

namespace b3dgs {
namespace {

/// Returns the median, which for an even number of values is the mean of the two in the middle.
double median(std::vector<double> values) {
  const std::size_t half = values.size() / 2;
  std::sort(values.begin(), values.end());
  return values.size() % 2 == 1 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

double mean_absolute_deviation(const std::vector<double>& values, double from) {
  double sum = 0;
  for (const double value : values) sum += std::abs(value - from);
  return sum / static_cast<double>(values.size());
}

}  // namespace

std::optional<DepthAlignment> align_depth(const std::vector<double>& values,
                                          const std::vector<double>& inverse_depths) {
  if (values.size() < kMinAlignmentPoints) return std::nullopt;
  const double middle = median(values), middle_inverse = median(inverse_depths);
  const double spread = mean_absolute_deviation(values, middle),
               inverse_spread = mean_absolute_deviation(inverse_depths, middle_inverse);
  if (!(spread > 0) || !(inverse_spread > 0)) return std::nullopt;
  const double scale = inverse_spread / spread;
  return DepthAlignment{scale, middle_inverse - scale * middle};
}

void remove_unlikely_alignments(std::vector<std::optional<DepthAlignment>>& alignments) {
  std::vector<double> scales;
  for (const std::optional<DepthAlignment>& own : alignments) {
    if (own) scales.push_back(own->scale);
  }
  if (scales.empty()) return;
  const double middle = median(scales);
  for (std::optional<DepthAlignment>& own : alignments) {
    if (own && (own->scale < kMinScaleRatio * middle || own->scale > kMaxScaleRatio * middle)) own.reset();
  }
}

namespace {

namespace fs = std::filesystem;

fs::path find_folder(const std::string& folder, const Scene& scene) {
  for (const fs::path& path : {fs::path(scene.source_path) / folder, fs::path(folder)}) {
    if (fs::is_directory(path)) return path;
  }
  input_error("folder of depth maps not found: ", folder, " (expected in ", scene.source_path,
              " or in the current folder)");
}

/// Interpolates bilinearly between pixel centres at (i + 0.5, j + 0.5). Values at the edges continue outwards.
double sample(const Depth16& map, double x, double y) {
  const double column = std::clamp(x - 0.5, 0.0, map.width - 1.0), row = std::clamp(y - 0.5, 0.0, map.height - 1.0);
  const int left = std::min(static_cast<int>(column), std::max(0, map.width - 2)),
            above = std::min(static_cast<int>(row), std::max(0, map.height - 2));
  const int right = std::min(left + 1, map.width - 1), below = std::min(above + 1, map.height - 1);
  const double u = column - left, v = row - above;
  const auto at = [&](std::int64_t i, std::int64_t j) {
    return static_cast<double>(map.pixels[static_cast<std::size_t>(j * map.width + i)]);
  };
  return (1 - v) * ((1 - u) * at(left, above) + u * at(right, above)) +
         v * ((1 - u) * at(left, below) + u * at(right, below));
}

/// Computes the alignment from the points that the view sees and that project into its valid pixels.
std::optional<DepthAlignment> align_view(const View& view, const Depth16& map, const PointCloud& points) {
  const Camera& camera = view.camera;
  std::vector<double> values, inverse_depths;
  for (const std::int32_t point : view.points) {
    const float* const position = points.positions.data() + 3 * static_cast<std::size_t>(point);
    const auto place = camera.project(position);
    if (!place) continue;
    const auto pixel = static_cast<std::int64_t>(place->y) * camera.width + static_cast<std::int64_t>(place->x);
    if (view.valid && view.valid->pixels[static_cast<std::size_t>(pixel)] == 0) continue;
    values.push_back(sample(map, place->x, place->y));
    inverse_depths.push_back(1 / place->depth);
  }
  return align_depth(values, inverse_depths);
}

}  // namespace

std::vector<fs::path> depth_map_files(const std::string& folder, const Scene& scene) {
  const fs::path root = find_folder(folder, scene);
  std::vector<fs::path> files;
  for (const View& view : scene.train) {
    const std::string name = fs::path(view.name).replace_extension(".png").string();
    const fs::path file = find_in_any_form(root, name);
    files.push_back(file.empty() ? root / name : file);
  }
  return files;
}

DepthPriors::DepthPriors(const std::string& folder, const Scene& scene, torch::Device device,
                         const ProgressFn& progress)
    : device_(device), priors_(scene.train.size()) {
  const std::string root = find_folder(folder, scene).string();
  const std::vector<fs::path> files = depth_map_files(folder, scene);
  const std::size_t n_views = scene.train.size();
  for (std::size_t i = 0; i < n_views; ++i) {
    if (fs::exists(files[i])) priors_[i].file = files[i];
    priors_[i].image = scene.train[i].image;
  }
  reserve_memory();
  std::vector<std::optional<DepthAlignment>> alignments(n_views);
  std::mutex mutex;
  std::size_t done = 0;
  parallel_pool(static_cast<std::int64_t>(n_views), [&](std::int64_t task, int) {
    const auto i = static_cast<std::size_t>(task);
    const View& view = scene.train[i];
    Prior& prior = priors_[i];
    if (!prior.file.empty()) {
      const Depth16 map = view.image->read_depth(prior.file);
      alignments[i] = align_view(view, map, scene.points);
      const bool stays = prior.memory != nullptr || view.image->memory() == nullptr;
      if (alignments[i] && stays) prior.map = to_host_tensor(map);
    }
    const std::lock_guard lock(mutex);
    if (progress) progress("loading depth maps", ++done, n_views);
  });
  const std::vector<std::optional<DepthAlignment>> all = alignments;
  remove_unlikely_alignments(alignments);
  std::vector<std::string> missing, not_aligned, unlikely;
  for (std::size_t i = 0; i < n_views; ++i) {
    Prior& prior = priors_[i];
    prior.alignment = alignments[i];
    if (prior.alignment) continue;
    prior.map = torch::Tensor();
    prior.memory.reset();
    (prior.file.empty() ? missing : !all[i] ? not_aligned : unlikely).push_back(scene.train[i].name);
  }
  if (missing.size() == n_views) {
    input_error(root, ": no depth map found (expected 16-bit PNGs named like the photographs, such as ",
                fs::path(missing.front()).replace_extension(".png").string(), ")");
  }
  if (missing.size() + not_aligned.size() + unlikely.size() == n_views) {
    input_error(root, ": no depth map can be aligned with the scene's points: each view needs at least ",
                kMinAlignmentPoints, " points in its tracks (points3D), at different depths");
  }
  const auto warn = [&](const std::vector<std::string>& names, const std::string& what) {
    if (names.empty()) return;
    warnings_.push_back(detail::concat(names.size(), " of ", n_views, " training views ", what, " (first: ", names[0],
                                       "); they are trained without depth"));
  };
  warn(missing, "have no depth map");
  warn(not_aligned, "see too few points to align their depth maps");
  warn(unlikely, detail::concat("have depth maps whose scale is outside ", kMinScaleRatio, " to ", kMaxScaleRatio,
                                " times the median"));
}

void DepthPriors::reserve_memory() {
  std::size_t n_read = 0, n_maps = 0;
  std::int64_t n_bytes = 0;
  for (Prior& prior : priors_) {
    if (prior.file.empty()) continue;
    ++n_maps;
    ImageMemory* const memory = prior.image->memory();
    if (memory == nullptr) continue;
    const ImageSize size = prior.image->size();
    const std::int64_t bytes = std::int64_t{sizeof(std::uint16_t)} * size.width * size.height;
    n_bytes += bytes;
    prior.memory = memory->reserve(bytes);
    n_read += prior.memory ? 0 : 1;
  }
  if (n_read == 0) return;
  warnings_.push_back(
      detail::concat(n_read, " of ", n_maps, " depth maps do not fit in host memory (all take ", format_bytes(n_bytes),
                     ") and are read from disk for each step, which is slower; raise --host_memory_gb, ",
                     "or use smaller images (-r 2)"));
}

torch::Tensor DepthPriors::to_host_tensor(const Depth16& map) const {
  const torch::TensorOptions options = torch::TensorOptions(torch::kInt16).pinned_memory(device_.is_cuda());
  torch::Tensor tensor = torch::empty({map.height, map.width}, options);
  std::copy_n(map.pixels.data(), map.pixels.size(), reinterpret_cast<std::uint16_t*>(tensor.data_ptr<std::int16_t>()));
  return tensor;
}

torch::Tensor DepthPriors::gradient(std::int32_t view, const torch::Tensor& rendered, const torch::Tensor& valid,
                                    std::int64_t n_valid, const torch::Tensor& map_valid, double weight) {
  const Prior& prior = priors_[static_cast<std::size_t>(view)];
  B3DGS_CHECK(prior.alignment, "training view ", view, " has no depth map");
  TensorCheck(device_).dims("rendered", rendered, {"H", "W"});
  const std::int64_t height = rendered.size(0), width = rendered.size(1);
  torch::Tensor map = prior.map.defined() ? prior.map : to_host_tensor(prior.image->read_depth(prior.file));
  const std::int64_t map_height = map.size(0), map_width = map.size(1);
  const std::int64_t reduction = std::min(map_width / width, map_height / height);
  B3DGS_CHECK(reduction >= 1, "a depth map of ", map_width, " x ", map_height, " px for a render of ", width, " x ",
              height);
  place_tensor(grad_, grad_room_, rendered.sizes(), rendered.options());
  if (device_.is_cuda()) {
    place_tensor(map_, map_room_, map.sizes(), rendered.options().dtype(torch::kInt16));
    map_.copy_(map, /*non_blocking=*/true);
    map = map_;
  }
  DepthLossArgs args;
  args.width = static_cast<std::int32_t>(width);
  args.height = static_cast<std::int32_t>(height);
  args.rendered = rendered.data_ptr<float>();
  args.valid = data_or_null<std::uint8_t>(valid);
  args.map_width = static_cast<std::int32_t>(map_width);
  args.reduction = static_cast<std::int32_t>(reduction);
  args.map = reinterpret_cast<const std::uint16_t*>(map.data_ptr<std::int16_t>());
  args.map_valid = data_or_null<std::uint8_t>(map_valid);
  args.scale = static_cast<float>(prior.alignment->scale);
  args.offset = static_cast<float>(prior.alignment->offset);
  args.gradient = n_valid > 0 ? static_cast<float>(weight / static_cast<double>(n_valid)) : 0.0f;
  args.grad = grad_.data_ptr<float>();
  for_rows<depth_loss_grad_at>(device_.is_cuda(), args, width * height);
  return grad_;
}

}  // namespace b3dgs
