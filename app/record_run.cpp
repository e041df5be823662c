#include "app/record_run.h"

#include <torch/version.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <fstream>
#include <regex>
#include <thread>

#include "app/model.h"
#include "core/check.h"
#include "core/version.h"
#include "report/page_data.h"
#include "scene/images/image.h"
#include "scene/view_image.h"
#include "train/device.h"
#include "train/quality/metrics.h"
#if B3DGS_HAS_CUDA
#include <cuda_runtime.h>
#endif

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

/// Returns the first "model name" in /proc/cpuinfo, or "" if there is none.
#if B3DGS_HAS_CUDA
/// Returns the version of the kernel module, "570.86.15", or "" if unknown.
std::string driver_version() {
  std::ifstream file("/proc/driver/nvidia/version");
  std::string line;
  std::smatch match;
  std::getline(file, line);
  line.resize(std::min<std::size_t>(line.size(), 256));  // std::regex recurses for each character
  return std::regex_search(line, match, std::regex(R"(\b\d{3,}\.\d+(\.\d+)?\b)")) ? match.str() : "";
}

std::string cuda_version(int version) {
  return std::to_string(version / 1000) + "." + std::to_string(version % 1000 / 10);
}

void describe_gpu(nlohmann::ordered_json& machine) {
  cudaDeviceProp properties{};
  if (cudaGetDeviceProperties(&properties, 0) == cudaSuccess) {
    machine["gpu"] = properties.name;
    machine["gpu_memory_gb"] = std::round(static_cast<double>(properties.totalGlobalMem) / 1e9);
  }
  if (const std::string driver = driver_version(); !driver.empty()) machine["driver"] = driver;
  int version = 0;
  if (cudaRuntimeGetVersion(&version) == cudaSuccess && version > 0) machine["cuda"] = cuda_version(version);
}
#endif

}  // namespace

nlohmann::ordered_json describe_machine(const torch::Device& device) {
  nlohmann::ordered_json machine;
  machine["program"] = std::string("b3dgs ") + version();
  machine["cpu"] = device_model(torch::kCPU);
  machine["cores"] = std::thread::hardware_concurrency();
  const long pages = sysconf(_SC_PHYS_PAGES), page_bytes = sysconf(_SC_PAGESIZE);
  if (pages > 0 && page_bytes > 0) {
    machine["memory_gb"] = std::round(static_cast<double>(pages) * static_cast<double>(page_bytes) / 1e9);
  }
  machine["libtorch"] = TORCH_VERSION;
  machine["device"] = device_name(device);
#if B3DGS_HAS_CUDA
  if (device.is_cuda()) describe_gpu(machine);
#endif
  return machine;
}

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
