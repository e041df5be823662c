#include "scene/scene_model.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "core/text.h"
#include "scene/cameras/camera_lens.h"
#include "scene/images/image.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

using detail::concat;

constexpr std::size_t kMaxListed = 3;         // examples in a line: missing images, sizes, ...
constexpr double kMaxAspectDeviation = 0.02;  // beyond rounding to whole pixels: cropped or rotated images

std::string join(const std::vector<std::string>& items) {
  std::string text;
  for (std::size_t i = 0; i < std::min(items.size(), kMaxListed); ++i) text += (i ? ", " : "") + items[i];
  return items.size() > kMaxListed ? concat(text, ", ... (", items.size(), " in total)") : text;
}

using Lines = std::vector<std::string>;

void add(Lines& lines, std::string label, const std::string& text) {
  label.resize(12, ' ');
  lines.push_back(label + text);
}

std::string describe_images(const SceneOrigin& origin) {
  std::string text = concat(origin.model.model.images.size(), " registered, ", origin.sources.size(), " found in ",
                            origin.image_folder.folder().string());
  if (!origin.missing.empty()) text += concat(", ", origin.missing.size(), " missing (", join(origin.missing), ")");
  if (origin.n_unregistered > 0) text += concat(", ", origin.n_unregistered, " more not in the model");
  return text;
}

std::string describe_cameras(const ColmapModel& model) {
  std::map<std::string, std::size_t> kinds;
  for (const auto& [id, camera] : model.cameras) {
    ++kinds[concat(camera_model_name(camera.model), " ", camera.width, "x", camera.height)];
  }
  std::vector<std::string> texts;
  texts.reserve(kinds.size());
  for (const auto& [kind, count] : kinds) texts.push_back(count > 1 ? concat(count, " x ", kind) : kind);
  return concat(model.cameras.size(), ": ", join(texts));
}

template <class Visit>
void for_each_view(const Scene& scene, Visit&& visit) {
  for (const View& view : scene.train) visit(view);
  for (const View& view : scene.test) visit(view);
}

template <class Is>
std::size_t count_sources(const SceneOrigin& origin, const Is& is) {
  return static_cast<std::size_t>(std::count_if(origin.sources.begin(), origin.sources.end(), is));
}

bool has_mask(const ViewSource& source) {
  return !source.mask.empty();
}

// Photographs that are used in their lens; "" if there are none.
std::string describe_kept_lenses(const SceneOrigin& origin) {
  const auto is_kept = [](const ViewSource& source) { return !source.camera.is_pinhole(); };
  const std::size_t n = count_sources(origin, is_kept);
  if (n == 0) return "";
  const ViewSource& first = *std::find_if(origin.sources.begin(), origin.sources.end(), is_kept);
  const std::string text = concat(n, n == 1 ? " image is" : " images are", " used as photographed, in the lens");
  if (first.camera.lens.kind == LensKind::kEquirectangular) return text;
  return concat(text, " (--lenses ", origin.options.lenses, "); undistorted, ", first.name, " would show ",
                print_to_string("%.0f", 100 * undistorted_share(first.camera)), "% of its pixels");
}

std::string describe_distortion(const Scene& scene, const SceneOrigin& origin) {
  std::string kept = describe_kept_lenses(origin);
  const std::size_t n_distorted = count_sources(
      origin, [](const ViewSource& source) { return source.camera.is_pinhole() && !source.file_camera.is_pinhole(); });
  if (n_distorted == 0) return kept.empty() ? "none" : kept;
  if (!kept.empty()) kept += "; ";
  if (!origin.options.load_images) return concat(kept, "in ", n_distorted, " images");
  double share = 0;
  for_each_view(scene, [&](const View& view) {
    if (!view.valid) {
      share += 1;
      return;
    }
    const std::vector<std::uint8_t>& mask = view.valid->pixels;
    share += static_cast<double>(std::count(mask.begin(), mask.end(), 255)) / static_cast<double>(mask.size());
  });
  const double percent = 100 * share / static_cast<double>(origin.sources.size());
  return concat(kept, "removed from ", n_distorted, " images, ", print_to_string("%.2f", percent),
                "% of the pixels are valid", count_sources(origin, has_mask) > 0 ? " and not masked" : "");
}

std::string describe_sizes(const SceneOrigin& origin) {
  std::set<std::string> sizes;
  for (const ViewSource& source : origin.sources) {
    const std::string size = concat(source.size.width, "x", source.size.height);
    sizes.insert(source.is_reduced() ? concat(size, " from ", source.file_size.width, "x", source.file_size.height)
                                     : size);
  }
  return join({sizes.begin(), sizes.end()}) + " px";
}

std::string describe_masks(const SceneOrigin& origin) {
  const std::size_t n = count_sources(origin, has_mask);
  if (n == 0) return "none";
  return concat(n, " of ", origin.sources.size(), " photographs",
                origin.options.invert_masks ? ", white is left out" : ", black is left out");
}

std::string describe_memory(const Scene& scene, const SceneOrigin& origin) {
  if (!origin.options.load_images) return "images not loaded";
  std::int64_t bytes = 0;
  for_each_view(scene, [&](const View& view) { bytes += view.image->n_bytes(); });
  const std::int64_t limit = scene.train.front().image->memory()->limit();
  const std::string images = format_bytes(bytes) + " of images";
  if (limit == std::numeric_limits<std::int64_t>::max()) return images;
  return images + ", at most " + format_bytes(limit) + " in memory (--host_memory_gb)";
}

// Choices made for the user, and signs that something is wrong with the scene.
void add_notes(const Scene& scene, const SceneOrigin& origin, Lines& lines) {
  for (const std::string& note : origin.model.notes) add(lines, "note", note);
  if (!origin.image_folder.note().empty()) add(lines, "note", origin.image_folder.note());
  const int resolution = origin.options.resolution;
  bool is_capped = false, is_kept = false;
  std::vector<std::string> other_aspect, other_name;
  for (const ViewSource& source : origin.sources) {
    const ImageSize size = divided_size(source.file_size, origin.image_folder.divisor());
    is_capped = is_capped || (resolution == -1 && size.width > kMaxDefaultWidth);
    is_kept = is_kept || (resolution > 8 && resolution > size.width);
    const ColmapCamera& camera = origin.model.model.cameras.at(source.camera_id);
    const double aspect = static_cast<double>(source.file_size.width) / source.file_size.height;
    const double expected = static_cast<double>(camera.width) / static_cast<double>(camera.height);
    const double step = 1.0 / std::min(source.file_size.width, source.file_size.height);
    if (std::abs(aspect / expected - 1) > kMaxAspectDeviation + step) {
      other_aspect.push_back(source.file.filename().string());
    }
    if (origin.image_folder.find(source.name).empty()) {
      other_name.push_back(concat(source.name, " as ", source.file.filename().string()));
    }
  }
  if (!other_name.empty()) add(lines, "note", concat("found under another name: ", join(other_name)));
  if (is_capped)
    add(lines, "note", concat("images reduced to a width of ", kMaxDefaultWidth, " px; -r 1 keeps the size on disk"));
  if (is_kept) add(lines, "note", concat("-r ", resolution, " is larger than the images, which are not enlarged"));
  if (!other_aspect.empty()) {
    add(lines, "note",
        concat("aspect ratio differs from the camera's (cropped or rotated images?): ", join(other_aspect)));
  }
  if (scene.points.size() == 0) add(lines, "note", "the scene has no points; training finds some in the photographs");
}

}  // namespace

std::vector<std::string> summarize(const Scene& scene, const SceneOrigin& origin) {
  Lines lines;
  add(lines, "scene", scene.source_path);
  add(lines, "model", origin.model.description);
  add(lines, "images", describe_images(origin));
  add(lines, "cameras", describe_cameras(origin.model.model));
  add(lines, "distortion", describe_distortion(scene, origin));
  add(lines, "masks", describe_masks(origin));
  add(lines, "size", describe_sizes(origin));
  add(lines, "memory", describe_memory(scene, origin));
  const std::string& points = origin.model.points_description;
  add(lines, "points",
      points.empty() ? std::to_string(scene.points.size()) : concat(scene.points.size(), ": ", points));
  add(lines, "extent", print_to_string("%.4g", scene.extent * scene.frame.unit));
  const auto count_views = [](std::size_t n) { return concat(n, n == 1 ? " view" : " views"); };
  add(lines, "training", count_views(scene.train.size()));
  const std::string rule = origin.model.has_split ? "the views of " + origin.model.split_description
                                                  : concat("every ", kTestEvery, "th by name");
  add(lines, "held out",
      origin.options.eval ? concat(count_views(scene.test.size()), ", ", rule)
                          : concat("none; --eval holds out ", rule));
  add_notes(scene, origin, lines);
  return lines;
}

}  // namespace b3dgs
