// b3dgs mesh: a triangle mesh of the surface that a model shows.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/common/commands.h"
#include "app/common/output_file.h"
#include "app/common/torch/model.h"
#include "app/mesh/depth_views.h"
#include "app/mesh/mesh_cleaning.h"
#include "app/mesh/mesh_distance.h"
#include "app/mesh/mesh_files.h"
#include "app/mesh/mesh_options.h"
#include "app/mesh/tsdf_volume.h"
#include "app/mesh/vertex_colors.h"
#include "core/check.h"
#include "core/host_memory.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "model/model_folder.h"
#include "model/raster_input.h"
#include "scene/crop_region.h"
#include "scene/view_image.h"
#include "train/device.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

template <class... Args>
void print_result(const char* name, const char* format, Args... args) {
  std::printf("%-12s%s\n", name, print_to_string(format, args...).c_str());
  std::fflush(stdout);  // the next step may take long
}

/// @throws InputError before anything is loaded
void check_mesh_options(const ModelOptions& model, const MeshOptions& options) {
  if (model.model_path.empty() || options.output.empty()) {
    input_error("missing argument: ", model.model_path.empty() ? "MODEL_PATH" : "OUTPUT",
                "; usage: b3dgs mesh MODEL OUTPUT.glb");
  }
  require_mesh_format(options.output);
  for (const std::string& input : {model.model_path, options.compare}) refuse_to_replace(input, options.output);
  check_output_file(options.output, options.overwrite);
  if (!options.json.empty()) {
    check_output_file(options.json, options.overwrite);
    for (const std::string& input : {model.model_path, options.compare}) refuse_to_replace(input, options.json);
    if (fs::absolute(options.json).lexically_normal() == fs::absolute(options.output).lexically_normal()) {
      input_error("--json ", options.json, " is the file of the mesh; name another one");
    }
  }
  if (!options.crop.empty()) parse_crop(options.crop);
}

double median(std::vector<float>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Returns the median over the views of the median depth of their surfaces, or 0 if there are none.
double median_depth(const std::vector<DepthView>& views) {
  std::vector<float> medians;
  for (const DepthView& view : views) {
    std::vector<float> depths;
    std::copy_if(view.depth.begin(), view.depth.end(), std::back_inserter(depths), [](float d) { return d > 0; });
    if (!depths.empty()) medians.push_back(static_cast<float>(median(depths)));
  }
  return medians.empty() ? 0 : median(medians);
}

/// Renders the surface of each view. Pixels that masks leave out have none.
std::vector<DepthView> render_depths(const LoadedModel& model, const std::vector<View>& views,
                                     const MeshOptions& options, const torch::Device& device, StatusLine& status) {
  const torch::NoGradGuard no_grad;
  ModelRenderer renderer(model, device);
  const ProgressFn progress = show_loading(status);
  std::vector<DepthView> result;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const Camera& camera = views[i].camera;
    renderer.render(to_camera_view(camera));
    const SurfaceView surface = renderer.rasterizer.geometry(renderer.gaussians, options.depth_kind);
    const torch::Tensor depths = surface.depth.to(torch::kCPU).contiguous(),
                        normals = surface.normal.to(torch::kCPU).contiguous();
    const float* const values = depths.data_ptr<float>();
    std::vector<float> depth(values, values + depths.numel());
    if (const Image8* const valid = views[i].valid.get()) {
      for (std::size_t pixel = 0; pixel < depth.size(); ++pixel) {
        if (valid->pixels[pixel] == 0) depth[pixel] = 0;
      }
    }
    result.push_back(
        make_depth_view(camera, std::move(depth), normals.data_ptr<float>(), std::numeric_limits<double>::infinity()));
    progress("depths", i + 1, views.size());
  }
  status.clear();
  return result;
}

/// `unit`: world units per unit of the distances.
nlohmann::ordered_json to_json(const SurfaceDistance& own, double unit) {
  return {{"mean", unit * own.mean},
          {"p95", unit * own.p95},
          {"within_threshold", own.share},
          {"within_half", own.share_of_half},
          {"normal_degrees", own.degrees}};
}

/// Prints how far the mesh is from the true surface, in world units.
nlohmann::ordered_json measure_distance(const TriangleMesh& mesh, const TriangleMesh& truth, const MeshOptions& options,
                                        const CoordinateFrame& frame, const std::vector<DepthView>& views,
                                        double voxel) {
  std::vector<Camera> cameras;
  for (const DepthView& view : views) cameras.push_back(view.camera);
  const double threshold = options.threshold > 0 ? options.threshold / frame.unit : 2 * voxel;
  const MeshQuality quality = compare_meshes(mesh, truth, cameras, threshold);
  const double unit = frame.unit;  // world units
  std::printf("%-12s%12s %12s %10s %10s %9s\n", "", "mean", "95 %", "within", "half", "normals");
  const auto row = [&](const char* name, const SurfaceDistance& own) {
    std::printf("%-12s%12.5g %12.5g %9.2f%% %9.2f%% %7.2f deg\n", name, unit * own.mean, unit * own.p95,
                100 * own.share, 100 * own.share_of_half, own.degrees);
  };
  row("accuracy", quality.accuracy);
  row("complete", quality.completeness);
  print_result("Chamfer", "%.5g world units; F %.4f at %.5g, %.4f at half of it", unit * quality.chamfer(),
               quality.f_score(), unit * threshold, quality.f_score_of_half());
  return {{"accuracy", to_json(quality.accuracy, unit)},  {"completeness", to_json(quality.completeness, unit)},
          {"chamfer", unit * quality.chamfer()},          {"f_score", quality.f_score()},
          {"f_score_of_half", quality.f_score_of_half()}, {"threshold", unit * threshold}};
}

/// Removes what is not part of the surface, and sets normals and colours.
void finish_mesh(TriangleMesh& mesh, const MeshOptions& options, const CoordinateFrame& frame, StatusLine& status) {
  const Components components = remove_small_components(mesh, options.min_component);
  print_result("components", "%zu kept, %zu removed", components.kept, components.removed);
  if (!options.crop.empty()) {
    const CropRegion region = parse_crop(options.crop);
    crop(mesh, [&](const std::array<double, 3>& position) {
      const std::array<float, 3> at{static_cast<float>(position[0]), static_cast<float>(position[1]),
                                    static_cast<float>(position[2])};
      return region.contains(frame.to_world(at.data()));
    });
    if (mesh.triangles.empty()) input_error("--crop ", options.crop, " contains no part of the surface");
  }
  if (options.faces > 0 && static_cast<std::int64_t>(mesh.triangles.size()) > options.faces) {
    decimate(mesh, static_cast<std::size_t>(options.faces));
    constexpr double kTooMany = 1.05;
    if (static_cast<double>(mesh.triangles.size()) > kTooMany * static_cast<double>(options.faces)) {
      status.warn(detail::concat("--faces ", options.faces, ": ", format_count(mesh.triangles.size()),
                                 " triangles are left, since fewer would connect the surface differently; ",
                                 "a larger --min_component or --voxel makes it simpler"));
    }
  }
  split_non_manifold(mesh);
  set_normals(mesh);
}

}  // namespace

int run_mesh(const std::vector<std::string>& words) {
  CommandLine line("mesh",
                   "Make a triangle mesh of the surface that a model shows. Depths of the training views are fused and "
                   "the surface is extracted, cleaned and coloured. With --compare, measure how right it is.",
                   "b3dgs mesh output/garden garden.glb");
  ModelOptions model_options;
  MeshOptions options;
  line.add(model_options, "Model", {"model_path"});
  line.add(options, "Mesh", {"output"});
  if (!line.parse(words)) return 0;
  check_mesh_options(model_options, options);

  StatusLine status = StatusLine::for_stderr(model_options.quiet);
  const torch::Device device = choose_device(model_options.device);
  LoadedModel model = load_model(model_options, /*needs_views=*/true);
  if (model.splats.size() == 0) input_error(model_options.model_path, ": holds no Gaussians");
  const std::string no_photographs = add_scene_or_cameras(model, model_options, status);
  const auto wanted = options.views > 0 ? static_cast<std::size_t>(options.views) : model.scene.train.size();
  const std::vector<View> views = evenly_spaced(model.scene.train, wanted);
  if (views.size() < 2) {
    input_error(model_options.model_path, ": expected at least 2 training views for a surface, found ", views.size());
  }
  const CoordinateFrame& frame = model.splats.frame;
  refuse_to_replace(model.is_file() ? model.file : model.folder.ply(model.iteration), options.output);
  std::optional<TriangleMesh> truth;
  if (!options.compare.empty()) truth = read_mesh_ply(options.compare, frame);
  std::vector<DepthView> depths = render_depths(model, views, options, device, status);
  const double far = options.far > 0 ? options.far / frame.unit : 3 * median_depth(depths);
  for (DepthView& view : depths) {
    std::replace_if(
        view.depth.begin(), view.depth.end(), [&](float depth) { return depth > far; }, 0.0f);
  }
  const double agreed = keep_consistent(depths, options.consistent);
  const double pixel = median_pixel_size(depths);
  if (pixel == 0) {
    input_error(model_options.model_path, ": no surface on which ", options.consistent,
                " neighbouring views agree; lower --consistent, or raise --far (now ",
                print_to_string("%.4g", far * frame.unit), " world units)");
  }
  print_result("depths", "%zu views, %.1f %% of the pixels with a surface are confirmed", depths.size(), 100 * agreed);

  FusionSettings settings;
  settings.voxel = options.voxel > 0 ? options.voxel / frame.unit : 1.5 * pixel;
  settings.truncation = options.trunc;
  settings.memory =
      options.memory_gb > 0 ? static_cast<std::int64_t>(1e9 * options.memory_gb) : available_host_memory() / 2;
  TriangleMesh mesh = fuse(depths, blocks_near(depths, settings), settings);
  if (mesh.triangles.empty()) input_error(model_options.model_path, ": no surface was found; lower --voxel");
  finish_mesh(mesh, options, frame, status);
  if (options.colors && no_photographs.empty()) {
    const double shown = color_vertices(
        mesh, depths, [&](std::size_t view) { return *views[view].image->read(); }, 2 * settings.voxel);
    print_result("colours", "photographs show %.1f %% of the vertices", 100 * shown);
  } else if (options.colors) {
    status.warn("the mesh has no colours: " + no_photographs);
  }
  write_mesh(options.output, mesh, frame, scene_up(model.scene));
  const Topology topology = count_edges(mesh);
  print_result("mesh", "%s: %s triangles, %s vertices, voxel %.4g, %zu boundary and %zu non-manifold edges",
               options.output.c_str(), format_count(static_cast<std::int64_t>(mesh.triangles.size())).c_str(),
               format_count(static_cast<std::int64_t>(mesh.positions.size())).c_str(), settings.voxel * frame.unit,
               topology.boundary_edges, topology.non_manifold_edges);
  nlohmann::ordered_json json{{"triangles", mesh.triangles.size()},
                              {"vertices", mesh.positions.size()},
                              {"voxel", settings.voxel * frame.unit},
                              {"views", depths.size()},
                              {"confirmed", agreed},
                              {"boundary_edges", topology.boundary_edges},
                              {"non_manifold_edges", topology.non_manifold_edges}};
  if (truth) json["comparison"] = measure_distance(mesh, *truth, options, frame, depths, settings.voxel);
  if (!options.json.empty()) write_json_file(options.json, json);
  return 0;
}

}  // namespace b3dgs
