#include "app/bench/bench_scenes.h"

#include <algorithm>
#include <cmath>

#include "app/common/status_line.h"
#include "data_synth/random.h"
#include "data_synth/synth_scene.h"
#include "model/cameras/cameras_json.h"
#include "model/model_folder.h"
#include "model/raster_input.h"
#include "scene/cameras/coordinate_frame.h"
#include "scene/scene.h"
#include "train/device.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

BenchScene make_street_bench(const BenchConfig& config) {
  SynthConfig synth;
  synth.scene = "street";
  synth.seed = config.seed;
  synth.points = static_cast<int>(config.points);
  synth.views = 1;
  synth.width = config.width;
  synth.height = config.height;
  const SynthScene street = make_scene(with_scene_defaults(synth));
  return {"street", splats_from_points(street.points, 3), to_camera_view(street.cameras.front())};
}

/// Density of Gaussians as a function of the distance from the image centre, in units of half the image size. Constant
/// within a core, whose size is chosen so that skew 1 matches the points of `street`.
class SpreadDensity {
 public:
  explicit SpreadDensity(double skew) : skew_(skew) {
    mass_ = kCoreMass +
            (is_logarithmic_ ? -slope_ * std::log(kCore) : slope_ * (1 - std::pow(kCore, exponent_)) / exponent_);
  }

  /// Maps a distance in the even distribution to the distance that encloses the same share of this distribution.
  double skewed_distance(double distance) const {
    if (skew_ == 0) return distance;
    const double mass = distance * distance * mass_;
    if (mass <= kCoreMass) return std::sqrt(mass);
    const double rest = (mass - kCoreMass) / slope_;
    return is_logarithmic_ ? kCore * std::exp(rest)
                           : std::pow(std::pow(kCore, exponent_) + exponent_ * rest, 1 / exponent_);
  }

  /// Returns the density at a distance, relative to the mean over the image.
  double at(double distance) const { return std::pow(std::max(distance, kCore) / kCore, -2 * skew_) / mass_; }

 private:
  static constexpr double kCore = 0.05;
  static constexpr double kCoreMass = kCore * kCore;  // the area is distance^2, so the whole image has mass 1

  const double skew_;
  const double exponent_ = 2 - 2 * skew_, slope_ = 2 * std::pow(kCore, 2 * skew_);  // of the mass beyond the core
  const bool is_logarithmic_ = std::abs(exponent_) < 1e-9;
  double mass_;  // mass of the whole image, with density 1 in the core
};

/// Appends the attributes of a trained Gaussian except its mean: random shape, opacity and colour.
void append_trained(SplatCloud& cloud, double median_sigma, Random& random) {
  const auto add = [&](std::vector<float>& values, int n, double middle, double spread) {
    for (int k = 0; k < n; ++k) values.push_back(static_cast<float>(middle + spread * random.normal()));
  };
  const double log_sigma = std::log(median_sigma) + 0.5 * random.normal();
  add(cloud.log_scales, 3, log_sigma, 0.3);
  add(cloud.quats, 4, 0, 1);
  add(cloud.logit_opacities, 1, 0, 1.5);
  add(cloud.sh0, 3, 0, 1);
  add(cloud.shN, 3 * (sh_coefficient_count(cloud.sh_degree) - 1), 0, 0.1);
}

/// Appends the attributes that splats_from_points() assigns to a point of random colour, except its mean.
void append_untrained(SplatCloud& cloud, double sigma, Random& random) {
  cloud.log_scales.insert(cloud.log_scales.end(), 3, static_cast<float>(std::log(sigma)));
  cloud.quats.insert(cloud.quats.end(), {1, 0, 0, 0});
  cloud.logit_opacities.push_back(logit(0.1));
  for (int k = 0; k < 3; ++k) cloud.sh0.push_back(sh0_from_color(random.uniform()));
  cloud.shN.resize(cloud.shN.size() + 3 * (sh_coefficient_count(cloud.sh_degree) - 1));
}

const Camera& choose_view(const std::vector<NamedCamera>& cameras, const std::string& name) {
  if (name.empty()) return cameras.front().camera;
  const auto found =
      std::find_if(cameras.begin(), cameras.end(), [&](const NamedCamera& camera) { return camera.name == name; });
  if (found == cameras.end()) {
    input_error("--view ", name, ": no camera with this image name (the first is ", cameras.front().name, ")");
  }
  return found->camera;
}

/// Reads a model or scene folder, or files that replace its Gaussians or cameras.
BenchScene read_bench_scene(const BenchConfig& config) {
  BenchScene result{config.ply.empty() ? config.scene : config.ply, {}, {}};
  std::vector<NamedCamera> cameras;  // in world coordinates
  if (!config.ply.empty()) result.cloud = read_splats(config.ply);
  if (!config.cameras.empty()) cameras = read_cameras_json(config.cameras);
  const ModelFolder folder(config.scene);
  const bool is_complete = !config.ply.empty() && !config.cameras.empty();
  if (!is_complete && !folder.ply_iterations().empty()) {
    if (config.ply.empty()) result.cloud = read_splat_ply(folder.ply(folder.ply_iterations().back()));
    if (config.cameras.empty()) cameras = read_cameras_json(folder.cameras());
  } else if (!is_complete) {
    SceneOptions options;
    options.source_path = config.scene;
    options.images = config.images;
    options.load_images = false;
    const Scene scene = load_scene(options);
    if (config.ply.empty()) {
      result.cloud = splats_from_points(scene.points, 3);
      result.cloud.frame = scene.frame;
    }
    for (const View& view : scene.train) {
      if (config.cameras.empty()) cameras.push_back({view.name, change_frame(scene.frame, {}, view.camera)});
    }
  }
  result.view = to_camera_view(change_frame({}, result.cloud.frame, choose_view(cameras, config.view)));
  if (result.cloud.size() == 0) {
    input_error(result.name, ": no points to initialize Gaussians from; give a model with --ply");
  }
  StatusLine status = StatusLine::for_stderr(/*quiet=*/false);
  for (const std::string& note : result.cloud.notes) status.warn(note);
  return result;
}

}  // namespace

BenchScene make_spread_scene(const SpreadConfig& spread, const BenchRun& run) {
  constexpr double kFocal = 1000, kNearest = 2, kDepthRange = 8;
  constexpr double kTrainedSigma = 1.7;  // px
  // Mean distance to the 3 nearest neighbours of random points in a plane with density 1: 1/2, 3/4 and 15/16. Training
  // uses the root mean square, whose geometric mean differs by less than 1 %.
  constexpr double kSigmaPerSpacing = (0.5 + 0.75 + 0.9375) / 3;
  const double pixels_per_point = static_cast<double>(run.width) * run.height / static_cast<double>(spread.points);
  const SpreadDensity density(spread.skew);
  Random random(run.seed);
  BenchScene scene{"spread", {}, {}};
  SplatCloud& cloud = scene.cloud;
  cloud.sh_degree = spread.sh_degree;
  for (std::int64_t i = 0; i < spread.points; ++i) {
    const double z = kNearest + kDepthRange * random.uniform();
    const double u = random.uniform() - 0.5, v = random.uniform() - 0.5;
    const double even_distance = 2 * std::max({std::abs(u), std::abs(v), 1e-12});
    const double distance = density.skewed_distance(even_distance);
    const double scale = distance / even_distance;
    const double x = scale * u * run.width / kFocal * z, y = scale * v * run.height / kFocal * z;
    for (const double coordinate : {x, y, z}) cloud.means.push_back(static_cast<float>(coordinate));
    if (spread.state == SpreadState::kTrained) {
      append_trained(cloud, kTrainedSigma * z / kFocal, random);
    } else {
      const double spacing = std::sqrt(pixels_per_point / density.at(distance));
      append_untrained(cloud, kSigmaPerSpacing * spacing * z / kFocal, random);
    }
  }
  const Camera camera{run.width, run.height, kFocal, kFocal, 0.5 * run.width, 0.5 * run.height, {}, {}};
  scene.view = to_camera_view(camera);
  return scene;
}

BenchScene make_bench_scene(const BenchConfig& config) {
  const bool is_street = config.scene == "street", is_synthetic = is_street || config.scene == "spread";
  if (is_synthetic && config.ply.empty() != config.cameras.empty()) {
    input_error(
        "--ply and --cameras must be given together, or with a COLMAP or model folder that provides the "
        "other");
  }
  if (!is_synthetic || !config.ply.empty()) return read_bench_scene(config);
  return is_street ? make_street_bench(config)
                   : make_spread_scene({config.points, config.skew, SpreadConfig().sh_degree}, config);
}

}  // namespace b3dgs
