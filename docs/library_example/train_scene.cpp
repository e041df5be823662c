// Trains a scene for 100 steps and saves the Gaussians: train_scene SCENE MODEL
#include <iostream>

#include "scene/scene.h"
#include "train/scene_limits.h"
#include "train/trainer.h"

int main(int argc, char** argv) try {
  if (argc != 3) throw b3dgs::InputError("usage: train_scene SCENE MODEL");
  b3dgs::TrainConfig config;
  config.source_path = argv[1];
  config.model_path = argv[2];
  config.resolution = 4;  // a quarter of the photographs' width and height
  config.iterations = 100;
  config.device = "cpu";  // or "cuda"

  const b3dgs::Scene scene = b3dgs::load_scene(b3dgs::scene_options(config));
  const b3dgs::ModelFolder folder(config.model_path);
  b3dgs::Trainer trainer(b3dgs::finalize(config, scene), scene, folder, {});
  trainer.run();
  std::cout << trainer.n_gaussians() << " Gaussians: " << folder.ply(config.iterations).string() << "\n";
} catch (const std::exception& error) {
  std::cerr << "error: " << error.what() << "\n";
  return 1;
}
