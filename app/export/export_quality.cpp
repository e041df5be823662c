#include "app/export/export_quality.h"

#include <algorithm>

#include "app/train_setup.h"
#include "core/check.h"
#include "model/raster_input.h"
#include "scene/images/image_io.h"
#include "scene/view_image.h"
#include "train/quality/metrics.h"

namespace b3dgs {

ExportQuality compare_export(const LoadedModel& model, SplatCloud exported, const std::vector<View>& views,
                             const torch::Device& device, StatusLine& status) {
  const torch::NoGradGuard no_grad;
  LoadedModel after;
  after.config = model.config;
  after.near_plane = model.near_plane;
  after.splats = std::move(exported);
  change_frame(model.splats.frame, after.splats);
  after.splats.antialiased = model.splats.antialiased;  // not every format says so
  status.show(detail::concat("measuring PSNR on ", views.size(), views.size() == 1 ? " view" : " views"), /*now=*/true);
  ModelRenderer before_renderer(model, device), after_renderer(after, device);
  ExportQuality quality;
  const ProgressFn progress = show_loading(status);
  for (std::size_t i = 0; i < views.size() && stop_signal() == 0; ++i) {
    const View& view = views[i];
    const PinholeView pinhole = to_pinhole_view(view.camera);
    const std::shared_ptr<const Image8> photograph = view.image->read();
    const torch::Tensor before = before_renderer.render(pinhole).color, rendered = after_renderer.render(pinhole).color;
    progress("measuring PSNR, view", i + 1, views.size());
    const auto of_before = image_quality(before, *photograph, view.valid.get());
    if (!of_before) continue;  // no valid pixel
    ++quality.n_views;
    quality.psnr_before += of_before->psnr;
    quality.psnr_after += image_quality(rendered, *photograph, view.valid.get())->psnr;
    quality.psnr_between += image_quality(rendered, to_image8(before), view.valid.get())->psnr;
  }
  for (double* mean : {&quality.psnr_before, &quality.psnr_after, &quality.psnr_between}) {
    *mean /= static_cast<double>(std::max<std::size_t>(1, quality.n_views));
  }
  status.clear();
  return quality;
}

}  // namespace b3dgs
