// What the options of a training and its scene have to do with each other: how the scene is read, and the limits that
// follow from it.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "config/schedule.h"
#include "config/train_config.h"
#include "scene/scene.h"

namespace b3dgs {

/// How the scene of these options is read. A scene that is read otherwise does not belong to the training.
SceneOptions scene_options(const TrainConfig& config);

/// @throws InputError if --antialiasing is given and a training view is no pinhole; or if load_scene() has read the
/// scene with other options than those of the config, which is not checked for scenes that were made otherwise and for
/// configs that name no scene
void check_scene_options(const TrainConfig& config, const Scene& scene);

/// --max_gaussians; without it, --gaussians_per_pixel X for every pixel of one training photograph (of their mean
/// size). With n < 100 training photographs: X (n / 100)^1.5, where X counts as at most 2.4 n / 100 or, if that is
/// more, 1.2. No fewer than the scene has points. Returns 0 for no limit.
///
/// With few photographs, many Gaussians overfit the training views; with 50 or fewer, more than X = 1.2 allows help on
/// some scenes and harm on others. Beyond 100, more photographs of a scene do not call for more (docs/benchmarks.md,
/// Few photographs). Pixels are those of the cameras; masked ones count.
std::int64_t count_limit(const TrainConfig& config, const Scene& scene);

/// The first iteration of the decay by --lr_final_scale: --lr_decay_from_iter, but no later than when each photograph
/// has been used --lr_decay_from_epoch times (0 = no such limit). The fewer photographs, the fewer
/// iterations until training overfits them.
int decay_start(const TrainConfig& config, const Scene& scene);

/// With the overlap of the training views: of the points that a view sees, the mean number of views that see them too,
/// averaged over the views. Nothing is known of what hides a point. Without points: as if all views saw the same.
Photographs training_photographs(const Scene& scene);

/// The options of a training of this scene, with these limits. Applying it again changes nothing. --max_epochs is not
/// among them: limit_epochs() (config/schedule.h) has to know which options were given, so commands apply it before.
TrainConfig with_scene_limits(TrainConfig config, const Scene& scene);

/// A warning if many of the points ([N, 3]) that training views see are nearer than the near plane, which leaves them
/// out, or if no view sees any point; otherwise empty. Both are in the frame of the scene.
std::string near_plane_warning(const std::vector<float>& points, const std::vector<View>& views, double near_plane);

}  // namespace b3dgs
