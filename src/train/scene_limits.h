// Settings of a training that depend on its scene: how the scene is read, and limits that follow from its size.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "config/schedule.h"
#include "config/train_config.h"
#include "scene/scene.h"

namespace b3dgs {

/// Returns the options to read the scene of this training with. A scene read with other options does not belong to the
/// training.
SceneOptions scene_options(const TrainConfig& config);

/// Checks that the scene fits the options. Options of load_scene() are compared only if the scene comes from there and
/// the config names a scene. @throws InputError if --antialiasing is given and the camera of a training view is not a
/// pinhole, or if load_scene() was called with other options than scene_options(config)
void check_scene_options(const TrainConfig& config, const Scene& scene);

/// Returns the maximum number of Gaussians, 0 for no limit. This is --max_gaussians if it is given or
/// --gaussians_per_pixel is 0, and otherwise
///
///   max(Y P, number of points in the scene)
///
/// where P is the mean number of pixels of a training photograph, Y is --gaussians_per_pixel X if there are n >= 100
/// training photographs, and with fewer
///
///   Y = min(X, max(1.2, 2.4 n / 100)) n / 100
///
/// With few photographs, many Gaussians overfit the training views. With 50 or fewer, a larger X than 1.2 improves some
/// scenes and harms others. Beyond 100, more photographs of a scene do not need more Gaussians (docs/lab/defaults.md,
/// Number of Gaussians). P is taken from the cameras, so masked pixels count.
std::int64_t count_limit(const TrainConfig& config, const Scene& scene);

/// Returns the first iteration of the decay by --lr_final_scale. This is --lr_decay_from_iter, but no later than the
/// iteration at which each photograph has been used --lr_decay_from_epoch times (0 = no such limit), because training
/// overfits few photographs earlier.
int decay_start(const TrainConfig& config, const Scene& scene);

/// Returns the number of training views and their overlap. For each point that a view sees, it counts the views that
/// see the point, and averages over the points of a view and then over the views. Occlusion is unknown and ignored. If
/// no view sees a point, the overlap is that of views that all see the same.
Photographs training_photographs(const Scene& scene);

/// Returns the options with these limits. A second application changes nothing. --max_epochs is not included, because
/// limit_epochs() (config/schedule.h) has to know which options were given. Commands apply it before this.
TrainConfig with_scene_limits(TrainConfig config, const Scene& scene);

/// Returns a warning if over 5 % of the points ([N, 3], in the frame of the scene) that training views see are nearer
/// than the near plane in most of these views, or if no view sees any point. Otherwise returns "".
std::string near_plane_warning(const std::vector<float>& points, const std::vector<View>& views, double near_plane);

}  // namespace b3dgs
