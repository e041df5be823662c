#include "data_synth/synth_writer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

#include "core/config.h"
#include "core/files/atomic_file.h"
#include "core/files/own_files.h"
#include "core/json_text.h"
#include "core/random.h"
#include "core/text.h"
#include "data_synth/truth_mesh.h"
#include "model/formats/splat_formats.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr const char* kTruthMesh = "truth_mesh.ply";
constexpr const char* kOptionsFile = "synth.json";  // written first, because it marks the folder as a synthetic scene

std::string image_name(std::size_t index, const SynthConfig& config) {
  return print_to_string("%05zu.", index) + config.image_format;
}

/// Removes the files of a scene that the program wrote, except kOptionsFile.
void remove_scene(OwnFiles& own, const fs::path& folder) {
  remove_unfinished_files(folder);
  for (const char* const part : {"images", "sparse", "truth.ply", kTruthMesh}) own.remove(folder / part);
}

/// Cleans up after a failure. kOptionsFile stays beside other files, so the folder still counts as a synthetic scene.
void remove_unfinished(OwnFiles& own, const fs::path& folder) {
  remove_scene(own, folder);
  std::error_code error;  // ignored: another error is being reported
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
    const fs::path name = entry->path().filename();
    if (name != kOptionsFile && name != OwnFiles::kRecord) return;
  }
  fs::remove(folder / kOptionsFile, error);
  fs::remove(folder / OwnFiles::kRecord, error);
}

ColmapModel colmap_model(const SynthConfig& config, const SynthScene& scene) {
  ColmapModel model;
  const Camera& shared = scene.cameras.front();  // all views share the intrinsics
  ColmapCamera camera = to_colmap_camera(shared);
  camera.id = 1;
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

/// Renders the image as if with another camera setting. Each channel is multiplied by exp(X (u + t / 2)), where u (one
/// per image) and t (one per channel) are uniform in [-1, 1], and clipped at white.
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
  write_file(folder / kOptionsFile, dump_json(config_to_json(config), 2) + "\n");
  write_splats(folder / "truth.ply", scene.truth);
  if (config.scene == "orbit") write_mesh_ply(folder / kTruthMesh, orbit_truth_mesh());
  for (std::size_t i = 0; i < scene.cameras.size(); ++i) {
    Image8 image = render_truth(scene.truth, scene.cameras[i]);
    if (config.exposure_jitter > 0) jitter_exposure(config, i, image);
    write_image(folder / "images" / image_name(i, config), image);
    if (on_image) on_image(i + 1, scene.cameras.size());
  }
  write_colmap_model(folder / "sparse" / "0", colmap_model(config, scene),
                     config.format == "text" ? ColmapFormat::kText : ColmapFormat::kBinary);
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
  OwnFiles own(folder);
  if (holds_synth_scene(folder)) remove_scene(own, folder);
  try {
    write_files(folder, config, scene, on_image);
  } catch (...) {
    remove_unfinished(own, folder);
    if (is_new) fs::remove(folder, error);
    throw;
  }
}

}  // namespace b3dgs
