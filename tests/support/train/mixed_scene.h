// A scene whose views differ in size.
#pragma once

#include "support/train/tiny_scene.h"

namespace b3dgs::test {

/// Views of two sizes with masks.
inline Scene make_mixed_scene() {
  TinySceneOptions options;
  options.masked = true;
  options.width = 90;
  options.height = 66;
  Scene scene = make_tiny_scene(options);
  options.width = 61;
  options.height = 50;
  const Scene others = make_tiny_scene(options);
  for (std::size_t i = 0; i < scene.train.size(); i += 2) scene.train[i] = others.train[i];
  return scene;
}

}  // namespace b3dgs::test
