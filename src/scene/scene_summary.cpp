#include <algorithm>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "core/files/unicode_names.h"
#include "core/text.h"
#include "scene/cameras/camera_lens.h"
#include "scene/scene_model.h"
#include "scene/view_image.h"

namespace b3dgs {
namespace {

using detail::concat;
using Texts = std::vector<std::string>;

std::string join(const Texts& items) {
  constexpr std::size_t kMaxListed = 3;
  std::string text;
  for (std::size_t i = 0; i < std::min(items.size(), kMaxListed); ++i) text += (i ? ", " : "") + items[i];
  return items.size() > kMaxListed ? concat(text, ", ... (", items.size(), " in total)") : text;
}

template <class Is>
std::size_t count_sources(const SceneOrigin& origin, const Is& is) {
  return static_cast<std::size_t>(std::count_if(origin.sources.begin(), origin.sources.end(), is));
}

bool has_mask(const ViewSource& source) {
  return !source.mask_file.empty();
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
  Texts texts;
  for (const auto& [kind, count] : kinds) texts.push_back(count > 1 ? concat(count, " x ", kind) : kind);
  return concat(model.cameras.size(), ": ", join(texts));
}

std::string describe_distortion(const SceneOrigin& origin) {
  const auto is_kept = [](const ViewSource& s) { return !s.camera.is_pinhole(); };
  const std::size_t n_kept = count_sources(origin, is_kept);
  const std::size_t n_removed =
      count_sources(origin, [](const ViewSource& s) { return s.camera.is_pinhole() && !s.file_camera.is_pinhole(); });
  Texts texts;
  if (n_kept > 0) {
    texts.push_back(concat(n_kept, n_kept == 1 ? " image is" : " images are", " used as photographed, in the lens"));
    const ViewSource& first = *std::find_if(origin.sources.begin(), origin.sources.end(), is_kept);
    if (first.camera.lens.kind != LensKind::kEquirectangular) {
      texts.back() += concat(" (--lenses ", origin.options.lenses, "); undistorted, ", first.name, " would show ",
                             print_to_string("%.0f", 100 * undistorted_share(first.camera)), "% of its pixels");
    }
  }
  if (n_removed > 0 && origin.options.load_images) {
    double share = 0;
    for (const ViewSource& source : origin.sources) {
      const auto* mask = source.valid ? &source.valid->pixels : nullptr;
      share += mask ? static_cast<double>(std::count(mask->begin(), mask->end(), 255)) / mask->size() : 1;
    }
    const double percent = 100 * share / static_cast<double>(origin.sources.size());
    texts.push_back(concat("removed from ", n_removed, " images, ", print_to_string("%.2f", percent),
                           "% of the pixels are valid", count_sources(origin, has_mask) > 0 ? " and not masked" : ""));
  } else if (n_removed > 0) {
    texts.push_back(concat("in ", n_removed, " images"));
  }
  return texts.empty() ? "none" : join(texts);
}

std::string describe_masks(const SceneOrigin& origin) {
  const std::size_t n = count_sources(origin, has_mask);
  if (n == 0) return "none";
  return concat(n, " of ", origin.sources.size(), " photographs, ", origin.options.invert_masks ? "white" : "black",
                " is left out");
}

std::string describe_sizes(const SceneOrigin& origin) {
  const auto text = [](ImageSize size) { return concat(size.width, "x", size.height); };
  std::set<std::string> sizes;
  for (const ViewSource& source : origin.sources) {
    sizes.insert(text(source.size) + (source.is_reduced() ? " from " + text(source.file_size) : ""));
  }
  return join({sizes.begin(), sizes.end()}) + " px";
}

std::string describe_memory(const Scene& scene, const SceneOrigin& origin) {
  if (!origin.options.load_images) return "images not loaded";
  std::int64_t bytes = 0;
  for (const std::vector<View>* views : {&scene.train, &scene.test}) {
    for (const View& view : *views) bytes += view.image->n_bytes();
  }
  const std::int64_t limit = (scene.train.empty() ? scene.test : scene.train).front().image->memory()->limit();
  const bool is_limited = limit < std::numeric_limits<std::int64_t>::max();
  return format_bytes(bytes) + " of images" +
         (is_limited ? ", at most " + format_bytes(limit) + " in memory (--host_memory_gb)" : "");
}

// Returns automatic choices, and signs that something is wrong with the scene.
Texts notes_on(const Scene& scene, const SceneOrigin& origin) {
  constexpr double kMaxAspectDeviation = 0.02;  // beyond rounding to whole pixels: cropped or rotated images
  Texts notes = origin.model.notes;
  if (!origin.image_folder.note().empty()) notes.push_back(origin.image_folder.note());
  const int resolution = origin.options.resolution;
  bool is_capped = false, is_kept = false;
  Texts other_aspect, other_name, turned;
  for (const ViewSource& source : origin.sources) {
    const ImageSize size = divided_size(source.file_size, origin.image_folder.divisor());
    is_capped = is_capped || (resolution == -1 && size.width > kMaxDefaultWidth);
    is_kept = is_kept || (resolution > 8 && resolution > size.width);
    const ColmapCamera& camera = origin.model.model.cameras.at(source.camera_id);
    const double aspect = static_cast<double>(source.file_size.width) / source.file_size.height;
    const double expected = static_cast<double>(camera.width) / static_cast<double>(camera.height);
    const double step = 1.0 / std::min(source.file_size.width, source.file_size.height);
    const std::string file = std::filesystem::path(source.file).filename().string();
    if (std::abs(aspect / expected - 1) > kMaxAspectDeviation + step && !source.is_on_side)
      other_aspect.push_back(file);
    if (source.orientation != 1) turned.push_back(file);
    if (!origin.image_folder.find(source.name).empty()) continue;
    const std::string name = std::filesystem::path(source.name).filename().string();
    const bool is_other_form = name != file && composed_name(name) == composed_name(file);  // both look the same
    other_name.push_back(source.name + " as " + (is_other_form ? "the same in another Unicode form" : file));
  }
  if (!other_name.empty()) notes.push_back("found under another name: " + join(other_name));
  if (is_capped) {
    notes.push_back(concat("images reduced to a width of ", kMaxDefaultWidth, " px; -r 1 keeps the size on disk"));
  }
  if (is_kept) notes.push_back(concat("-r ", resolution, " is larger than the images, which are not enlarged"));
  if (!other_aspect.empty()) {
    notes.push_back("aspect ratio differs from the camera's (cropped or rotated images?): " + join(other_aspect));
  }
  if (!turned.empty()) {
    notes.push_back("turned as their EXIF orientation says, because their cameras have the sides swapped: " +
                    join(turned));
  }
  if (scene.points.size() == 0) notes.push_back("the scene has no points; training finds some in the photographs");
  return notes;
}

}  // namespace

std::vector<std::string> summarize(const Scene& scene, const SceneOrigin& origin) {
  Texts lines;
  const auto add = [&](std::string label, const std::string& text) {
    label.resize(12, ' ');
    lines.push_back(label + text);
  };
  const auto count_views = [](std::size_t n) { return concat(n, n == 1 ? " view" : " views"); };
  const std::string& points = origin.model.points_description;
  const std::string& split = origin.model.split;
  const std::string rule = split.empty() ? concat("every ", kTestEvery, "th by name") : "the views of " + split;
  add("scene", scene.source_path);
  add("model", origin.model.description);
  if (scene.georeference) add("place", scene.georeference->describe_origin());
  add("images", describe_images(origin));
  add("cameras", describe_cameras(origin.model.model));
  add("distortion", describe_distortion(origin));
  add("masks", describe_masks(origin));
  add("size", describe_sizes(origin));
  add("memory", describe_memory(scene, origin));
  add("points", std::to_string(scene.points.size()) + (points.empty() ? "" : ": " + points));
  add("extent", print_to_string("%.4g", scene.extent * scene.frame.unit));
  add("training", count_views(scene.train.size()));
  add("held out",
      origin.options.eval ? count_views(scene.test.size()) + ", " + rule : "none; --eval holds out " + rule);
  for (const std::string& note : notes_on(scene, origin)) add("note", note);
  return lines;
}

}  // namespace b3dgs
