// b3dgs export: writes a model in the formats of viewers and editors, and measures the loss.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>

#include "app/common/commands.h"
#include "app/common/output_file.h"
#include "app/common/stop_request.h"
#include "app/common/torch/model.h"
#include "app/export/page_view.h"
#include "app/export/scene_views.h"
#include "app/export/splat_transform.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "model/edit/edit.h"
#include "model/formats/las.h"
#include "model/formats/splat_formats.h"
#include "model/raster_input.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/crop_region.h"
#include "scene/images/image.h"
#include "scene/view_image.h"
#include "train/device.h"
#include "train/quality/metrics.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kScoredViews = 200;  // for --max_gaussians; more views change the order of few Gaussians

constexpr UnitQuat kNoRotation{1, 0, 0, 0};
constexpr const char* kByFormat = "by-format";

struct ExportOptions {
  std::string output;
  bool overwrite = false;
  std::string up = kByFormat;
  std::string scale;
  bool to_utm = false;
  std::string crop;
  bool remove_floaters = false;
  std::string floater_kinds = "unseen,close";  // removing the others often lowers PSNR (docs/recipes.md, Floaters)
  double min_opacity = 0;
  int max_sh_degree = 3;
  std::int64_t max_gaussians = 0;
  int sh_bits = kSpzShBits;
  int spz_version = 3;
  int compare_views = 10;
};

template <class Visitor>
void visit_fields(ExportOptions& c, Visitor&& field) {
  field(Option{"output"}, c.output, Any{}, "file to write; its extension selects the format");
  field(Option{"overwrite"}, c.overwrite, Any{}, "replace the file if it exists");
  field(Option{"up"}, c.up, OneOf{{kByFormat, "keep", "auto", "x", "y", "z", "-x", "-y", "-z"}},
        "cameras' up becomes this axis of a PLY; auto: -y; by-format: auto for .html, else keep");
  field(Option{"scale"}, c.scale, Any{},
        "multiply by a factor, or make the distance of two points true: X0,Y0,Z0,X1,Y1,Z1,DISTANCE");
  field(Option{"to_utm"}, c.to_utm, Any{},
        "write easting, northing and height of a georeferenced scene to a .ply or .las");
  field(Option{"remove_floaters"}, c.remove_floaters, Any{},
        "remove what the summary of the training counts as possible floaters, by kind");
  field(Option{"floater_kinds"}, c.floater_kinds, Any{},
        "kinds that --remove_floaters removes: all, or some of unseen,one_view,close,large");
  field(Option{"crop"}, c.crop, Any{},
        "keep centres in a box X0,Y0,Z0,X1,Y1,Z1, in a sphere X,Y,Z,RADIUS, or a file with one");
  field(Option{"min_opacity"}, c.min_opacity, InRange{0, 1}, "leave out Gaussians of lower opacity");
  field(Option{"max_sh_degree"}, c.max_sh_degree, InRange{0, 3}, "leave out SH coefficients of higher degrees");
  field(Option{"max_gaussians"}, c.max_gaussians, AtLeast{0},
        "keep the N Gaussians that contribute most to the training views (0 = all)");
  field(Option{"sh_bits"}, c.sh_bits, InRange{1, kSpzShBits},
        "SPZ: bits kept of SH coefficients; fewer compress better");
  field(Option{"spz_version"}, c.spz_version, InRange{3, 4}, "SPZ: version; 4 is read by fewer programs");
  field(Option{"compare_views"}, c.compare_views, AtLeast{0},
        "views on which PSNR before and after is measured (0 = not measured)");
}

template <class... Args>
void print_line(const char* name, const char* format, Args... args) {
  std::printf("%-12s%s\n", name, print_to_string(format, args...).c_str());
  std::fflush(stdout);  // the next step may take long
}

bool is_spz(const fs::path& output) {
  return !needs_splat_transform(output) && splat_format(output) == SplatFormat::kSpz;
}

void check_output(const ModelOptions& model, const ExportOptions& options) {
  if (options.output.empty()) input_error("missing argument: OUTPUT; usage: b3dgs export MODEL OUTPUT.spz");
  const fs::path output = options.output;
  refuse_to_replace(model.model_path, options.output);
  check_output_file(options.output, options.overwrite);
  if (output.extension().empty()) {
    input_error(options.output, ": expected an extension, such as .spz, .ply, .sog or .html, which selects the format");
  }
  if (needs_splat_transform(output)) require_splat_transform(output);
  if (options.to_utm && (needs_splat_transform(output) || is_spz(output))) {
    input_error("--to_utm is for .ply and .las, which have double precision, not ", options.output);
  }
  if (options.to_utm && ((options.up != "keep" && options.up != kByFormat) || !options.scale.empty())) {
    input_error("--to_utm keeps up and scale of the georeferenced scene; leave out --up and --scale");
  }
  if (options.sh_bits != kSpzShBits && !is_spz(output)) input_error("--sh_bits is for .spz, not ", options.output);
  if (options.spz_version != ExportOptions().spz_version && !is_spz(output)) {
    input_error("--spz_version is for .spz, not ", options.output);
  }
  check_floater_kinds(options.floater_kinds);
}

std::int64_t crop(const std::string& text, SplatCloud& splats) {
  const CropRegion region = parse_crop(text);
  return keep_if([&](std::size_t row) { return region.contains(splats.frame.to_world(&splats.means[3 * row])); },
                 splats);
}

/// Removes Gaussians and coefficients according to the options, and prints the result.
void reduce(LoadedModel& model, const ExportOptions& options, const torch::Device& device, StatusLine& status) {
  SplatCloud& splats = model.splats;
  const auto report = [&](std::int64_t removed, const std::string& what) {
    if (removed == 0) return;
    print_line("removed", "%s Gaussians %s", format_count(removed).c_str(), what.c_str());
    if (splats.size() == 0)
      input_error("no Gaussian is left: all ", format_count(removed), " ", what, " would be removed");
  };
  if (options.remove_floaters) {
    const PossibleFloaters floaters = possible_floaters(model, options.floater_kinds, device, status);
    report(keep_if([&](std::size_t row) { return !floaters.is_one[row]; }, splats),
           "that may be floaters (" + floaters.counts + ")");
  }
  if (!options.crop.empty()) report(crop(options.crop, splats), "outside of --crop " + options.crop);
  if (options.min_opacity > 0) {
    report(keep_if([&](std::size_t row) { return opacity_of(splats, row) >= options.min_opacity; }, splats),
           print_to_string("of opacity below %g", options.min_opacity));
  }
  limit_sh_degree(options.max_sh_degree, splats);
  if (options.max_gaussians > 0 && options.max_gaussians < splats.size()) {
    const std::vector<View> views = evenly_spaced(model.scene.train, kScoredViews);
    const std::vector<double> scores =
        views.empty() ? opacity_times_area(splats) : blend_weight_sums(model, views, device, status);
    report(keep_highest(scores, options.max_gaussians, splats),
           "of the least " + (views.empty() ? "opacity times area, for lack of a scene (-s SCENE)"
                                            : detail::concat("contribution to ", views.size(), " training views")));
  }
}

UnitQuat rotation_to(const std::string& axis, const LoadedModel& model) {
  if (model.scene.train.empty() && model.scene.test.empty())
    input_error("--up needs cameras to know which way is up; name a scene with -s");
  const std::optional<std::array<double, 3>> up = scene_up(model.scene);
  if (!up) input_error("--up: the cameras do not agree on which way is up; rotate the model in an editor instead");
  const std::string target = axis == "auto" ? "-y" : axis;
  std::array<double, 3> to{};
  to[static_cast<std::size_t>(target.back() - 'x')] = target.front() == '-' ? -1 : 1;
  return rotation_between(*up, to);
}

/// Returns the rotation of --up. A page that cannot be turned upright by default stays as it is, with a warning.
UnitQuat rotation_of(const ExportOptions& options, const LoadedModel& model, StatusLine& status) {
  const bool is_default = options.up == kByFormat;
  if (options.up == "keep" || (is_default && !is_page(options.output))) return kNoRotation;
  try {
    return rotation_to(is_default ? "auto" : options.up, model);
  } catch (const InputError& error) {
    if (!is_default) throw;
    status.warn(std::string("the page may open tilted; ") + error.what());
    return kNoRotation;
  }
}

/// Returns the frame of the coordinates in an SPZ. It is that of the world, unless the Gaussians as a whole are too far
/// from its origin, or spread over too little or too much space, for 24-bit positions and 8-bit scales.
CoordinateFrame spz_frame(const SplatCloud& splats, StatusLine& status) {
  constexpr double kLeastUnit = 0.01, kMostUnit = 100;
  const CoordinateFrame around = choose_frame({}, world_positions(splats));
  if (!around.is_far() && around.unit >= kLeastUnit && around.unit <= kMostUnit) return {};
  const auto& [x, y, z] = around.origin;
  status.warn(
      print_to_string("SPZ cannot hold these coordinates; those in the file are relative to (%.10g, %.10g, "
                      "%.10g), in units of %.6g; .ply keeps the scene's",
                      x, y, z, around.unit));
  return around;
}

/// `epsg` of the coordinates, or 0.
void write_output(const fs::path& output, const SplatCloud& splats, const ExportOptions& options, int epsg,
                  const PageOptions& page, StatusLine& status) {
  if (is_las(output)) return write_las(output, splats, epsg);
  if (needs_splat_transform(output)) return write_by_splat_transform(output, splats, page, status);
  if (!is_spz(output)) return write_splats(output, splats);
  constexpr int kUsualBits = 12;
  if (const int bits = spz_fractional_bits(splats); bits < kUsualBits) {
    status.warn(detail::concat("Gaussians are so far away that SPZ stores all positions in steps of 1/", 1 << bits,
                               " world units instead of 1/", 1 << kUsualBits, "; leave out distant ones with --crop"));
  }
  write_spz(output, splats, options.sh_bits, options.spz_version);
}

/// Reads the written file back. If this fails, only the measurement is missing.
std::optional<SplatCloud> read_back(const fs::path& output, std::string& why_not, StatusLine& status) {
  try {
    if (needs_splat_transform(output)) return read_by_splat_transform(output, why_not, status);
    return read_splats(output);
  } catch (const InputError& error) {
    status.clear();
    status.warn(detail::concat(output.string(), " is complete, but could not be read back to measure it"));
    why_not = error.what();
    return std::nullopt;
  }
}

/// Renders the Gaussians before and after the export, which have the same world frame, from `views`, which have
/// photographs, and prints the loss. Prints nothing after a signal (stop_signal()). `what` names the views.
void measure_loss(const LoadedModel& before, SplatCloud exported, const std::vector<View>& views, const char* what,
                  bool is_cropped, StatusLine& status) {
  const torch::NoGradGuard no_grad;
  LoadedModel after;
  after.config = before.config;
  after.near_plane = before.near_plane;
  after.splats = std::move(exported);
  change_frame(before.splats.frame, after.splats);
  after.splats.antialiased = before.splats.antialiased;  // not every format stores this
  status.show(detail::concat("measuring PSNR on ", views.size(), views.size() == 1 ? " view" : " views"), /*now=*/true);
  const torch::Device device = choose_device(before.config.device);
  ModelRenderer renderer_before(before, device), renderer_after(after, device);
  double n = 0, psnr_between = 0;  // dB; these and the next are sums over the views
  ImageQuality sum_before, sum_after;
  const ProgressFn progress = show_loading(status);
  for (std::size_t i = 0; i < views.size(); ++i) {
    const View& view = views[i];
    const CameraView camera = to_camera_view(view.camera);
    const std::shared_ptr<const Image8> photograph = view.image->read();
    const torch::Tensor own = renderer_before.render(camera).color, other = renderer_after.render(camera).color;
    progress("measuring PSNR, view", i + 1, views.size());
    if (stop_signal() != 0) return;
    const auto quality = image_quality(own, *photograph, view.valid.get());
    if (!quality) continue;  // no valid pixel
    ++n;
    const auto exported_quality = image_quality(other, *photograph, view.valid.get());
    sum_before.psnr += quality->psnr;
    sum_before.ssim += quality->ssim;
    sum_after.psnr += exported_quality->psnr;
    sum_after.ssim += exported_quality->ssim;
    psnr_between += image_quality(other, to_image8(own), view.valid.get())->psnr;
  }
  status.clear();
  if (n == 0) return print_line("PSNR", "not measured: masks leave out every pixel of all views");
  if (is_cropped) {
    print_line("PSNR", "not measured: the photographs show more than --crop leaves");
  } else {
    const double lost = (sum_before.psnr - sum_after.psnr) / n;
    print_line("PSNR", "%.2f dB, before %.2f dB: %.2f dB %s (mean of %.0f %s)", sum_after.psnr / n, sum_before.psnr / n,
               std::abs(lost), lost <= -0.005 ? "gained" : "lost", n, what);
    print_line("SSIM", "%.4f, before %.4f", sum_after.ssim / n, sum_before.ssim / n);
  }
  print_line("renders", "%.2f dB, those after against those before%s", psnr_between / n,
             is_cropped ? ", both cropped" : "");
}

}  // namespace

int run_export(const std::vector<std::string>& words) {
  CommandLine line(
      "export",
      "Write a model folder or a file of Gaussians in another format: .spz, .ply and .las (points), and with the "
      "program splat-transform .sog, .html, .glb, .compressed.ply and others. Prints the size, and the PSNR and SSIM "
      "before and after on views of the scene.",
      "b3dgs export output/garden garden.spz");
  ModelOptions model_options;
  ExportOptions options;
  line.add(model_options, "Model", {"model_path"});
  line.add(options, "File", {"output"});
  if (!line.parse(words)) return 0;
  if (!options.crop.empty()) parse_crop(options.crop);
  const double scale = options.scale.empty() ? 1 : parse_scale(options.scale);
  if (model_options.model_path.empty())
    input_error("missing argument: MODEL_PATH; usage: b3dgs export MODEL OUTPUT.spz");
  check_output(model_options, options);

  StatusLine status = StatusLine::for_stderr(model_options.quiet);
  const torch::Device device = choose_device(model_options.device);
  LoadedModel model = load_model(model_options);
  if (model.splats.size() == 0) input_error(model_options.model_path, ": holds no Gaussians");
  std::string why_not = model.is_file() && model_options.source_path.empty()
                            ? "no scene is named (-s SCENE)"
                            : add_scene_or_cameras(model, model_options, status);
  if (options.to_utm && !model.scene.georeference) {
    input_error(model_options.model_path, ": has no ", Georeference::kFile,
                ", which --to_utm needs; run b3dgs georeference SCENE, and train again");
  }
  LoadedModel original = model;
  if (!options.crop.empty()) crop(options.crop, original.splats);
  const fs::path input = model.is_file() ? model.file : model.folder.ply(model.iteration);
  refuse_to_replace(input, options.output);
  const auto input_bytes = static_cast<std::int64_t>(fs::file_size(input));
  print_line("from", "%s, %s Gaussians, SH degree %d, %s", input.string().c_str(),
             format_count(model.splats.size()).c_str(), model.splats.sh_degree, format_bytes(input_bytes).c_str());

  reduce(model, options, device, status);
  const fs::path output = options.output;
  const UnitQuat rotation = rotation_of(options, model, status);
  if (rotation != kNoRotation) rotate_splats(rotation, model.splats);
  scale_splats(scale, model.splats);
  const int epsg = options.to_utm ? model.scene.georeference->epsg : 0;
  if (options.to_utm) {
    move_to_utm(*model.scene.georeference, model.splats);
    print_line("coordinates", "easting, northing and height, EPSG:%d", epsg);
  } else if (scale != 1) {
    print_line("scale", "%.6g", scale);
  }
  CoordinateFrame written_frame;
  if (is_spz(output)) written_frame = spz_frame(model.splats, status);
  if (is_page(output) && model.splats.frame.is_far()) written_frame.origin = model.splats.frame.origin;
  if (is_spz(output) || is_page(output)) {
    change_frame(written_frame, model.splats);
    model.splats.frame = {};
  }
  if (needs_splat_transform(output)) catch_stop_signals();  // removes the temporary files of splat-transform
  try {
    const PageOptions page = page_view(original, rotation, scale, written_frame);
    write_output(output, model.splats, options, epsg, page, status);
  } catch (const InputError&) {
    if (stop_signal() == 0) throw;
  }
  if (stop_signal() != 0) return 128 + stop_signal();
  const auto bytes = static_cast<std::int64_t>(fs::file_size(output));
  print_line("to", "%s, %s Gaussians, SH degree %d, %s (%.1f %%)", output.string().c_str(),
             format_count(model.splats.size()).c_str(), model.splats.sh_degree, format_bytes(bytes).c_str(),
             100.0 * static_cast<double>(bytes) / static_cast<double>(input_bytes));

  const bool has_test = !original.scene.test.empty();
  const std::vector<View> views = evenly_spaced(has_test ? original.scene.test : original.scene.train,
                                                static_cast<std::size_t>(options.compare_views));
  std::optional<SplatCloud> written;
  if (options.compare_views == 0) why_not = "--compare_views is 0";
  if (options.to_utm) why_not = "the views are in coordinates of the scene";
  if (is_las(output)) why_not = "the file has points, not Gaussians";
  if (why_not.empty()) written = read_back(output, why_not, status);
  if (!written) {
    print_line("PSNR", "not measured: %s", why_not.c_str());
    return 0;
  }
  if (is_spz(output) || is_page(output)) written->frame = written_frame;
  rotate_splats(inverse(rotation), *written);
  scale_splats(1 / scale, *written);
  measure_loss(original, std::move(*written), views,
               has_test          ? "test views"
               : model.is_file() ? "views"
                                 : "training views",
               !options.crop.empty(), status);
  return stop_signal() == 0 ? 0 : 128 + stop_signal();
}

}  // namespace b3dgs
