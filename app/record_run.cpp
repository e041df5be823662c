#include "app/record_run.h"

#include <algorithm>
#include <exception>

#include "app/model.h"
#include "core/check.h"
#include "report/page_data.h"
#include "scene/images/image.h"
#include "scene/view_image.h"
#include "train/quality/metrics.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kPreviews = 3;
constexpr int kPreviewWidth = 320;  // px

Image8 small(const Image8& image) {
  if (image.width <= kPreviewWidth) return image;
  return resize_image(image, kPreviewWidth, std::max(1, image.height * kPreviewWidth / image.width));
}

/// The first view and others at equal distances in the list.
std::vector<View> choose_views(const std::vector<View>& views) {
  std::vector<View> chosen;
  const std::size_t n = std::min(kPreviews, views.size());
  for (std::size_t i = 0; i < n; ++i) chosen.push_back(views[i * views.size() / n]);
  return chosen;
}

std::vector<Preview> render_previews(Trainer& trainer, const std::vector<View>& views, const ModelFolder& folder) {
  std::vector<Preview> previews;
  std::exception_ptr fault;  // thrown only after evaluate(), which other ranks take part in
  const auto on_rendered = [&](std::size_t index, const View& view, const RenderedView& rendered,
                               const std::optional<ImageQuality>& quality) {
    if (!quality || fault) return;  // no quality: no valid pixel
    try {
      const fs::path truth = report_folder(folder) / ("truth_" + image_name(index));
      const fs::path render = report_folder(folder) / ("render_" + image_name(index));
      write_image(truth, small(*view.image->read()));
      write_image(render, small(to_image8(rendered.color)));
      previews.push_back({view.name, quality->psnr, truth, render});
    } catch (const IoError&) {
      fault = std::current_exception();
    }
  };
  trainer.evaluate(choose_views(views), on_rendered);
  if (fault) std::rethrow_exception(fault);
  return previews;
}

const std::vector<View>& previewed_views(const Scene& scene) {
  return scene.test.empty() ? scene.train : scene.test;
}

}  // namespace

void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder, Communicator* ranks) {
  if (ranks != nullptr && !ranks->is_first()) {
    trainer.evaluate(choose_views(previewed_views(scene)));
    return;
  }
  RunInfo record = read_run_info(folder);
  record.iteration = trainer.iteration();
  record.held_out = !scene.test.empty();
  record.previews = render_previews(trainer, previewed_views(scene), folder);
  write_run_info(record, folder);
}

void record_session(const SessionRecord& session, Trainer& trainer, const Scene& scene, const ModelFolder& folder,
                    Communicator* ranks) {
  const bool is_first = ranks == nullptr || ranks->is_first();
  RunInfo record;
  if (is_first) record = read_run_info(folder);
  bool lacks_previews = is_first && (record.iteration != trainer.iteration() || record.previews.empty());
  if (ranks != nullptr) lacks_previews = ranks->max("previews", lacks_previews ? 1 : 0) > 0;
  if (lacks_previews) record_previews(trainer, scene, folder, ranks);
  if (!is_first) return;
  if (lacks_previews) record = read_run_info(folder);
  record.machine = session.machine;
  record.reading_s += session.reading_s;
  record.output_s += session.result.output_s;
  write_run_info(record, folder);
}

}  // namespace b3dgs
