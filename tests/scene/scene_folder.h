// A temporary folder with a scene of small photographs, for tests of loading scenes.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <initializer_list>
#include <string>

#include "core/check.h"
#include "scene/scene.h"
#include "support/expect_error.h"
#include "support/temp_dir.h"

namespace b3dgs::test {

constexpr int kWidth = 40, kHeight = 30;  // size of a photograph

/// Returns an image of one value.
inline Image8 flat(int width, int height, int channels, int value) {
  Image8 image(width, height, channels);
  std::fill(image.pixels.begin(), image.pixels.end(), static_cast<std::uint8_t>(value));
  return image;
}

class SceneFolder : public testing::Test {
 protected:
  SceneFolder() { options_.source_path = folder_.path().string(); }

  Scene load() {
    options_.frame = CoordinateFrame{};  // coordinates are compared with those of the files
    return load_scene(options_);
  }
  testing::AssertionResult refuses(std::initializer_list<std::string> parts) {
    return fails_with<InputError>(parts, [this] { load(); });
  }
  static testing::AssertionResult says(const Scene& scene, const std::string& part) {
    std::string all;
    for (const std::string& text : scene.summary) all += text + "\n";
    if (all.find(part) != std::string::npos) return testing::AssertionSuccess();
    return testing::AssertionFailure() << "\"" << part << "\" is not in\n" << all;
  }

  TempDir folder_;
  SceneOptions options_;
};

}  // namespace b3dgs::test
