#include "train/train_views.h"

#include "check.h"
#include "train/evaluate.h"
#include "train/loss.h"

namespace b3dgs {
namespace {

torch::Tensor upload(const Image8& image, torch::IntArrayRef sizes, torch::Device device) {
  // from_blob wants a pointer that it could write through; nothing does.
  auto* pixels = const_cast<std::uint8_t*>(image.pixels.data());
  return torch::from_blob(pixels, sizes, torch::kUInt8).to(device);
}

}  // namespace

std::vector<TrainView> upload_views(const std::vector<View>& views, torch::Device device) {
  std::vector<TrainView> uploaded;
  for (const View& view : views) {
    const int width = view.camera.width, height = view.camera.height;
    B3DGS_CHECK(view.image && view.image->channels == 3 && view.image->width == width && view.image->height == height,
                "view ", view.name, " has no RGB image of its camera's size, ", width, " x ", height);
    TrainView own;
    own.name = view.name;
    own.camera = to_pinhole_view(view.camera);
    own.truth = upload(*view.image, {height, width, 3}, device);
    own.n_valid = static_cast<std::int64_t>(width) * height;
    if (view.valid) {
      B3DGS_CHECK(view.valid->width == width && view.valid->height == height, "the mask of view ", view.name,
                  " has another size than its image");
      own.valid = upload(*view.valid, {height, width}, device);
      own.n_valid = count_valid(view.valid->pixels.data(), own.n_valid);
    }
    uploaded.push_back(std::move(own));
  }
  return uploaded;
}

}  // namespace b3dgs
