// What the page of the live view is told of a scene.
#pragma once

#include <string>
#include <vector>

#include "scene/scene.h"
#include "view/frame_source.h"

namespace b3dgs {

/// The cameras of a scene, training views first, and the part of the world where most of the points are ([N, 3]).
ViewedScene viewed_scene(const Scene& scene, const std::vector<float>& points, const std::string& title);

/// The view behind ViewedScene::views[index].
const View& view_at(const Scene& scene, int index);

/// Its photograph, resized. @throws InputError if it cannot be read
Image8 resized_photograph(const View& view, ImageSize size);

}  // namespace b3dgs
