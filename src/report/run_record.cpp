#include "report/run_record.h"

#include <algorithm>
#include <fstream>

#include "app/model.h"
#include "core/files/atomic_file.h"
#include "core/files/remove_tree.h"
#include "scene/images/image_io.h"
#include "scene/view_image.h"
#include "train/gaussians/gaussian_model.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr std::size_t kPreviews = 3;
constexpr int kPreviewWidth = 320;  // px

fs::path report_folder(const ModelFolder& folder) {
  return folder.root() / "report";
}

Image8 small(const Image8& image) {
  if (image.width <= kPreviewWidth) return image;
  return resize_image(image, kPreviewWidth, std::max(1, image.height * kPreviewWidth / image.width));
}

/// Views that lie evenly in the list, the first among them.
std::vector<View> choose_views(const std::vector<View>& views) {
  std::vector<View> chosen;
  const std::size_t n = std::min(kPreviews, views.size());
  for (std::size_t i = 0; i < n; ++i) chosen.push_back(views[i * views.size() / n]);
  return chosen;
}

std::vector<Preview> render_previews(Trainer& trainer, const std::vector<View>& views, const ModelFolder& folder) {
  std::vector<Preview> previews;
  const auto on_rendered = [&](std::size_t index, const View& view, const RenderedView& rendered,
                               const ImageQuality& quality) {
    const fs::path truth = report_folder(folder) / ("truth_" + image_name(index));
    const fs::path render = report_folder(folder) / ("render_" + image_name(index));
    write_image(truth, small(*view.image->read()));
    write_image(render, small(to_image8(rendered.color)));
    previews.push_back({view.name, quality.psnr, truth, render});
  };
  trainer.evaluate(choose_views(views), on_rendered);
  return previews;
}

Json to_json(const RunRecord& record) {
  Json previews = Json::array();
  for (const Preview& preview : record.previews) {
    previews.push_back({{"view", preview.view},
                        {"psnr", preview.psnr},
                        {"truth", preview.truth.filename().string()},
                        {"render", preview.render.filename().string()}});
  }
  return {{"iteration", record.iteration}, {"reading_s", record.reading_s}, {"output_s", record.output_s},
          {"machine", record.machine},     {"held_out", record.held_out},   {"previews", previews}};
}

void write_record(const RunRecord& record, const ModelFolder& folder) {
  write_file(report_folder(folder) / "run.json",
             to_json(record).dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

}  // namespace

RunRecord read_run_record(const ModelFolder& folder) {
  std::ifstream file(report_folder(folder) / "run.json");
  const Json json = Json::parse(file, nullptr, /*allow_exceptions=*/false);
  RunRecord record;
  if (!json.is_object()) return record;
  try {
    record.machine = json.value("machine", Json::object());
    record.reading_s = json.value("reading_s", 0.0);
    record.output_s = json.value("output_s", 0.0);
    record.iteration = json.value("iteration", 0);
    record.held_out = json.value("held_out", false);
    for (const Json& preview : json.value("previews", Json::array())) {
      record.previews.push_back({preview.at("view"), preview.value("psnr", 0.0),
                                 report_folder(folder) / preview.at("truth").get<std::string>(),
                                 report_folder(folder) / preview.at("render").get<std::string>()});
    }
  } catch (const nlohmann::json::exception&) {
    return {};
  }
  return record;
}

void record_previews(Trainer& trainer, const Scene& scene, const ModelFolder& folder) {
  RunRecord record = read_run_record(folder);
  record.iteration = trainer.iteration();
  record.held_out = !scene.test.empty();
  record.previews = render_previews(trainer, record.held_out ? scene.test : scene.train, folder);
  write_record(record, folder);
}

void record_session(const SessionRecord& session, Trainer& trainer, const Scene& scene, const ModelFolder& folder) {
  RunRecord record = read_run_record(folder);
  if (record.iteration != trainer.iteration() || record.previews.empty()) {
    record_previews(trainer, scene, folder);
    record = read_run_record(folder);
  }
  record.machine = session.machine;
  record.reading_s += session.reading_s;
  record.output_s += session.result.output_s;
  write_record(record, folder);
}

void remove_run_record(const ModelFolder& folder) {
  remove_tree(report_folder(folder));
}

}  // namespace b3dgs
