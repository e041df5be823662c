// b3dgs render: colour, depth and alpha images of a model, from its views or along a path through them.
#include <algorithm>
#include <cstdio>
#include <iostream>
#include <utility>

#include "app/model.h"
#include "app/render/camera_path.h"
#include "app/render/depth_colors.h"
#include "app/tools/commands.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "scene/images/image_io.h"
#include "train/device.h"
#include "train/evaluate.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct RenderOptions {
  std::string path = "test";
  int frames = 120;
  std::string ply;
  std::string output;
  bool depth = true;
  bool alpha = true;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, RenderOptions>> visit_fields(Config& c, Visitor&& field) {
  field(Option{"path"}, c.path, OneOf{{"test", "train", "interpolated"}},
        "cameras: test views, training views, or a path through the training views");
  field(Option{"frames"}, c.frames, AtLeast{1}, "number of images on the interpolated path");
  field(Option{"ply"}, c.ply, Any{}, "render this PLY from the views of a scene (-s) instead of a model folder");
  field(Option{"output"}, c.output, Any{}, "output folder (default MODEL/PATH/ours_N, or PLY_PATH next to the PLY)");
  field(Option{"depth"}, c.depth, Any{},
        "write depth/: inverse depth in turbo colours, red is near, one range for all");
  field(Option{"alpha"}, c.alpha, Any{}, "write alpha/: accumulated opacity as grey");
}

/// Interprets a file in place of the model folder as a PLY. A PLY in a model folder selects that model's iteration.
void take_file(ModelOptions& model, RenderOptions& options) {
  if (fs::is_regular_file(model.model_path)) options.ply = std::exchange(model.model_path, "");
  if (options.ply.empty() || !model.source_path.empty()) return;
  const fs::path root = fs::absolute(options.ply).parent_path().parent_path().parent_path();
  const ModelFolder folder(root);
  if (!folder.has_config()) return;
  for (const int iteration : folder.ply_iterations()) {
    std::error_code error;
    if (!fs::equivalent(folder.ply(iteration), options.ply, error)) continue;
    model.model_path = root.string();
    model.iteration = iteration;
    options.ply.clear();
    return;
  }
}

const std::vector<View>& views_of(const Scene& scene, const RenderOptions& options) {
  return options.path == "test" ? scene.test : scene.train;
}

std::vector<Camera> choose_cameras(const Scene& scene, const RenderOptions& options) {
  const std::vector<View>& views = views_of(scene, options);
  if (views.empty()) {
    input_error("no views for --path ", options.path,
                " (the model was trained without --eval); use --path train or interpolated");
  }
  std::vector<Camera> cameras;
  for (const View& view : views) cameras.push_back(view.camera);
  return options.path == "interpolated" ? interpolate_cameras(cameras, options.frames) : cameras;
}

fs::path output_folder(const LoadedModel& model, const RenderOptions& options) {
  if (!options.output.empty()) return options.output;
  if (options.ply.empty()) return image_folder(model, options.path);
  const fs::path ply = options.ply;
  return ply.parent_path() / (ply.stem().string() + "_" + options.path);
}

}  // namespace

int run_render(const std::vector<std::string>& words) {
  CommandLine line("render",
                   "Render a model folder, or a PLY of Gaussians with the cameras of a scene (FILE.ply -s SCENE). "
                   "Photographs are not needed.",
                   "b3dgs render output/garden --path interpolated");
  ModelOptions model_options;
  RenderOptions options;
  line.add(model_options, "Model", {"model_path"});
  line.add(options, "Images");
  if (!line.parse(words)) return 0;
  line.apply(model_options);
  line.apply(options);

  StatusLine status = StatusLine::for_stderr(model_options.quiet);
  const torch::Device device = choose_device(model_options.device);
  if (!options.ply.empty() && !model_options.model_path.empty()) {
    input_error("-m and --ply both name a model; use one of them");
  }
  if (line.was_given("frames") && options.path != "interpolated") {
    input_error("--frames is for --path interpolated; the other paths have one image for each view");
  }
  const bool names_ply = !options.ply.empty() || fs::is_regular_file(model_options.model_path);
  if (line.was_given("iteration") && names_ply) {
    input_error("--iteration selects a PLY of a model folder, but a PLY is named already; leave out one of them");
  }
  take_file(model_options, options);
  const LoadedModel model = options.ply.empty() ? load_model_cameras(model_options, status)
                                                : load_ply_model(options.ply, model_options, status);
  // Without test views, as for a single PLY, the default is the training views.
  if (!line.was_given("path") && model.scene.test.empty()) options.path = "train";
  const std::vector<Camera> cameras = choose_cameras(model.scene, options);
  const fs::path folder = output_folder(model, options);

  ModelRenderer renderer(model, device);
  const DepthRange range = visible_depth_range(model.splats, cameras, model.config.near_plane);
  const ProgressFn progress = show_loading(status);
  const double start_s = steady_seconds();
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const RenderedView rendered = renderer.render(to_pinhole_view(cameras[i]));
    write_image(folder / "renders" / image_name(i), to_image8(rendered.color));
    if (options.depth) {
      write_image(folder / "depth" / image_name(i), color_depth(rendered.depth, rendered.alpha, range));
    }
    if (options.alpha) write_image(folder / "alpha" / image_name(i), to_image8(rendered.alpha));
    progress("rendering", i + 1, cameras.size());
  }
  status.clear();
  if (options.path != "interpolated") write_view_names(folder, views_of(model.scene, options));
  std::cout << cameras.size() << (cameras.size() == 1 ? " image" : " images") << " of "
            << format_count(model.splats.size()) << " Gaussians in " << format_duration(steady_seconds() - start_s)
            << ": " << folder.string() << "/renders" << (options.depth ? ", depth" : "")
            << (options.alpha ? ", alpha" : "") << "\n";
  if (options.depth) {
    std::cout << "depth colours: red " << range.near << " to blue " << range.far << " world units, linear in 1/depth\n";
  }
  return 0;
}

}  // namespace b3dgs
