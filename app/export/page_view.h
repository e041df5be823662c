// How the page of an .html export opens.
#pragma once

#include "app/common/torch/model.h"
#include "app/export/splat_transform.h"
#include "model/edit/edit.h"

namespace b3dgs {

/// Returns the title, the name of the model, and the first view of its page. That is the first training camera's (or
/// test camera's), turned upright, towards the point that all cameras look at if its image shows this point. Without
/// cameras, it is a view of the Gaussians from three times their radius. The file has the Gaussians of `model` rotated
/// by `rotation` about the origin of the world and multiplied by `scale`, in the coordinates of `frame`. The background
/// is that of the training.
PageOptions page_view(const LoadedModel& model, const UnitQuat& rotation, double scale, const CoordinateFrame& frame);

}  // namespace b3dgs
