// b3dgs render: renders colour, depth, normal and alpha images or a video of a model, from its views, from cameras of a
// file, or along a path.
#include <algorithm>
#include <atomic>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>

#include "app/common/commands.h"
#include "app/common/torch/model.h"
#include "app/render/camera_choice.h"
#include "app/render/depth_images.h"
#include "app/render/video_writer.h"
#include "config/original_options.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "core/options/command_line.h"
#include "core/task_queue.h"
#include "core/text.h"
#include "scene/images/image.h"
#include "train/device.h"
#include "train/evaluate.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct RenderOptions {
  std::string ply;
  std::string output;
  bool depth = true;
  std::string depth_format = "color";
  DepthKind depth_kind = DepthKind::kMean;
  bool normals = false;
  bool alpha = true;
  std::string video;
  std::string video_of = "color";
  double fps = 30;
  int crf = -1;
  bool overwrite = false;

  bool writes_images() const { return video.empty() || !output.empty(); }
  bool needs_depth() const { return (writes_images() && depth) || colors_depth(); }
  bool needs_surface() const {
    return (writes_images() && normals) || (needs_depth() && depth_kind != DepthKind::kMean);
  }
  bool colors_depth() const {
    return (writes_images() && depth && depth_format == "color") || (!video.empty() && video_of == "depth");
  }
};

template <class Visitor>
void visit_fields(RenderOptions& c, Visitor&& field) {
  field(Option{"ply"}, c.ply, Any{}, "render this file of Gaussians instead of a model folder");
  field(Option{"output"}.common(), c.output, Any{},
        "output folder (default MODEL/PATH/ours_N, or FILE_PATH next to the file)");
  field(Option{"depth"}, c.depth, Any{},
        "write depth/: inverse depth in turbo colours, red is near, one range for all");
  field(Option{"depth_format"}.common(), c.depth_format, OneOf{{"color", "png16", "exr"}},
        "depth/ in a colour map, as 16-bit inverse depth, or as OpenEXR in world units");
  field(Option{"depth_kind"}, c.depth_kind, one_of<DepthKind>(),
        "depth of a pixel: of the surface, of the median Gaussian, or the mean of Gaussians");
  field(Option{"normals"}, c.normals, Any{},
        "write normals/: of the surface; red is right, green is up, blue is to the camera");
  field(Option{"alpha"}, c.alpha, Any{}, "write alpha/: accumulated opacity as grey");
  field(Option{"video"}.common().group("Video (needs ffmpeg)"), c.video, Any{},
        "write this .mp4, .webm or .gif instead of images; with --output, both");
  field(Option{"video_of"}, c.video_of, OneOf{{"color", "depth", "alpha"}}, "what the video shows");
  field(Option{"fps"}.common(), c.fps, InRange{0.01, 1000},
        "frames per second; a camera path may have its own default");
  field(Option{"crf"}, c.crf, InRange{-1, 63}, "quality, lower is better (-1 = 18 for .mp4, 30 for .webm)");
  field(Option{"overwrite"}.common(), c.overwrite, Any{}, "replace an existing video; images are always replaced");
}

/// @throws InputError if options contradict each other or are impossible, before anything is loaded
void check_options(const CommandLine& line, const ModelOptions& model, const RenderOptions& options) {
  if (!options.ply.empty() && !model.model_path.empty()) {
    input_error("-m and --ply both name a model; use one of them");
  }
  if (options.normals && !options.writes_images()) {
    input_error("--normals is for images; to write them beside the --video, name a folder with --output");
  }
  for (const char* name : {"video_of", "fps", "crf"}) {
    if (line.was_given(name) && options.video.empty()) input_error("--", name, " is for --video");
  }
  if (!options.video.empty()) check_video_file(options.video, options.overwrite);  // also looks for ffmpeg
}

/// Returns the size of the frames of a path, unless the options or the camera file give one.
ImageSize path_size(const CommandLine& line, const RenderOptions& options) {
  const std::string extension = lower_case(fs::path(options.video).extension().string());
  const bool is_full_hd = extension == ".mp4" || extension == ".webm";  // a .gif would be too large
  return is_full_hd && !line.was_given("resolution") && !line.was_given("cameras") ? ImageSize{1920, 1080}
                                                                                   : ImageSize{};
}

/// `variant` is that of results_variant().
fs::path frames_folder(const LoadedModel& model, const RenderOptions& options, const std::string& set,
                       const std::string& variant) {
  if (!options.output.empty()) return options.output;
  if (!model.is_file()) return image_folder(model, set) += variant.empty() ? "" : "_" + variant;
  return model.file.parent_path() / (model.file.stem().string() + "_" + set);
}

/// Returns the size of all frames. @throws InputError if they differ
ImageSize frame_size(const std::vector<Camera>& cameras) {
  const ImageSize size{cameras.at(0).width, cameras.at(0).height};
  for (const Camera& camera : cameras) {
    if (ImageSize{camera.width, camera.height} == size) continue;
    input_error("--video needs images of one size, found ", size.width, " x ", size.height, " and ", camera.width,
                " x ", camera.height, "; name a size with --width and --height");
  }
  return size;
}

/// The images of a view to write. They are in host memory, because the next view overwrites its tensors.
struct RenderedFrame {
  std::size_t index;
  Image8 color, alpha, normals;         // empty if not written
  torch::Tensor depth, depth_of_alpha;  // [H, W] and the alpha that belongs to it; undefined as above
};

/// Writes the requested images, view by view, on its own threads while the next view is rendered.
class Output {
 public:
  Output(const RenderOptions& options, const CameraChoice& choice, const LoadedModel& model, const std::string& variant)
      : options_(options),
        folder_(frames_folder(model, options, choice.set, variant)),
        unit_(model.splats.frame.unit),
        tasks_(options.video.empty() ? writer_threads() : 1, kFramesAhead) {  // frames of a video keep their order
    const bool is_in_model = options.output.empty() && !model.is_file();
    if (options.writes_images()) {
      own_files_.emplace(is_in_model ? model.folder.root() : folder_);
      for (const char* part : {"renders", "depth", "normals", "alpha", "depth.json", "views.json"}) {
        own_files_->remove(folder_ / part);  // of an earlier run, which may have written more
      }
    }
    if (options.colors_depth() || options.depth_format == "png16") {
      range_ = visible_depth_range(model.splats, choice.cameras, model.near_plane);
    }
    if (!options.video.empty()) {
      video_.emplace(options.video, frame_size(choice.cameras), options.video_of == "alpha" ? 1 : 3, options.fps,
                     options.crf);
    }
    if (options.writes_images() && options.depth && options.depth_format == "png16") {
      // Half the near end of the range, so that only objects much nearer than the scene, such as floaters, are out of
      // range.
      inverse_depth_scale_ = 65535 * unit_ * std::max(0.5 * range_.near, model.near_plane);
    }
  }

  /// `surface` is undefined unless needs_surface(). Returns before the view is written. @throws errors from writing it,
  /// or a view before it
  void write(std::size_t index, const RenderedView& rendered, const SurfaceView& surface) {
    const bool needs_color = options_.writes_images() || options_.video_of == "color";
    const bool needs_alpha = (options_.writes_images() && options_.alpha) || options_.video_of == "alpha";
    const auto frame = std::make_shared<RenderedFrame>();
    frame->index = index;
    if (needs_color) frame->color = to_image8(rendered.color);
    if (needs_alpha) frame->alpha = to_image8(rendered.alpha);
    if (options_.writes_images() && options_.normals) frame->normals = color_normals(surface.normal);
    if (options_.needs_depth() && options_.depth_kind == DepthKind::kMean) {
      frame->depth = host_copy(rendered.depth);
      frame->depth_of_alpha = host_copy(rendered.alpha);
    } else if (options_.needs_depth()) {
      frame->depth = host_copy(surface.depth);
      frame->depth_of_alpha = (frame->depth > 0).to(torch::kFloat32);  // a surface is opaque
    }
    tasks_.push([this, frame] { write(*frame); });
  }

  /// Waits until all views are written. @throws as write()
  void wait() { tasks_.finish(); }

  /// Finishes the files that concern all views, and prints all output paths.
  void finish(const CameraChoice& choice, const std::string& rendered) {
    const std::size_t n = choice.cameras.size();
    if (video_) {
      video_->finish();
      std::cout << n << (n == 1 ? " frame" : " frames") << rendered << ": " << options_.video
                << print_to_string(" (%.4g s, ", static_cast<double>(n) / options_.fps)
                << format_bytes(static_cast<std::int64_t>(fs::file_size(options_.video))) << ")\n";
    }
    if (options_.writes_images()) {
      if (!choice.views.empty()) write_view_names(folder_, choice.views);
      if (inverse_depth_scale_ > 0) write_depth_scale(folder_, inverse_depth_scale_);
      std::cout << n << (n == 1 ? " image" : " images") << rendered << ": " << folder_.string() << "/renders"
                << (options_.depth ? ", depth" : "") << (options_.alpha ? ", alpha" : "") << "\n";
    }
    for (const std::string& note : choice.notes) std::cout << note << "\n";
    if (options_.colors_depth()) {
      std::cout << "depth colours: red " << unit_ * range_.near << " to blue " << unit_ * range_.far
                << " world units, linear in 1/depth\n";
    }
    if (inverse_depth_scale_ > 0) {
      std::cout << "depth in world units: " << inverse_depth_scale_ << " / value (depth.json)\n";
      if (n_too_near_ > 0) {
        std::cout << format_count(n_too_near_) << " pixels nearer than " << inverse_depth_scale_ / 65535
                  << " world units have the value of that depth; --depth_format exr has no such limit\n";
      }
    }
  }

 private:
  void write(const RenderedFrame& frame) {
    const Image8 depth = options_.colors_depth() ? color_depth(frame.depth, frame.depth_of_alpha, range_) : Image8();
    if (video_) {
      video_->write(options_.video_of == "color" ? frame.color : options_.video_of == "depth" ? depth : frame.alpha);
    }
    if (!options_.writes_images()) return;
    write_image(folder_ / "renders" / image_name(frame.index), frame.color);
    if (options_.alpha) write_image(folder_ / "alpha" / image_name(frame.index), frame.alpha);
    if (options_.normals) write_image(folder_ / "normals" / image_name(frame.index), frame.normals);
    if (!options_.depth) return;
    const fs::path file = folder_ / "depth" / image_name(frame.index);
    options_.depth_format == "color" ? write_image(file, depth) : write_depth_numbers(file, frame);
  }

  void write_depth_numbers(fs::path file, const RenderedFrame& frame) {
    const ImageSize size{static_cast<int>(frame.depth.size(1)), static_cast<int>(frame.depth.size(0))};
    std::vector<float> depths = mean_depths(frame.depth, frame.depth_of_alpha);
    for (float& depth : depths) depth = static_cast<float>(unit_ * depth);
    if (options_.depth_format == "exr") {
      write_exr(file.replace_extension(".exr"), size, depths.data());
      return;
    }
    const InverseDepth16 inverse = inverse_depth_16(depths, size, inverse_depth_scale_);
    n_too_near_ += inverse.n_too_near;
    write_depth_map(file, inverse.map);
  }

  const RenderOptions& options_;
  fs::path folder_;
  double unit_;  // world units per unit of depth
  DepthRange range_;
  double inverse_depth_scale_ = 0;           // 0: no such maps
  std::atomic<std::int64_t> n_too_near_{0};  // pixels
  std::optional<OwnFiles> own_files_;        // of the folder of images
  std::optional<VideoWriter> video_;
  TaskQueue tasks_;  // the last member, as its tasks use the others
};

}  // namespace

int run_render(const std::vector<std::string>& words) {
  CommandLine line("render",
                   "Render images or a video of a model folder or of a file of Gaussians: from the views of the scene, "
                   "from cameras of a file, or along a path. Photographs are not needed.",
                   "b3dgs render output/garden --path turntable --video garden.mp4");
  ModelOptions model_options;
  CameraOptions camera_options;
  RenderOptions options;
  line.add(model_options, "Model", {"model_path"});
  line.add(camera_options, "Cameras");
  line.add(options, "Images");
  add_original_options(line, OriginalScript::kModel);
  if (!line.parse(words)) return 0;

  StatusLine status = StatusLine::for_stderr(model_options.quiet);
  for (const std::string& text : describe_original_options(line.given(), OriginalScript::kModel)) status.warn(text);
  const torch::Device device = choose_device(model_options.device);
  check_options(line, model_options, options);
  check_camera_options(line, camera_options);
  if (!options.ply.empty()) model_options.model_path = options.ply;
  camera_options.path_size = path_size(line, options);
  LoadedModel model = load_model(model_options, needs_views(camera_options));
  // A file does not name the views it was trained on, so --path train has all.
  if (model.is_file() && camera_options.path == "test" && line.was_given("path")) model.config.eval = true;
  if (!model.is_file() || !model_options.source_path.empty()) add_cameras(model, model_options, status);
  if (camera_options.up == "auto" && model.scene.georeference) camera_options.up = "z";
  const CameraChoice choice = choose_cameras(line, camera_options, model.scene, model.splats);
  if (choice.fps > 0 && !line.was_given("fps")) options.fps = choice.fps;

  Output output(options, choice, model, model.is_file() ? "" : results_variant(model, model_options));
  ModelRenderer renderer(model, device);
  const ProgressFn progress = show_loading(status);
  const double start_s = steady_seconds();
  for (std::size_t i = 0; i < choice.cameras.size(); ++i) {
    const RenderedView rendered = renderer.render(to_camera_view(choice.cameras[i]));
    SurfaceView surface;
    if (options.needs_surface()) surface = renderer.rasterizer.geometry(renderer.gaussians, options.depth_kind);
    output.write(i, rendered, surface);
    progress("rendering", i + 1, choice.cameras.size());
  }
  output.wait();
  status.clear();
  output.finish(choice, " of " + format_count(model.splats.size()) + " Gaussians in " +
                            format_duration(steady_seconds() - start_s));
  return 0;
}

}  // namespace b3dgs
