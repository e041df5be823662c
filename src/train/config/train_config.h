// All training options. The defaults are those of the original 3DGS code; comments explain the others.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/config.h"
#include "raster/backward_kernel.h"
#include "raster/forward_kernel.h"

namespace b3dgs {

/// Instead of a kernel's name: select the kernel by timing.
inline constexpr const char* kAdaptive = "adaptive";
/// The same for the forward kernel, exactly as in the paper: see KernelPolicy::kPublished.
inline constexpr const char* kPaperKernel = "paper";
/// The kernels used if none is named and nothing is timed: in evaluation, and in deterministic training.
inline constexpr const char *kUnmeasuredKernel = "shared-memory", *kUnmeasuredBackwardKernel = "per-splat";

struct TrainConfig {
  // Input and output
  std::string source_path;
  std::string model_path;
  std::string images = "images";
  int resolution = -1;
  bool eval = false;
  std::string init_ply;
  std::string device = "auto";
  // A few hundred photographs at the default 1600 px take 1 to 3 GB: half of a GPU's free memory holds nearly every
  // scene, and leaves the other half to the Gaussians. Uploading the others does not change the result.
  double image_cache_gb = -1;
  double gpu_memory_gb = 0;  // 0 = all that is free
  double host_memory_gb = -1;

  // Model and rendering
  int sh_degree = 3;
  bool white_background = false;
  bool random_background = false;
  double near_plane = 0.2;  // world units

  // Schedule
  int iterations = 30000;
  std::int64_t seed = 0;
  std::vector<int> test_iterations{7000, 30000};
  std::vector<int> save_iterations{7000, 30000};
  std::vector<int> checkpoint_iterations{};
  int checkpoint_interval = 0;
  double checkpoint_minutes = 10;  // of training
  int keep_checkpoints = 2;

  // Learning rates
  double position_lr_init = 0.00016;     // times the scene's extent
  double position_lr_final = 0.0000016;  // times the scene's extent
  int position_lr_max_steps = 30000;
  double feature_lr = 0.0025;  // of SH degree 0; higher degrees use 1/20 of it
  double opacity_lr = 0.025;   // 0.05 in early versions of the original code
  double scaling_lr = 0.005;
  double rotation_lr = 0.001;

  // Loss
  double lambda_dssim = 0.2;

  // Density control
  int densify_from_iter = 500;     // exclusive: acts at 600, 700, ...
  int densify_until_iter = 15000;  // exclusive: acts up to 14900
  int densification_interval = 100;
  double densify_grad_threshold = 0.0002;  // norm of the gradient by the projected centre, half image sizes
  double percent_dense = 0.01;             // of the extent: larger Gaussians are split, smaller ones cloned
  double prune_opacity = 0.005;
  double prune_world_size = 0.1;  // of the extent; acts after the first opacity reset
  // The original code is meant to prune Gaussians wider than 20 px, but zeroes the radii just before it tests them (its
  // issue 123), so nothing is ever pruned for its size on screen. 0 keeps that behaviour; 20 is the intended rule.
  double prune_screen_size = 0;  // px
  int opacity_reset_interval = 3000;
  int sh_increase_interval = 1000;
  std::int64_t max_gaussians = 0;  // 0 = no limit

  // Rasterizer
  std::string kernel = "adaptive";
  std::string kernel_policy = "paper";
  std::vector<std::string> kernel_candidates{"segmented", "shared-memory"};
  int kernel_check_interval = 1000;
  int kernel_check_views = 5;
  std::string backward_kernel = "per-splat";
  std::string tile = "auto";
  std::string culling = "ellipse";
  bool deterministic = false;
  int threads = 0;  // 0 = all cores

  // Additional lines of train.jsonl
  int stats_interval = 1000;
  int kernel_times_interval = 0;
};

template <class Config, class Visitor>
std::enable_if_t<std::is_same_v<std::remove_const_t<Config>, TrainConfig>> visit_fields(Config& c, Visitor&& field) {
  SomeOf candidates{{}, 2};
  for (const ForwardKernelName& row : kForwardKernels) candidates.values.emplace_back(row.name);
  OneOf kernels{candidates.values}, backward_kernels;
  kernels.values.emplace_back(kPaperKernel);
  for (const BackwardKernelName& row : kBackwardKernels) backward_kernels.values.emplace_back(row.name);
  for (OneOf* names : {&kernels, &backward_kernels}) names->values.emplace_back(kAdaptive);

  field(Option{"source_path", 's', {"data_dir", "data_path"}}, c.source_path, Any{}, "folder of the COLMAP scene");
  field(Option{"model_path", 'm', {"result_dir"}}, c.model_path, Any{},
        "folder to write the model to (default: output/SCENE)");
  field(Option{"images", 'i'}, c.images, Any{}, "image folder below the scene");
  field(Option{"resolution", 'r', {"data_factor"}}, c.resolution, AtLeast{-1},
        "1, 2, 4, 8 divide the image size; -1 caps the width at 1600 px; 32 and more are the width in px");
  field(Option{"eval"}, c.eval, Any{}, "hold out every 8th view by sorted name for testing");
  field(Option{"init_ply"}, c.init_ply, Any{},
        "start from the Gaussians (or points) of this PLY instead of the scene's points");
  field(Option{"device", '\0', {"data_device"}}, c.device, OneOf{{"auto", "cpu", "cuda"}},
        "where to train; auto takes a GPU if there is one");
  field(Option{"image_cache_gb"}, c.image_cache_gb, AtLeast{-1},
        "photographs that stay on the GPU, 10^9 bytes; the others are uploaded ahead; -1: as many as fit in half of "
        "the memory that is free");
  field(Option{"gpu_memory_gb"}, c.gpu_memory_gb, AtLeast{0},
        "GPU memory that training may take besides the CUDA context, 10^9 bytes; the number of Gaussians is held where "
        "more would not fit; 0: all that is free");
  field(Option{"host_memory_gb"}, c.host_memory_gb, AtLeast{-1},
        "host memory for decoded photographs, 10^9 bytes; those beyond it are read ahead from disk, with the same "
        "result; -1: 80 % of the memory that is available");

  field(Option{"sh_degree"}, c.sh_degree, InRange{0, 3}, "highest degree of the spherical harmonics");
  field(Option{"white_background", 'w'}, c.white_background, Any{}, "white instead of black behind the Gaussians");
  field(Option{"random_background"}, c.random_background, Any{}, "another background colour each step");
  field(Option{"near_plane"}, c.near_plane, Above{0}, "Gaussians nearer than this are not seen, world units");

  field(Option{"iterations", '\0', {"max_steps"}}, c.iterations, AtLeast{1}, "optimisation steps");
  field(Option{"seed"}, c.seed, AtLeast{0}, "of everything random");
  field(Option{"test_iterations", '\0', {"eval_steps"}}, c.test_iterations, AtLeast{1}, "evaluate after these");
  field(Option{"save_iterations", '\0', {"save_steps"}}, c.save_iterations, AtLeast{1},
        "write a PLY after these, and after the last");
  field(Option{"checkpoint_iterations"}, c.checkpoint_iterations, AtLeast{1},
        "write a checkpoint after these, and after the last");
  field(Option{"checkpoint_interval"}, c.checkpoint_interval, AtLeast{0},
        "write a checkpoint every so many iterations; 0: not");
  field(Option{"checkpoint_minutes"}, c.checkpoint_minutes, AtLeast{0},
        "write a checkpoint whenever this many minutes of training have passed since the last one (0 = never)");
  field(Option{"keep_checkpoints"}, c.keep_checkpoints, AtLeast{1}, "keep so many of the newest checkpoints");

  field(Option{"position_lr_init"}, c.position_lr_init, AtLeast{0}, "rate of the means at the start, times the extent");
  field(Option{"position_lr_final"}, c.position_lr_final, AtLeast{0}, "rate of the means at the end, times the extent");
  field(Option{"position_lr_max_steps"}, c.position_lr_max_steps, AtLeast{1},
        "iterations over which the means' rate falls");
  field(Option{"feature_lr"}, c.feature_lr, AtLeast{0}, "rate of SH degree 0; the higher ones get a 20th");
  field(Option{"opacity_lr"}, c.opacity_lr, AtLeast{0}, "rate of the opacities");
  field(Option{"scaling_lr"}, c.scaling_lr, AtLeast{0}, "rate of the scales");
  field(Option{"rotation_lr"}, c.rotation_lr, AtLeast{0}, "rate of the rotations");

  field(Option{"lambda_dssim", '\0', {"ssim_lambda", "ssim_weight"}}, c.lambda_dssim, InRange{0, 1},
        "share of D-SSIM in the loss");

  field(Option{"densify_from_iter"}, c.densify_from_iter, AtLeast{0}, "density control acts after this iteration");
  field(Option{"densify_until_iter"}, c.densify_until_iter, AtLeast{0}, "density control acts before this iteration");
  field(Option{"densification_interval"}, c.densification_interval, AtLeast{1},
        "iterations between two rounds of density control");
  field(Option{"densify_grad_threshold"}, c.densify_grad_threshold, AtLeast{0},
        "mean gradient above which a Gaussian is cloned or split");
  field(Option{"percent_dense"}, c.percent_dense, AtLeast{0},
        "share of the extent above which a Gaussian is split, not cloned");
  field(Option{"prune_opacity", '\0', {"min_opacity"}}, c.prune_opacity, InRange{0, 1},
        "Gaussians below this opacity are removed");
  field(Option{"prune_world_size"}, c.prune_world_size, AtLeast{0},
        "share of the extent above which a Gaussian is removed, after the first opacity reset; 0: none");
  field(Option{"prune_screen_size"}, c.prune_screen_size, AtLeast{0},
        "radius in px above which a Gaussian is removed, after the first opacity reset; 0: none");
  field(Option{"opacity_reset_interval"}, c.opacity_reset_interval, AtLeast{1},
        "iterations between two resets of the opacities");
  field(Option{"sh_increase_interval", '\0', {"sh_degree_interval"}}, c.sh_increase_interval, AtLeast{1},
        "iterations after which the SH degree rises by one");
  field(Option{"max_gaussians", '\0', {"max_cap", "max_splats"}}, c.max_gaussians, AtLeast{0},
        "the count never grows beyond this; 0: no limit");

  field(Option{"kernel"}, c.kernel, kernels,
        "forward blending kernel; adaptive measures and chooses; paper does so exactly as the paper: starts with "
        "combined, times it against shared-memory every --kernel_check_interval iterations, and switches once");
  field(Option{"kernel_policy"}, c.kernel_policy, OneOf{{"paper", "tracking"}},
        "how adaptive chooses: leaves the first candidate once and for good, or keeps checking");
  field(Option{"kernel_candidates"}, c.kernel_candidates, candidates,
        "what adaptive chooses from; training starts with the first");
  field(Option{"kernel_check_interval"}, c.kernel_check_interval, AtLeast{1},
        "iterations between two measurements of the candidates; adaptive measures once more before the first step, "
        "and later where all of them would cost over 0.5 % of the training time so far (without loading the kernels' "
        "code, once in a process), where the next one would cost more than that of what is left, and for 500 "
        "iterations after an opacity reset");
  field(Option{"kernel_check_views"}, c.kernel_check_views, AtLeast{3},
        "coming views on which the candidates are measured; fewer, but three at least, where those leave no doubt "
        "or more would delay the next measurement");
  field(Option{"backward_kernel"}, c.backward_kernel, backward_kernels,
        "backward blending kernel, on the GPU; adaptive measures and chooses, with the forward kernel's policy");
  field(Option{"tile"}, c.tile, OneOf{{"auto", "16x16", "16x8"}},
        "unit of binning, px; auto takes what is faster: 16x8 on a GPU, 16x16 on a CPU");
  field(Option{"culling"}, c.culling, OneOf{{"ellipse", "square"}},
        "tiles of a Gaussian: exact, or the original's 3-sigma square");
  field(Option{"deterministic"}, c.deterministic, Any{},
        "the same bytes from the same seed, on the GPU too; slower there. Nothing is chosen by its time");
  field(Option{"threads"}, c.threads, AtLeast{0}, "CPU threads; 0: all cores");

  field(Option{"stats_interval"}, c.stats_interval, AtLeast{0},
        "write how unevenly the load is spread over tiles and pixels every so many iterations; 0: not");
  field(
      Option{"kernel_times_interval"}, c.kernel_times_interval, AtLeast{0},
      "write how long each of --kernel_candidates takes every so many iterations, whatever kernel is used; not counted "
      "as training; 0: not, or as often as --stats_interval in b3dgs compare");
}

/// Whether the forward kernel is selected by timing.
inline bool chooses_forward_kernel(const TrainConfig& config) {
  return config.kernel == kAdaptive || config.kernel == kPaperKernel;
}

/// The forward kernels that training may use; it starts with the first.
inline std::vector<std::string> forward_candidates(const TrainConfig& config) {
  if (config.kernel == kPaperKernel) {
    return {std::string(forward_kernel_name(ForwardKernel::kCombined)),
            std::string(forward_kernel_name(ForwardKernel::kSharedMemory))};
  }
  return config.kernel == kAdaptive ? config.kernel_candidates : std::vector<std::string>{config.kernel};
}

}  // namespace b3dgs
