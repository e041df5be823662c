// Writes the seeds of fuzzing: small valid files of every kind, made by the writers of this project. write_seeds FOLDER
// fills FOLDER/TARGET/ for each target. The readers have to accept all of them.
#include <fstream>
#include <iostream>
#include <map>
#include <opencv2/imgcodecs.hpp>

#include "adaptive/kernel_selector.h"
#include "config/train_options.h"
#include "core/files/atomic_file.h"
#include "core/files/folders.h"
#include "fuzz/fuzz_target.h"
#include "model/cameras/cameras_json.h"
#include "model/formats/splat_formats.h"
#include "model/formats/triangle_mesh.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "scene/photograph.h"
#include "support/files.h"
#include "support/formats/spz_content.h"
#include "support/formats/tiff_bytes.h"
#include "support/formats/write_transforms.h"
#include "support/sample_model.h"
#include "support/train/tiny_scene.h"
#include "support/train/write_checkpoint.h"
#include "train/gaussians/gaussian_model.h"
#include "train/output/train_recorder.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Returns a camera of each supported model, each with an image.
ColmapModel model_of_all_cameras() {
  ColmapModel model;
  for (const CameraModel kind : supported_camera_models()) {
    const auto id = static_cast<std::uint32_t>(kind);
    ColmapCamera camera{id, kind, 64, 48, std::vector<double>(camera_model_param_count(kind), 0.01)};
    const bool has_two = std::string(camera_model_params(kind)).rfind("fx", 0) == 0;
    if (kind == CameraModel::kEquirectangular) {
      camera.height = 32;
      camera.params = {64, 32};
    } else {
      camera.params[0] = 50;
      if (has_two) camera.params[1] = 51;
      camera.params[has_two ? 2 : 1] = 32;
      camera.params[has_two ? 3 : 2] = 24;
    }
    model.cameras[id] = camera;
    model.images.push_back({id, {1, 0.1, 0.2, 0.3}, {0, 1, 2}, id, std::to_string(id) + ".png"});
  }
  model.points.push_back({1, {0.5, -1, 2}, {1, 2, 3}, 0.25});
  return model;
}

void write_colmap_seeds(const fs::path& folder) {
  const fs::path work = folder / "work";
  for (const ColmapFormat format : {ColmapFormat::kBinary, ColmapFormat::kText}) {
    const bool is_binary = format == ColmapFormat::kBinary;
    const std::string end = is_binary ? ".bin" : ".txt", target = is_binary ? "colmap_binary" : "colmap_text";
    int n = 0;
    for (const ColmapModel& model : {test::sample_model(), model_of_all_cameras()}) {
      write_colmap_model(work, model, format);
      std::string joined;
      for (const char* name : {"cameras", "images", "points3D"}) {
        if (!joined.empty()) joined += fuzz::kFileSeparator;
        joined += test::read_bytes(work / (name + end));
      }
      write_file(folder / target / std::to_string(n++), joined);
    }
  }
  remove_tree(work);
}

void write_transforms_seeds(const fs::path& folder) {
  ColmapModel model = test::sample_model();
  model.cameras[9] = {9, CameraModel::kOpenCvFisheye, 64, 48, {30, 31, 32, 24, 0.01, 0.02, -0.003, 0.004}};
  model.images.push_back({21, {1, 0.1, 0.2, 0.3}, {0, 1, 2}, 9, "c.png"});
  test::Json json = test::transforms_of(model);
  json["frames"][0]["mask_path"] = "masks/a.png";
  json["ply_file_path"] = "sparse_pc.ply";
  json["applied_transform"] = {{1, 0, 0, 0}, {0, 0, 1, 0}, {0, -1, 0, 0}};
  json["test_filenames"] = {"images/a.png"};
  write_file(folder / "nerfstudio", json.dump(2));
  // The matrix resembles NeRF's synthetic scenes and instant-ngp.
  const std::string matrix = R"("transform_matrix": [[1, 0, 0, 0.5], [0, 1, 0, -2], [0, 0, 1, 4], [0, 0, 0, 1]])";
  write_file(folder / "synthetic",
             R"({"camera_angle_x": 0.69, "frames": [{"file_path": "./train/r_0", "rotation": 0.01, )" + matrix +
                 R"(}, {"file_path": "./train/r_11", )" + matrix + "}]}");
  write_file(
      folder / "instant_ngp",
      R"({"camera_angle_x": 0.7, "camera_angle_y": 0.5, "fl_x": 50, "k1": 0.02, "k2": -0.01, "p1": 0.001, "p2": 0,)"
      R"( "is_fisheye": false, "cx": 32.5, "cy": 23, "w": 64.0, "h": 48.0, "aabb_scale": 4, "frames": [)"
      R"({"file_path": "./images/0001.jpg", "sharpness": 90.5, )" +
          matrix + "}]}");
}

SplatCloud small_cloud(int sh_degree) {
  PointCloud points;
  for (int i = 0; i < 5; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      points.positions.push_back(static_cast<float>((7 * i + 3 * axis) % 5) - 1.5f);
      points.colors.push_back(static_cast<std::uint8_t>(40 * i + axis));
    }
  }
  return splats_from_points(points, sh_degree);
}

void write_ply_seeds(const fs::path& folder) {
  for (const int degree : {0, 1, 3}) write_splat_ply(folder / ("splats" + std::to_string(degree)), small_cloud(degree));
  write_mesh_ply(folder / "mesh", {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 1, 2}}, {}, {}});
  write_point_ply(folder / "points", {{0, 1, 2, 3, 4, 5}, {10, 20, 30, 40, 50, 60}});
  write_splat_ply(folder / "antialiased", [] {
    SplatCloud cloud = small_cloud(0);
    cloud.antialiased = true;
    return cloud;
  }());
  const std::string header = "element vertex 1\nproperty double x\nproperty double y\nproperty double z\n";
  const std::string zeros(128, '\0');
  for (const char* colors : {"ushort", "float", "uint8"}) {
    std::string text = "ply\nformat binary_big_endian 1.0\nobj_info x\n" + header;
    for (const char* color : {"red", "green", "blue"}) text += detail::concat("property ", colors, " ", color, "\n");
    const int bytes = colors[1] == 's' ? 2 : colors[0] == 'f' ? 4 : 1;
    write_file(folder / colors, text + "end_header\n" + zeros.substr(0, static_cast<std::size_t>(24 + 3 * bytes)));
  }
  // Gaussians with colours instead of harmonics, and with the filter of Mip-Splatting.
  write_file(folder / "filter",
             "ply\nformat ascii 1.0\ncomment SplatRenderMode: other\n" + header +
                 "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float opacity\nproperty "
                 "float scale_0\nproperty float scale_1\nproperty float scale_2\nproperty float rot_0\nproperty float "
                 "rot_1\nproperty float rot_2\nproperty float rot_3\nproperty float filter_3D\nproperty float "
                 "other\nend_header\n1 2 3 10 20 30 inf -1 -2 -inf 1 0 0 0 0.01 5\n");
  // Other programs write them as text, with lists and other types.
  write_file(folder / "text",
             "ply\nformat ascii 1.0\ncomment x\nelement face 1\nproperty list uchar int vertex_indices\nelement vertex "
             "2\nproperty float x\nproperty double y\nproperty int z\nproperty uchar red\nproperty uchar "
             "green\nproperty uchar blue\nproperty list uchar short more\nend_header\n3 0 1 0\n0.5 -1e3 7 0 128 255 "
             "1 4\n1 2 3 4 5 6 0\n");
}

void write_spz_seeds(const fs::path& folder) {
  for (const int degree : {0, 3}) write_spz(folder / ("file" + std::to_string(degree)), small_cloud(degree));
  write_file(folder / "version4", test::spz4_file(test::spz_content(3, 3, 1), std::string(12, '\1')));
  // The others are not compressed, so that a fuzzer can change values. The target compresses them.
  for (const std::uint8_t version : {1, 2, 3}) {
    write_file(folder / ("content" + std::to_string(version)), test::spz_content(version, 3, version));
    write_file(folder / ("sizeless" + std::to_string(version)), test::spz_header(version, 0, 3));
  }
}

/// Returns a selector after one check, and that check.
std::pair<KernelSelector, KernelDecision> kernel_check() {
  KernelSelector selector({"segmented", "sub-tile"});
  const KernelDecision decision = selector.decide(1009, {{2, 1}, {3, 1.5}, {4, 2}});
  return {selector, decision};
}

void write_checkpoint_seeds(const fs::path& folder) {
  test::TinySceneOptions options;
  options.n_gaussians = 2;
  options.n_views = 3;
  options.width = options.height = 16;
  const Scene scene = test::make_tiny_scene(options);
  for (const int degree : {0, 1}) {
    TrainConfig config;
    config.sh_degree = degree;
    TrainState state;
    state.iteration = 40;
    state.sh_degree = degree;
    state.gaussians = to_tensors(splats_from_points(scene.points, degree), degree, torch::kCPU);
    state.adam = make_adam_state(state.gaussians);
    state.adam.steps = 40;
    state.statistics = make_density_statistics(state.gaussians.size(), torch::kCPU);
    state.view_order.n_refills = 3;
    state.view_order.remaining = {1, 0};
    state.loss_average = 0.25;
    state.elapsed_s = 1.5;
    if (degree > 0) state.kernel_selection = kernel_check().first.to_json("A device");
    write_checkpoint(folder / ("degree" + std::to_string(degree)), config, state, scene);
  }
}

void write_config_seeds(const fs::path& folder) {
  TrainConfig config;
  write_file(folder / "defaults", config_to_json(config).dump(2));
  config.source_path = "scene";
  config.checkpoint_iterations = {5, 10};
  config.gpu_memory_gb = 1.5;
  write_file(folder / "one_line", config_to_json(config).dump());
  write_file(folder / "some", R"({"iterations": 300, "kernel": "dynamic", "eval": true, "opacity_lr": 0.05})");
}

void write_camera_seeds(const fs::path& folder) {
  View view;
  view.name = "a.png";
  view.camera = test::look_at_origin(1, -2, 3, 40, 30);
  write_file(folder / "list", cameras_to_json({}, {view, view}).dump());
  write_file(folder / "path", R"({"render_width": 40, "render_height": 30, "seconds": 1, "camera_path": [
      {"camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1], "fov": 50, "aspect": 1.33}]})");
  write_file(folder / "transforms", R"({"camera_angle_x": 0.7, "w": 40, "frames": [
      {"file_path": "a", "h": 30, "cy": 14.5,
       "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]}]})");
}

/// Returns a file of each format, in variants.
std::map<std::string, std::string> image_files() {
  std::map<std::string, std::string> files;
  const auto encode = [&](const std::string& format, int depth, int channels) {
    cv::Mat image(4, 5, CV_MAKETYPE(depth, channels));
    cv::randu(image, 0, depth == CV_8U ? 256 : 65536);
    std::vector<std::uint8_t> bytes;
    B3DGS_CHECK(cv::imencode("." + format, image, bytes), format);
    files[detail::concat(format, channels, depth == CV_8U ? "" : "_deep")].assign(bytes.begin(), bytes.end());
  };
  for (const int channels : {1, 3, 4}) {
    for (const char* format : {"png", "tif"}) {
      for (const int depth : {CV_8U, CV_16U}) encode(format, depth, channels);
    }
    if (channels < 4) {
      for (const char* format : {"jpg", "bmp", channels == 1 ? "pgm" : "ppm"}) encode(format, CV_8U, channels);
    }
    if (channels > 1) encode("webp", CV_8U, channels);
  }
  files["text"] = "P3 # a comment\n2 1 255\n1 2 3 4 5 6\n";
  const std::string samples(5 * 4 * 4, '\x64'), tile(2 * 16 * 16, '\x64');
  for (const bool is_big : {false, true}) {
    test::TiffOptions options;
    options.is_big = is_big;
    const std::string name = is_big ? "bigtiff_" : "tiff_";
    files[name + "premultiplied"] = test::tiff_of(5, 4, 8, 4, {1}, samples, options);
    options.orientation = 6;
    files[name + "on_side"] = test::tiff_of(5, 4, 8, 3, {}, samples.substr(0, 60), options);
    options.tile = 16;
    files[name + "tiled"] = test::tiff_of(5, 4, 8, 2, {2}, tile, options);
    const std::vector<std::uint8_t> jpeg = test::jpeg_with_orientation(12, 8, 6, is_big);
    files[is_big ? "exif_little" : "exif_big"].assign(jpeg.begin(), jpeg.end());
  }
  return files;
}

void write_image_seeds(const fs::path& folder) {
  for (const auto& [name, bytes] : image_files()) {
    for (const char* target : {"image_header", "image_file", "exif"}) write_file(folder / target / name, bytes);
  }
  // The chunks before the metadata are enough to find them.
  const std::string tiff = test::tiff_of(5, 4, 8, 1, {}, "", {false, false, 0, 0, 6});
  const std::string length{'\0', '\0', static_cast<char>(tiff.size() >> 8), static_cast<char>(tiff.size() & 255)};
  write_file(folder / "exif" / "png_metadata", "\x89PNG\r\n\x1a\n" + length + "eXIf" + tiff + "crc.");
  write_file(folder / "exif" / "webp_metadata",
             std::string("RIFF\0\0\0\0WEBPEXIF", 16) + std::string(length.rbegin(), length.rend()) + tiff);
}

void write_log_seeds(const fs::path& folder) {
  const fs::path path = folder / "log";
  fs::create_directories(folder);
  TrainLog log(path, 0);
  for (const int iteration : {10, 20, 30}) {
    nlohmann::ordered_json line{{"iteration", iteration}, {"loss", 0.5},      {"ms", 12.25},
                                {"count", 1000},          {"elapsed_s", 1.5}, {"kernel", "segmented"}};
    if (iteration == 20) line["stages_ms"] = stage_json({});
    if (iteration == 30) line["test_psnr"] = line["test_ssim"] = line["test_sharpness"] = 0.5;
    log.write(line);
  }
  nlohmann::ordered_json check{{"iteration", 30}, {"event", "kernel_check"}};
  check.update(to_json(kernel_check().second));
  log.write(check);
  log.write({{"iteration", 30},
             {"event", "load_statistics"},
             {"tile_lists", {{"min", 0}, {"max", 7}, {"log2_bins", {1, 2, 3}}}}});
}

void write_view_seeds(const fs::path& folder) {
  const std::string matrix = R"("camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1])";
  int n = 0;
  for (const std::string& body :
       {std::string(R"({"width": 640, "height": 480, "mode": "difference", "view": 0})"),
        R"({"width": 64, "height": 48, "mode": "load", "quality": 70, "camera": {"fov": 50, )" + matrix + "}}",
        std::string(R"({"command": "pause"})"), std::string(R"({"command": "stop"})")}) {
    std::string input = n % 2 == 0 ? "127.0.0.1:8080" : "[::1]:8081";
    for (const std::string& part : {std::to_string(n % 2), body}) input.append(fuzz::kFileSeparator).append(part);
    write_file(folder / std::to_string(n++), input);
  }
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: write_seeds FOLDER\n";
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  b3dgs::remove_tree(folder);
  b3dgs::write_colmap_seeds(folder);
  b3dgs::write_transforms_seeds(folder / "transforms");
  b3dgs::write_ply_seeds(folder / "ply");
  b3dgs::write_spz_seeds(folder / "spz");
  b3dgs::write_checkpoint_seeds(folder / "checkpoint");
  b3dgs::write_config_seeds(folder / "json_config");
  b3dgs::write_camera_seeds(folder / "camera_file");
  b3dgs::write_image_seeds(folder);
  b3dgs::write_log_seeds(folder / "train_log");
  b3dgs::write_view_seeds(folder / "view_request");
}
