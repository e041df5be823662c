#include "config/train_options.h"

#include "config/batch_steps.h"
#include "raster/kernels.h"

namespace b3dgs {

void for_each_option(TrainConfig& c, const std::function<void(const TrainOption&)>& take) {
  const auto field = [&](const Option& option, auto& value, const auto& constraint, const char* help) {
    take(OptionOf<std::decay_t<decltype(value)>, std::decay_t<decltype(constraint)>>{option, value, constraint, help});
  };

  OneOf kernels;
  for (const KernelRow& row : kForwardKernels) kernels.values.emplace_back(row.name);
  kernels.values.insert(kernels.values.end(), {kPublishedKernel, kAdaptive});

  field(Option{"source_path", 's', {"data_dir", "data_path"}}.common().group("Scene and output"), c.source_path, Any{},
        "scene folder: a COLMAP model or transforms.json files");
  field(Option{"model_path", 'm', {"result_dir"}}.common(), c.model_path, Any{},
        "output folder (default output/SCENE)");
  field(Option{"images", 'i'}.common(), c.images, Any{}, "image folder inside the scene folder");
  field(Option{"resolution", 'r', {"data_factor"}}.common(), c.resolution, AtLeast{-1},
        "1, 2, 4, 8: divide size; >= 32: width, px; -1: width at most 1600 px");
  field(Option{"eval"}.common(), c.eval, Any{},
        "hold out test views: those in test.txt or transforms files, or every 8th by name");
  field(Option{"init_ply"}, c.init_ply, Any{},
        "start from this PLY (Gaussians or points) or SPZ instead of the scene's points");
  field(Option{"depths", 'd'}.may_be_empty(), c.depths, Any{},
        "folder of inverse depth maps, 16-bit PNGs named like the photographs");
  field(Option{"lenses"}, c.lenses, OneOf{{"undistort", "native", "auto"}},
        "undistort photographs, or train in their lens: native always, auto if it is wide");
  field(Option{"masks"}, c.masks, Any{},
        "folder of masks, black is left out (default masks/ if it exists; none: no masks)");
  field(Option{"invert_masks"}, c.invert_masks, Any{}, "leave out what is white in masks instead of black");
  field(Option{"mask_mode"}, c.mask_mode, one_of<MaskMode>(),
        "ignore what masks leave out, or segment: nothing may be there");
  field(Option{"device"}.common().group("Device and memory"), c.device, OneOf{{"auto", "cpu", "cuda"}},
        "where to train; auto: a GPU if there is one");
  field(Option{"gpu_memory_gb"}.common(), c.gpu_memory_gb, AtLeast{0},
        "GPU memory limit, GB; limits the number of Gaussians (0 = all free memory)");
  field(Option{"host_memory_gb"}, c.host_memory_gb, AtLeast{-1},
        "photographs in host memory, GB per rank (-1 = ranks share 80 %); rest read from disk");

  field(Option{"sh_degree"}.group("Model and image"), c.sh_degree, InRange{0, 3},
        "highest degree of the spherical harmonics");
  field(Option{"white_background", 'w'}.common(), c.white_background, Any{}, "white background instead of black");
  field(Option{"random_background"}, c.random_background, Any{}, "new random background colour in each iteration");
  field(Option{"antialiasing"}.common(), c.antialiasing, Any{},
        "filter Gaussians, for renders at other sizes and distances than the photographs'");
  field(Option{"near_plane"}, c.near_plane, Above{0},
        "ignore Gaussians closer to the camera than this; 5 is the typical depth of the scene");

  OneOf presets;
  for (const char* name : kPresetNames) presets.values.emplace_back(name);
  field(Option{"preset"}.common().group("Schedule"), c.preset, presets,
        "named set of option values, which other given options override: see docs/recipes.md");
  field(Option{"steps_scaler"}, c.steps_scaler, Above{0},
        "multiply all options counted in iterations by X, --iterations included");
  field(Option{"iterations", '\0', {"max_steps"}}.common().in_steps(), c.iterations, AtLeast{1}, "training iterations");
  field(Option{"max_epochs"}.in_steps(), c.max_epochs, AtLeast{0},
        "use each photograph at most X times: shortens the schedule (0 = no limit)");
  field(Option{"batch"}, c.batch, InRange{1, kMaxBatch},
        "views per step: mean gradient, rates x sqrt(B); default with several ranks: one each");
  field(Option{"seed"}, c.seed, AtLeast{0}, "random seed");
  constexpr AtLeast output{-1};  // full_eval.py of the original code passes --test_iterations -1 for none
  field(Option{"test_iterations", '\0', {"eval_steps"}}.common().in_steps(Steps::kOutput), c.test_iterations, output,
        "evaluate the test views after these iterations, and at the end");
  field(Option{"save_iterations", '\0', {"save_steps"}}.common().in_steps(Steps::kOutput), c.save_iterations, output,
        "write a PLY after these iterations, and at the end");
  field(Option{"checkpoint_iterations"}.in_steps(Steps::kOutput), c.checkpoint_iterations, output,
        "write a checkpoint after these iterations and keep it; one at the end, too");
  field(Option{"checkpoint_minutes"}, c.checkpoint_minutes, AtLeast{0},
        "write a checkpoint every X minutes of training (0 = never)");
  field(Option{"coarse_scale"}, c.coarse_scale, InRange{1, 8},
        "train at 1/N of the image size at first, full size at coarse_until (1 = always)");
  field(Option{"coarse_until"}.in_steps(), c.coarse_until, AtLeast{1},
        "train on views of full size from this iteration at the latest");

  field(Option{"position_lr_init"}.group("Learning rates and loss"), c.position_lr_init, AtLeast{0},
        "initial learning rate of the means, x scene extent");
  field(Option{"position_lr_final"}, c.position_lr_final, AtLeast{0},
        "final learning rate of the means, x scene extent");
  field(Option{"position_lr_max_steps"}.in_steps(), c.position_lr_max_steps, AtLeast{1},
        "iterations over which the learning rate of the means decays");
  field(Option{"lr_final_scale"}, c.lr_final_scale, Above{0},
        "rates of scales, rotations, opacities, colours fall to X times these");
  field(Option{"lr_decay_from_iter"}.in_steps(), c.lr_decay_from_iter, AtLeast{0},
        "iteration from which --lr_final_scale lowers rates, until --position_lr_max_steps");
  field(Option{"lr_decay_from_epoch"}.in_steps(), c.lr_decay_from_epoch, AtLeast{0},
        "begin this decay after at most X uses of each photograph (0 = no such limit)");
  field(Option{"feature_lr"}, c.feature_lr, AtLeast{0}, "learning rate of SH degree 0");
  field(Option{"feature_rest_divisor"}, c.feature_rest_divisor, Above{0},
        "learning rate of higher SH degrees: --feature_lr / X");
  field(Option{"opacity_lr"}, c.opacity_lr, AtLeast{0}, "learning rate of the opacities");
  field(Option{"scaling_lr"}, c.scaling_lr, AtLeast{0}, "learning rate of the scales");
  field(Option{"rotation_lr"}, c.rotation_lr, AtLeast{0}, "learning rate of the rotations");
  field(Option{"pose_opt"}, c.pose_opt, Any{}, "refine the poses of the training cameras; see docs/recipes.md");

  field(Option{"lambda_dssim", '\0', {"ssim_lambda", "ssim_weight"}}, c.lambda_dssim, InRange{0, 1},
        "weight of D-SSIM in the loss");
  field(Option{"opacity_reg"}, c.opacity_reg, AtLeast{0}, "add X x mean opacity of the Gaussians in view to the loss");
  field(Option{"scale_reg"}, c.scale_reg, AtLeast{0}, "add X x mean scale of the Gaussians in view to the loss");
  field(Option{"sh_decay"}, c.sh_decay, AtLeast{0},
        "shrink SH degrees above 0 of Gaussians seen from similar directions (0 = off)");
  field(Option{"depth_l1_weight_init"}, c.depth_l1_weight_init, AtLeast{0},
        "initial weight of the error against --depths in the loss");
  field(Option{"depth_l1_weight_final"}, c.depth_l1_weight_final, AtLeast{0},
        "weight of that error in the last iteration; changes exponentially between");

  field(Option{"exposure"}.group("Appearance of photographs"), c.exposure, Any{},
        "learn an affine colour transform for each photograph; see docs/recipes.md");
  field(Option{"exposure_lr_init"}, c.exposure_lr_init, AtLeast{0}, "initial learning rate of --exposure");
  field(Option{"exposure_lr_final"}, c.exposure_lr_final, AtLeast{0},
        "learning rate of --exposure in the last iteration");
  field(Option{"bilateral_grid"}, c.bilateral_grid, Any{},
        "learn a bilateral grid of colour transforms for each photograph");
  field(Option{"train_test_exp"}, c.train_test_exp, Any{},
        "measure the right half of test views, with colours fitted to their left half");

  field(Option{"strategy"}.common().group("Density control"), c.strategy, one_of<Strategy>(),
        "how Gaussians are added and removed; see docs/recipes.md");
  field(Option{"densify_from_iter"}.in_steps(), c.densify_from_iter, AtLeast{0},
        "start density control after this iteration");
  field(Option{"densify_until_iter"}.in_steps(), c.densify_until_iter, AtLeast{0},
        "stop density control before this iteration");
  field(Option{"densification_interval"}.in_steps(), c.densification_interval, AtLeast{1},
        "iterations between rounds of density control");
  field(Option{"densify_grad_threshold"}, c.densify_grad_threshold, AtLeast{0},
        "default: clone or split Gaussians whose mean screen-space gradient is at least X");
  field(Option{"percent_dense"}, c.percent_dense, AtLeast{0},
        "default: split Gaussians larger than X x scene extent, clone smaller ones");
  field(Option{"opacity_reset_interval"}.in_steps(), c.opacity_reset_interval, AtLeast{1},
        "iterations between opacity resets; budget: between removals by --prune_weight");
  field(Option{"sh_increase_interval", '\0', {"sh_degree_interval"}}.in_steps(), c.sh_increase_interval, AtLeast{1},
        "raise the active SH degree by one every N iterations");
  field(Option{"max_gaussians", '\0', {"max_cap", "max_splats"}}.common(), c.max_gaussians, AtLeast{0},
        "maximum number of Gaussians (0 = by --gaussians_per_pixel)");
  field(Option{"gaussians_per_pixel"}, c.gaussians_per_pixel, AtLeast{0},
        "without --max_gaussians: at most X per pixel of one photograph (0 = no limit)");
  field(Option{"score_views"}, c.score_views, AtLeast{1}, "budget: steps before each round whose views are scored");
  field(Option{"prune_weight"}, c.prune_weight, InRange{0, 1},
        "budget: remove Gaussians whose largest blend weight is below X (0 = none)");
  field(Option{"crop"}, c.crop, Any{},
        "budget: train this box, sphere, or file with one in detail, and the rest coarsely");

  field(Option{"kernel"}.group("Kernels"), c.kernel, kernels,
        "blending kernel; adaptive: segmented or sub-tile, timed; published: as in the paper");
  // Not .in_steps(), because a check costs the same in a shorter schedule.
  field(Option{"kernel_check_interval"}, c.kernel_check_interval, AtLeast{1},
        "adaptive, published: time both kernels at the start and every N iterations");
  field(Option{"culling"}, c.culling, one_of<Culling>(),
        "how to decide which tiles a Gaussian touches; square: 3-sigma box, as in 3DGS");
  field(Option{"deterministic"}.group("Schedule"), c.deterministic, Any{},
        "same result every run; turns off kernel auto-selection, slower on a GPU");
  field(Option{"threads"}.group("Device and memory"), c.threads, AtLeast{0},
        "CPU threads (0 = all cores, or with ranks this rank's share of the machine's)");
}

}  // namespace b3dgs
