#include "app/train/session_record.h"

#include <algorithm>
#include <exception>

#include "app/common/torch/model.h"
#include "app/report/page_data.h"
#include "core/check.h"
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

std::vector<Preview> render_previews(Trainer& trainer, const std::vector<View>& views, const ModelFolder& folder) {
  std::vector<Preview> previews;
  std::exception_ptr fault;  // thrown only after evaluate(), which other ranks also call
  const auto on_rendered = [&](std::size_t index, const View& view, const RenderedView& rendered,
                               const std::optional<ImageQuality>& quality) {
    if (!quality || fault) return;  // no quality: no valid pixel
    const fs::path truth = report_folder(folder) / ("truth_" + image_name(index));
    const fs::path render = report_folder(folder) / ("render_" + image_name(index));
    try {
      write_image(truth, small(*view.image->read()));
      write_image(render, small(to_image8(rendered.color)));
      previews.push_back({view.name, quality->psnr, truth, render});
    } catch (const IoError&) {
      fault = std::current_exception();
    }
  };
  trainer.evaluate(views, on_rendered);
  if (fault) std::rethrow_exception(fault);
  return previews;
}

}  // namespace

void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder, Communicator& ranks) {
  const std::vector<View> views = evenly_spaced(scene.test.empty() ? scene.train : scene.test, kPreviews);
  if (!ranks.is_first()) {
    trainer.evaluate(views);
    return;
  }
  RunInfo record = read_run_info(folder);
  record.iteration = trainer.iteration();
  record.held_out = !scene.test.empty();
  record.previews = render_previews(trainer, views, folder);
  write_run_info(record, folder);
}

void record_session(const nlohmann::ordered_json& machine, double reading_s, double output_s, Trainer& trainer,
                    const Scene& scene, const ModelFolder& folder, Communicator& ranks) {
  RunInfo record;
  if (ranks.is_first()) record = read_run_info(folder);
  const bool has_previews = record.iteration == trainer.iteration() && !record.previews.empty();
  if (ranks.max("previews", ranks.is_first() && !has_previews ? 1 : 0) > 0) {
    record_previews(trainer, scene, folder, ranks);
    if (ranks.is_first()) record = read_run_info(folder);
  }
  if (!ranks.is_first()) return;
  record.machine = machine;
  record.reading_s += reading_s;
  record.output_s += output_s;
  write_run_info(record, folder);
}

}  // namespace b3dgs
