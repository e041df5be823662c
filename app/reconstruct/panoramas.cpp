#include "app/reconstruct/panoramas.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <map>
#include <opencv2/core/matx.hpp>
#include <set>
#include <utility>

#include "core/check.h"
#include "core/text.h"
#include "core/vec.h"
#include "scene/cameras/camera_lens.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

// Limits for the deviation of the poses of faces from that of their panorama: an angle, and as many pixels of parallax.
constexpr double kMostAngle = 3 * kDegree;

std::string face_name(const std::string& panorama, std::size_t face) {
  return panorama + "/" + std::to_string(face) + ".jpg";
}

/// The pose of a panorama derived from one face.
struct Candidate {
  std::uint32_t image = 0;  // ID of the face
  std::array<double, 4> quat{};
  std::array<double, 3> center{};
  double weight = 0;  // number of points that the face sees
};

double dot(const std::array<double, 4>& a, const std::array<double, 4>& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
}

Candidate candidate_of(const ColmapImage& image, const Camera& face) {
  Camera camera;
  camera.cam_from_world = {rotation_from_quaternion(image.quat), image.translation};
  const cv::Matx33d panorama_from_world =
      cv::Matx33d(face.cam_from_world.rotation.data()).t() * cv::Matx33d(camera.cam_from_world.rotation.data());
  std::array<double, 9> rotation{};
  std::copy(std::begin(panorama_from_world.val), std::end(panorama_from_world.val), rotation.begin());
  return {image.id, quaternion_from_rotation(rotation), camera.center(), 0};
}

/// Returns the candidates that agree with the one that most agree with, by weight.
std::vector<Candidate> agreeing(const std::vector<Candidate>& candidates, double most_distance) {
  std::vector<Candidate> best;
  double best_weight = -1;
  for (const Candidate& one : candidates) {
    std::vector<Candidate> agree;
    double weight = 0;
    for (const Candidate& other : candidates) {
      const double angle = 2 * std::acos(std::min(1.0, std::abs(dot(one.quat, other.quat))));
      if (angle > kMostAngle || distance(one.center, other.center) > most_distance) continue;
      agree.push_back(other);
      weight += other.weight;
    }
    if (weight <= best_weight) continue;
    best_weight = weight;
    best = std::move(agree);
  }
  return best;
}

/// Sets the image's pose to the mean of the candidates.
void set_mean_pose(ColmapImage& image, const std::vector<Candidate>& candidates) {
  std::array<double, 4> quat{};
  std::array<double, 3> center{};
  double sum = 0;
  for (const Candidate& one : candidates) {
    const double weight = std::max(one.weight, 1.0), sign = dot(one.quat, candidates[0].quat) < 0 ? -1 : 1;
    for (std::size_t i = 0; i < 4; ++i) quat[i] += sign * weight * one.quat[i];
    for (std::size_t i = 0; i < 3; ++i) center[i] += weight * one.center[i];
    sum += weight;
  }
  const std::array<double, 9> rotation = rotation_from_quaternion(quat);
  image.quat = quaternion_from_rotation(rotation);
  for (std::size_t row = 0; row < 3; ++row) {
    image.translation[row] = 0;
    for (std::size_t k = 0; k < 3; ++k) image.translation[row] -= rotation[3 * row + k] * center[k] / sum;
  }
}

/// Returns points that two or more panoramas see, with these as tracks. `panorama_of` has the panorama of each valid
/// face.
std::vector<ColmapPoint> points_of_two(const std::vector<ColmapPoint>& points,
                                       const std::map<std::uint32_t, std::uint32_t>& panorama_of) {
  std::vector<ColmapPoint> result;
  for (const ColmapPoint& point : points) {
    std::vector<std::uint32_t> seen_from;
    for (const std::uint32_t id : point.image_ids) {
      if (const auto panorama = panorama_of.find(id); panorama != panorama_of.end()) {
        seen_from.push_back(panorama->second);
      }
    }
    std::sort(seen_from.begin(), seen_from.end());
    seen_from.erase(std::unique(seen_from.begin(), seen_from.end()), seen_from.end());
    if (seen_from.size() < 2) continue;
    result.push_back(point);
    result.back().image_ids = std::move(seen_from);
  }
  return result;
}

}  // namespace

bool has_panorama_size(ImageSize size) {
  return size.width == 2 * size.height;
}

std::vector<Camera> panorama_faces(const std::vector<ImageSize>& panoramas) {
  ImageSize largest;
  for (const ImageSize& size : panoramas) {
    if (size.width > largest.width) largest = size;
  }
  std::vector<Camera> faces = pinhole_faces(panorama_camera(largest));
  const auto looks_up_or_down = [](const Camera& face) { return std::abs(face.cam_from_world.rotation[7]) > 0.5; };
  faces.erase(std::remove_if(faces.begin(), faces.end(), looks_up_or_down), faces.end());
  return faces;
}

std::string pinhole_params(const Camera& face) {
  return print_to_string("%.17g,%.17g,%.17g,%.17g", face.fx, face.fy, face.cx, face.cy);
}

std::vector<std::string> cut_panoramas(const fs::path& images, const fs::path& faces,
                                       const CheckedPhotographs& panoramas,
                                       const std::function<void(std::size_t done)>& progress) {
  const std::vector<Camera> cameras = panorama_faces(panoramas.sizes);
  std::vector<std::string> names;
  for (std::size_t i = 0; i < panoramas.names.size(); ++i) {
    progress(i);
    Image8 panorama;
    for (std::size_t face = 0; face < cameras.size(); ++face) {
      names.push_back(face_name(panoramas.names[i], face));
      if (fs::exists(faces / names.back())) continue;
      if (panorama.pixels.empty()) panorama = read_image(images / panoramas.names[i], false);
      write_image(faces / names.back(), warp_image(panorama, panorama_camera(panoramas.sizes[i]), cameras[face]).image);
    }
  }
  return names;
}

ColmapModel join_faces(const ColmapModel& faces, const CheckedPhotographs& panoramas) {
  const std::vector<Camera> cameras = panorama_faces(panoramas.sizes);
  std::map<std::string, std::pair<std::size_t, std::size_t>> places;  // panorama and face by name
  for (std::size_t i = 0; i < panoramas.names.size(); ++i) {
    for (std::size_t face = 0; face < cameras.size(); ++face) places[face_name(panoramas.names[i], face)] = {i, face};
  }
  std::map<std::size_t, std::vector<Candidate>> candidates;  // by panorama
  std::map<std::uint32_t, Candidate*> by_image;
  for (const ColmapImage& image : faces.images) {
    const auto place = places.find(image.name);
    if (place == places.end()) continue;
    const auto [panorama, face] = place->second;
    candidates[panorama].push_back(candidate_of(image, cameras[face]));
  }
  for (auto& [panorama, those] : candidates) {
    for (Candidate& one : those) by_image[one.image] = &one;
  }
  std::vector<double> distances;
  for (const ColmapPoint& point : faces.points) {
    for (const std::uint32_t id : point.image_ids) {
      const auto one = by_image.find(id);
      if (one == by_image.end()) continue;
      one->second->weight += 1;
      distances.push_back(distance(one->second->center, point.position));
    }
  }
  const auto middle = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
  std::nth_element(distances.begin(), middle, distances.end());
  const double most_distance = distances.empty() ? 0 : kMostAngle * *middle;

  ColmapModel model;
  std::map<int, std::uint32_t> camera_ids;             // by width
  std::map<std::uint32_t, std::uint32_t> panorama_of;  // panorama with the pose of the face: image IDs
  for (const auto& [panorama, those] : candidates) {
    const ImageSize size = panoramas.sizes[panorama];
    const auto n_cameras = static_cast<std::uint32_t>(camera_ids.size());
    const std::uint32_t camera = camera_ids.emplace(size.width, n_cameras + 1).first->second;
    const auto width = static_cast<std::uint64_t>(size.width), height = static_cast<std::uint64_t>(size.height);
    model.cameras[camera] = {camera,
                             CameraModel::kEquirectangular,
                             width,
                             height,
                             {static_cast<double>(size.width), static_cast<double>(size.height)}};
    ColmapImage image;
    image.id = static_cast<std::uint32_t>(panorama + 1);
    image.camera_id = camera;
    image.name = panoramas.names[panorama];
    const std::vector<Candidate> used = agreeing(those, most_distance);
    set_mean_pose(image, used);
    for (const Candidate& one : used) panorama_of[one.image] = image.id;
    model.images.push_back(image);
  }
  model.points = points_of_two(faces.points, panorama_of);
  return model;
}

std::size_t join_models(const fs::path& from, const fs::path& to, const CheckedPhotographs& panoramas) {
  std::vector<ColmapModel> models;
  std::error_code error;
  std::set<fs::path> folders;  // sorted, which decides among models of one size
  for (const fs::directory_entry& entry : fs::directory_iterator(from, error)) folders.insert(entry.path());
  for (const fs::path& folder : folders) {
    if (!colmap_format(folder)) continue;
    try {
      models.push_back(join_faces(read_colmap_model(folder, Observations::kTracks), panoramas));
    } catch (const InputError&) {
      continue;  // cut off, as in order_models()
    }
  }
  std::stable_sort(models.begin(), models.end(),
                   [](const ColmapModel& a, const ColmapModel& b) { return a.images.size() > b.images.size(); });
  for (std::size_t i = 0; i < models.size(); ++i) {
    write_colmap_model(to / std::to_string(i), models[i], ColmapFormat::kBinary);
  }
  return models.size();
}

}  // namespace b3dgs
