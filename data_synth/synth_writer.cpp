#include "data_synth/synth_writer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "core/files/atomic_file.h"
#include "core/options/config_file.h"
#include "core/random.h"
#include "model/formats/splat_formats.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image_io.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr const char* kOptionsFile = "synth.json";  // written first: it marks the folder as a synthetic scene

std::string image_name(std::size_t index, const SynthConfig& config) {
  char name[32];
  std::snprintf(name, sizeof name, "%05zu.", index);
  return name + config.image_format;
}

/// Whether `name` is that of an image of the scene.
bool is_image_of(const SynthConfig& config, const std::string& name) {
  const std::size_t index = std::strtoull(name.c_str(), nullptr, 10);
  return index < static_cast<std::size_t>(config.views) && name == image_name(index, config);
}

ColmapFormat model_format(const SynthConfig& config) {
  return config.format == "text" ? ColmapFormat::kText : ColmapFormat::kBinary;
}

/// The options of the scene in `folder`. @throws InputError if they cannot be read
SynthConfig options_of_scene(const fs::path& folder) {
  const std::string file = (folder / kOptionsFile).string();
  SynthConfig config;
  try {
    apply_config_file(config, file);
    check_ranges(config, file);
  } catch (const InputError& error) {
    input_error(error.what(),
                "; it says which files belong to the scene that would be replaced; choose another folder");
  }
  return with_scene_defaults(config);
}

constexpr const char* kModelFiles[] = {"cameras", "images", "points3D"};

std::string model_extension(const SynthConfig& config) {
  return model_format(config) == ColmapFormat::kText ? ".txt" : ".bin";
}

/// @throws InputError if the scene `next` would replace a file that is not of the scene `earlier`
void check_replaces_only(const SynthConfig& earlier, const SynthConfig& next, const fs::path& folder) {
  const auto refuse = [](const fs::path& file) {
    input_error(file.string(),
                ": would be replaced, but is not of the synthetic scene there; move it away, or choose "
                "another folder");
  };
  std::error_code error;
  for (std::size_t i = 0; i < static_cast<std::size_t>(next.views); ++i) {
    const std::string name = image_name(i, next);
    const fs::path file = folder / "images" / name;
    if (!is_image_of(earlier, name) && fs::exists(file, error)) refuse(file);
  }
  if (model_format(earlier) == model_format(next)) return;
  for (const char* const name : kModelFiles) {
    const fs::path file = folder / "sparse" / "0" / (name + model_extension(next));
    if (fs::exists(file, error)) refuse(file);
  }
}

/// A file that cannot be removed, and why.
struct Obstacle {
  fs::path path;
  std::error_code error;
};

/// Removes the files of the scene that `config` describes but for kOptionsFile, and folders that are empty then. Files
/// that others put there stay. Goes on after a failure, and returns the first one.
std::optional<Obstacle> remove_scene(const fs::path& folder, const SynthConfig& config) {
  const fs::path images = folder / "images", sparse = folder / "sparse", model = sparse / "0";
  std::optional<Obstacle> obstacle;
  std::error_code error;
  const auto note = [&](const fs::path& path) {
    if (error && !obstacle) obstacle = Obstacle{path, error};
  };
  const auto remove = [&](const fs::path& path) {
    fs::remove(path, error);
    note(path);
  };
  for (const fs::path& link : {images, sparse, model}) {
    if (fs::is_symlink(fs::symlink_status(link, error))) remove(link);  // what it leads to is not ours
  }
  remove_unfinished_files(folder);
  std::vector<fs::path> files{folder / "truth.ply"};
  if (fs::is_directory(images, error)) {
    fs::directory_iterator entry(images, error);
    for (; !error && entry != fs::directory_iterator(); entry.increment(error)) {
      if (is_image_of(config, entry->path().filename().string())) files.push_back(entry->path());
    }
    note(images);
  }
  for (const char* const name : kModelFiles) files.push_back(model / (name + model_extension(config)));
  for (const fs::path& file : files) remove(file);
  for (const fs::path& own : {images, model, sparse}) {
    if (fs::is_directory(own, error)) fs::remove(own, error);  // not if it holds other files
  }
  return obstacle;
}

/// After a failure: removes what was written of a scene. kOptionsFile stays beside files of others, so that the folder
/// still counts as a synthetic scene.
void remove_unfinished(const fs::path& folder, const SynthConfig& config) {
  remove_scene(folder, config);
  std::error_code error;  // ignored: another error is being reported
  int n_left = 0;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) ++n_left;
  if (n_left == 1) fs::remove(folder / kOptionsFile, error);
}

ColmapModel colmap_model(const SynthConfig& config, const SynthScene& scene) {
  ColmapModel model;
  const Camera& shared = scene.cameras.front();  // all views share the intrinsics
  ColmapCamera camera;
  camera.id = 1;
  camera.model = CameraModel::kPinhole;
  camera.width = static_cast<std::uint64_t>(shared.width);
  camera.height = static_cast<std::uint64_t>(shared.height);
  camera.params = {shared.fx, shared.fy, shared.cx, shared.cy};
  model.cameras[camera.id] = camera;

  for (std::size_t i = 0; i < scene.cameras.size(); ++i) {
    ColmapImage image;
    image.id = static_cast<std::uint32_t>(i + 1);
    image.quat = quaternion_from_rotation(scene.cameras[i].cam_from_world.rotation);
    image.translation = scene.cameras[i].cam_from_world.translation;
    image.camera_id = camera.id;
    image.name = image_name(i, config);
    model.images.push_back(image);
  }
  for (std::size_t i = 0; i < static_cast<std::size_t>(scene.points.size()); ++i) {
    ColmapPoint point;
    point.id = i + 1;
    for (std::size_t c = 0; c < 3; ++c) {
      point.position[c] = scene.points.positions[3 * i + c];
      point.color[c] = scene.points.colors[3 * i + c];
    }
    model.points.push_back(point);
  }
  return model;
}

/// As another camera setting would show the image: each channel multiplied by exp(X (u + t / 2)), where u (one for the
/// image) and t (one for each channel) are uniform in [-1, 1]; clipped at white.
void jitter_exposure(const SynthConfig& config, std::size_t index, Image8& image) {
  const RandomKey key{config.seed, RandomStream::kExposureJitter, 0};
  const std::array<float, 4> random = random_uniform(key, index);
  for (std::size_t c = 0; c < 3; ++c) {
    const double gain = std::exp(config.exposure_jitter * ((2.0 * random[3] - 1) + (random[c] - 0.5)));
    for (std::size_t i = c; i < image.pixels.size(); i += 3) {
      image.pixels[i] = static_cast<std::uint8_t>(std::min(255.0, std::floor(gain * image.pixels[i] + 0.5)));
    }
  }
}

void write_files(const fs::path& folder, const SynthConfig& config, const SynthScene& scene,
                 const std::function<void(std::size_t, std::size_t)>& on_image) {
  write_file(folder / kOptionsFile, config_to_json(config).dump(2) + "\n");
  write_splats(folder / "truth.ply", scene.truth);
  for (std::size_t i = 0; i < scene.cameras.size(); ++i) {
    Image8 image = render_truth(scene.truth, scene.cameras[i]);
    if (config.exposure_jitter > 0) jitter_exposure(config, i, image);
    write_image(folder / "images" / image_name(i, config), image);
    if (on_image) on_image(i + 1, scene.cameras.size());
  }
  write_colmap_model(folder / "sparse" / "0", colmap_model(config, scene), model_format(config));
}

}  // namespace

bool holds_synth_scene(const fs::path& folder) {
  std::error_code error;
  const bool exists = fs::exists(folder, error);
  if (exists && !fs::is_directory(folder, error))
    input_error("not a directory: ", folder.string(), " (expected an output folder)");
  if (!exists || fs::is_empty(folder, error)) return false;
  if (!fs::exists(folder / kOptionsFile, error)) {
    input_error("folder is not empty: ", folder.string(), " (not a synthetic scene: no ", kOptionsFile,
                "); choose a new or empty folder");
  }
  return true;
}

void write_synth_scene(const SynthConfig& config, const SynthScene& scene,
                       const std::function<void(std::size_t, std::size_t)>& on_image) {
  const fs::path folder = config.output;
  std::error_code error;
  const bool is_new = !fs::exists(folder, error);
  if (holds_synth_scene(folder)) {
    const SynthConfig earlier = options_of_scene(folder);
    check_replaces_only(earlier, with_scene_defaults(config), folder);
    if (const auto obstacle = remove_scene(folder, earlier)) {
      io_error("cannot remove ", obstacle->path.string(), " (", obstacle->error.message(),
               "), which is part of the scene that would be replaced; remove it, or choose another folder");
    }
  }
  try {
    write_files(folder, config, scene, on_image);
  } catch (...) {
    remove_unfinished(folder, with_scene_defaults(config));
    if (is_new) fs::remove(folder, error);
    throw;
  }
}

}  // namespace b3dgs
