// Compares training on the GPU with training on the CPU and with itself.
#include <cuda_runtime_api.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <numeric>

#include <nlohmann/json.hpp>

#include "model/raster_input.h"
#include "raster/cuda/passes.h"
#include "raster/torch/torch_cuda.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/gpu_test.h"
#include "support/run_program.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/disk_scene.h"
#include "support/train/short_memory.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/checkpoint/checkpoint.h"
#include "train/density/row_edit.h"
#include "train/density/strategies/strategies.h"
#include "train/gaussians/gaussian_model.h"
#include "train/images/image_store.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::train;
using test::Trained;

TrainConfig on_gpu(TrainConfig config) {
  config.device = "cuda";
  return config;
}

/// Returns a config of a deterministic training with density control and an opacity reset.
TrainConfig deterministic_config() {
  TrainConfig config = on_gpu(test::eventful_config());
  config.iterations = 40;
  config.deterministic = true;
  return config;
}

TEST(FloatersOnGpu, AreThoseOfTheCpu) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  GaussianTensors gaussians = to_tensors(splats_from_points(scene.points, 0), 0, torch::kCPU);
  gaussians.means[0] = torch::tensor({1000.0f, 0.0f, 0.0f});  // visible in no view
  std::vector<CameraView> views;
  for (const View& view : scene.train) views.push_back(to_camera_view(view.camera));
  Rasterizer on_cpu(torch::kCPU), on_gpu(torch::Device(torch::kCUDA, 0));
  const FloaterCount expected = count_floaters(on_cpu, gaussians, views, RenderSettings{});
  for (torch::Tensor* tensor : gaussians.all()) *tensor = tensor->cuda();
  const FloaterCount found = count_floaters(on_gpu, gaussians, views, RenderSettings{});
  EXPECT_GE(expected.unseen, 1);
  EXPECT_EQ(found.unseen, expected.unseen);
  EXPECT_EQ(found.one_view, expected.one_view);
  EXPECT_EQ(found.close, expected.close);
  EXPECT_EQ(found.large, expected.large);
}

TEST(TrainerOnGpu, LearnsAsOnTheCpu) {
  B3DGS_NEEDS_GPU();
  // In dB, for the mean over the held-out views. Another order of sums (tiles, culling, kernels on the CPU) changes it
  // by 0.01.
  constexpr double kAllowed = 0.1;
  const Scene scene = test::make_tiny_scene(test::learnable_scene());
  const test::TempDir temp;
  TrainConfig config;
  config.iterations = 300;
  config.densify_from_iter = 100;
  const Trained cpu = train(config, scene, temp / "cpu"), gpu = train(on_gpu(config), scene, temp / "gpu");
  const double expected = cpu.result.evaluations.back().second.mean.psnr;
  EXPECT_GT(expected, 20);
  EXPECT_NEAR(gpu.result.evaluations.back().second.mean.psnr, expected, kAllowed);
  EXPECT_NEAR(static_cast<double>(gpu.result.n_gaussians), static_cast<double>(cpu.result.n_gaussians),
              0.02 * static_cast<double>(cpu.result.n_gaussians));
}

TEST(TrainerOnGpu, GivesTheSameBytesTwiceIfDeterministic) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  const Trained first = train(config, scene, temp / "a"), second = train(config, scene, temp / "b");
  EXPECT_GT(first.result.n_gaussians, 150) << "no density control happened";
  EXPECT_TRUE(test::same(first.ply, second.ply));

  config.kernel = "naive";
  EXPECT_TRUE(test::fails_with<InputError>({"--kernel naive", "sub-tile"}, [&] { train(config, scene, temp / "c"); }));
}

/// Returns whether `segmented` cuts lists of a view in the log.
bool has_cut_lists(const fs::path& folder) {
  int n_multiprocessors = 0;
  B3DGS_CUDA_CHECK(cudaDeviceGetAttribute(&n_multiprocessors, cudaDevAttrMultiProcessorCount, 0));
  std::ifstream file(folder / "train.jsonl");
  for (std::string line; std::getline(file, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (json.value("event", "") != "load_statistics") continue;
    const nlohmann::json& lists = json.at("tile_lists");
    const auto bins = lists.at("log2_bins").get<std::vector<std::int64_t>>();
    cuda::ViewCounts counts{};
    counts.longest_list = lists.at("max").get<std::int64_t>();
    counts.n_pairs = std::llround(lists.at("mean").get<double>() *
                                  static_cast<double>(std::accumulate(bins.begin(), bins.end(), std::int64_t{0})));
    if (cuda::list_cut(counts, n_multiprocessors).cuts()) return true;
  }
  return false;
}

TEST(TrainerOnGpu, LongTrainingWithCutListsGivesTheSameBytesTwiceIfDeterministic) {
  B3DGS_NEEDS_GPU();
  test::TinySceneOptions options;
  options.n_gaussians = 12000;
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  config.kernel = "segmented";
  config.iterations = 2000;
  config.densification_interval = 50;
  config.densify_until_iter = 1000;
  config.opacity_reset_interval = 300;
  config.max_gaussians = 40000;
  config.stats_interval = 500;
  const Trained first = train(config, scene, temp / "a"), second = train(config, scene, temp / "b");
  EXPECT_TRUE(has_cut_lists(temp / "a"));
  EXPECT_TRUE(test::same(first.ply, second.ply));
  EXPECT_TRUE(test::same(first.checkpoint, second.checkpoint));
}

TEST(TrainerOnGpu, ResumedEqualsUninterruptedIfDeterministic) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  config.image_cache_gb = 0;
  const Trained whole = train(config, scene, temp / "whole");
  for (const int stop : {10, 13}) {  // at a round of density control, and between two rounds
    const fs::path folder = temp / std::to_string(stop);
    config.iterations = stop;
    const fs::path checkpoint = train(config, scene, folder).result.checkpoint;
    config.iterations = 40;
    EXPECT_TRUE(test::same(train(config, scene, folder, checkpoint).ply, whole.ply)) << "stopped at " << stop;
  }
}

/// Returns the running average of the loss after each step.
std::vector<double> losses(const TrainConfig& config, const Scene& scene, const fs::path& folder) {
  remove_tree(folder);
  std::vector<double> values;
  TrainHooks hooks;
  hooks.on_progress = [&](const TrainProgress& progress) { values.push_back(progress.loss); };
  Trainer(finalize(config, scene), scene, ModelFolder(folder), hooks).run();
  return values;
}

TEST(TrainerOnGpu, LearnsTheSameFromPhotographsThatAreUploadedAhead) {
  B3DGS_NEEDS_GPU();
  test::TinySceneOptions options;
  options.masked = true;  // masks are used, too
  const Scene scene = test::make_tiny_scene(options);
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  const std::vector<double> resident = losses(config, scene, temp / "resident");
  ASSERT_FALSE(resident.empty());
  for (const double gb : {0.0, 30e-6}) {  // none fits; the first three fit
    config.image_cache_gb = gb;
    EXPECT_EQ(losses(config, scene, temp / "streamed"), resident) << gb << " GB";
  }
}

TEST(TrainerOnGpu, LearnsTheSameFromPhotographsThatAreReadFromDisk) {
  B3DGS_NEEDS_GPU();
  const test::DiskScene disk(/*distorted=*/true);
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  const std::vector<double> resident = losses(config, disk.load(), temp / "resident");
  ASSERT_FALSE(resident.empty());
  for (const double photographs : {0.0, 1.0, 5.0, 100.0}) {
    for (const double gb : {0.0, 30e-6}) {
      SCOPED_TRACE(std::to_string(photographs) + " in memory, GB on the GPU: " + std::to_string(gb));
      const Scene scene = disk.load(photographs);
      config.image_cache_gb = gb;
      EXPECT_EQ(losses(config, scene, temp / "streamed"), resident);
      const ImageMemory& memory = *scene.train.front().image->memory();
      EXPECT_LE(memory.peak(), std::max(memory.limit(), memory.fixed() + 2 * disk.image_bytes()));
    }
  }
}

TEST(TrainerOnGpu, KeepsNoHostCopyOfAPhotographThatIsOnTheGpu) {
  B3DGS_NEEDS_GPU();
  const test::DiskScene disk;
  const Scene scene = disk.load();
  const ImageStore store(scene.train, torch::Device(torch::kCUDA, 0), 3 * disk.image_bytes());
  EXPECT_EQ(store.places().on_device.count, 3);
  EXPECT_EQ(store.places().in_memory.count, 4);
  for (std::size_t i = 0; i < scene.train.size(); ++i) EXPECT_EQ(scene.train[i].image->held() == nullptr, i < 3) << i;
}

TEST(TrainerOnGpu, ReleasesPhotographsWhenMemoryIsNeeded) {
  B3DGS_NEEDS_GPU();
  const test::DiskScene disk;
  const torch::Device device(torch::kCUDA, 0);
  for (const double photographs : {0.0, 100.0}) {
    SCOPED_TRACE(std::to_string(photographs) + " in memory");
    const Scene whole = disk.load(), scene = disk.load(photographs);
    ImageStore store(scene.train, device, 1 << 30);
    ASSERT_EQ(store.n_resident(), 7);
    const auto expect_view = [&](const TrainView& view, std::int32_t i) {
      const auto expected = whole.train[static_cast<std::size_t>(i)].image->read();
      const torch::Tensor host = view.truth.to(torch::kCPU);
      EXPECT_TRUE(std::equal(expected->pixels.begin(), expected->pixels.end(), host.data_ptr<std::uint8_t>())) << i;
    };
    EXPECT_EQ(store.release_resident(0), 0);
    EXPECT_EQ(store.release_resident(2 * disk.image_bytes() - 1), 2 * disk.image_bytes());
    EXPECT_EQ(store.n_resident(), 5);
    EXPECT_EQ(store.places().in_memory.count, photographs > 0 ? 2 : 0);
    for (const std::int32_t i : {6, 0, 5, 6, 4}) expect_view(store.take(i, {5, 1}), i);
    const TrainView last = store.take(6, {});
    EXPECT_EQ(store.release_resident(1 << 30), 5 * disk.image_bytes());
    expect_view(last, 6);  // still there
    EXPECT_EQ(store.n_resident(), 0);
    for (const std::int32_t i : {3, 2, 6, 0, 0, 1}) expect_view(store.take(i, {2, 6, 0}), i);
    EXPECT_EQ(store.release_resident(1), 0);
  }
}

/// Allocates all free GPU memory.
class FullGpu {
 public:
  FullGpu() {
    for (std::size_t bytes = std::size_t{1} << 36; bytes >= 256; bytes /= 2) {
      for (void* block = nullptr; cudaMalloc(&block, bytes) == cudaSuccess;) blocks_.push_back(block);
    }
    cudaGetLastError();
  }
  ~FullGpu() {
    for (void* block : blocks_) cudaFree(block);
  }

 private:
  std::vector<void*> blocks_;
};

TEST(FullGpuRunsAlone, KeepsPhotographsWithoutMemoryToUploadThemAgain) {
  B3DGS_NEEDS_GPU();
  const test::DiskScene disk;
  const Scene scene = disk.load();
  ImageStore store(scene.train, torch::Device(torch::kCUDA, 0), 1 << 30);
  {
    release_unused_torch_memory();
    const FullGpu full;
    EXPECT_EQ(store.release_resident(1), 0);
    EXPECT_EQ(store.n_resident(), 7);
    const auto expected = scene.train[6].image->read();
    const torch::Tensor host = store.take(6, {}).truth.to(torch::kCPU);
    EXPECT_TRUE(std::equal(expected->pixels.begin(), expected->pixels.end(), host.data_ptr<std::uint8_t>()));
  }
  EXPECT_EQ(store.release_resident(1), disk.image_bytes());
}

TEST(TrainerOnGpu, KeepsWithinTheBudgetOfItsPhotographs) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();  // 6 views of 60 x 44 x 3 bytes
  const torch::Device device(torch::kCUDA, 0);
  EXPECT_EQ(ImageStore(scene.train, device, 0).n_resident(), 0);
  EXPECT_EQ(ImageStore(scene.train, device, 3 * 7920).n_resident(), 3);
  EXPECT_EQ(ImageStore(scene.train, device, 3 * 7920 - 1).n_resident(), 2);
  EXPECT_EQ(ImageStore(scene.train, device, 1 << 30).n_resident(), 6);
  EXPECT_GT(image_budget(-1, device), 100 << 20);
  ImageStore store(scene.train, device, 2 * 7920);
  for (const std::int32_t i : {5, 0, 3, 3, 2, 4, 1, 5}) {
    const TrainView view = store.take(i, {4, 2});
    const Image8& expected = *scene.train[static_cast<std::size_t>(i)].image->held();
    const torch::Tensor host = view.truth.to(torch::kCPU);
    EXPECT_TRUE(std::equal(expected.pixels.begin(), expected.pixels.end(), host.data_ptr<std::uint8_t>())) << i;
    EXPECT_FALSE(view.valid.defined());
  }
}

void expect_same_state(const TrainState& a, const TrainState& b) {
  const auto same = [](const auto& x, const auto& y) {
    ASSERT_EQ(x.all().size(), y.all().size());
    for (std::size_t i = 0; i < x.all().size(); ++i) {
      EXPECT_TRUE(test::same(x.all()[i]->to(torch::kCPU), y.all()[i]->to(torch::kCPU))) << "tensor " << i;
    }
  };
  same(a.gaussians, b.gaussians);
  same(a.adam.m, b.adam.m);
  same(a.adam.v, b.adam.v);
  same(a.statistics, b.statistics);
  EXPECT_EQ(a.iteration, b.iteration);
  EXPECT_EQ(a.view_order.remaining, b.view_order.remaining);
  EXPECT_EQ(a.elapsed_s, b.elapsed_s);
}

TEST(TrainerOnGpu, ResumesFromACheckpointOfTheOtherDevice) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const torch::Device gpu(torch::kCUDA, 0);
  for (const bool starts_on_gpu : {false, true}) {
    SCOPED_TRACE(starts_on_gpu ? "from the GPU" : "from the CPU");
    const std::string name = starts_on_gpu ? "gpu" : "cpu";
    TrainConfig config = test::eventful_config(), gpu_config = on_gpu(config);
    config.iterations = gpu_config.iterations = 12;
    const fs::path checkpoint = train(starts_on_gpu ? gpu_config : config, scene, temp / name).result.checkpoint;
    expect_same_state(read_checkpoint(checkpoint, scene, torch::kCPU).state,
                      read_checkpoint(checkpoint, scene, gpu).state);
    // Takes one more step from the same state, with the same view and background. First moments are sums of gradients.
    config.iterations = gpu_config.iterations = 13;
    const Trained on_cpu = train(config, scene, temp / (name + "_then_cpu"), checkpoint);
    const Trained on_device = train(gpu_config, scene, temp / (name + "_then_gpu"), checkpoint);
    const TrainState a = read_checkpoint(on_cpu.result.checkpoint, scene, torch::kCPU).state;
    const TrainState b = read_checkpoint(on_device.result.checkpoint, scene, torch::kCPU).state;
    EXPECT_EQ(a.view_order.remaining, b.view_order.remaining);
    EXPECT_NEAR(a.loss_average, b.loss_average, 1e-4);
    for (std::size_t i = 0; i < a.adam.m.all().size(); ++i) {
      const torch::Tensor expected = *a.adam.m.all()[i];
      EXPECT_TRUE(test::within(*b.adam.m.all()[i], expected, 5e-3 * expected.abs().max().item<double>() + 1e-12))
          << GaussianTensors::kNames[i];
    }
  }
}

/// Returns hooks that count steps and rounds of density control, and check the times of each step.
TrainHooks stage_time_checks(bool has_projection_backward, int& n_steps, int& n_rounds) {
  TrainHooks hooks;
  hooks.on_stage_times = [has_projection_backward, &n_steps, &n_rounds](const StageTimes& times) {
    if (times.kind == StageTimes::Kind::kDensityRound) {
      ++n_rounds;
      return;
    }
    ++n_steps;
    double sum = 0;
    for (std::size_t i = 0; i < kStageCount; ++i) {
      if (i == static_cast<std::size_t>(Stage::kProjectBackward) && !has_projection_backward) {
        EXPECT_FALSE(times.ms[i]) << "part of the optimizer's kernel";
        continue;
      }
      ASSERT_TRUE(times.ms[i]) << kStageNames[i];
      EXPECT_GE(*times.ms[i], 0) << kStageNames[i];
      sum += *times.ms[i];
    }
    EXPECT_LE(sum, times.wall_ms + 0.01 * kStageCount) << "events have a resolution of half a microsecond";
  };
  return hooks;
}

TEST(TrainerOnGpu, TimesAllStages) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  config.deterministic = false;
  int n_steps = 0, n_rounds = 0;
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "timed"),
                  stage_time_checks(false, n_steps, n_rounds));
  trainer.run();
  trainer.wait();
  EXPECT_EQ(n_steps, config.iterations);
  EXPECT_GT(n_rounds, 0);
}

TEST(TrainerOnGpu, LearnsTheSameWhileStagesAreTimed) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const TrainConfig config = deterministic_config();
  int n_steps = 0, n_rounds = 0;
  // With --deterministic, a view's gradients are kept before the optimizer's kernel sums them.
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "timed"),
                  stage_time_checks(true, n_steps, n_rounds));
  const TrainResult timed = trainer.run();
  trainer.wait();
  EXPECT_EQ(n_steps, config.iterations);
  EXPECT_GT(n_rounds, 0);
  EXPECT_TRUE(test::same(test::read_bytes(timed.ply), train(config, scene, temp / "untimed").ply));
}

/// Returns a scene with views of 60 x 44 and of 48 x 64 px.
Scene scene_of_two_sizes() {
  test::TinySceneOptions upright;
  upright.width = 48;
  upright.height = 64;
  Scene scene = test::make_tiny_scene(), other = test::make_tiny_scene(upright);
  for (View& view : other.train) {
    view.name = "upright_" + view.name;
    scene.train.push_back(view);
  }
  return scene;
}

TEST(TrainerOnGpu, StepsAskForNoMemoryOnceSizesAreSteady) {
  B3DGS_NEEDS_GPU();
  const Scene scene = scene_of_two_sizes();
  const test::TempDir temp;
  TrainConfig config = on_gpu(TrainConfig{});
  config.densify_until_iter = 0;
  config.kernel = "segmented";
  config.position_lr_init = config.position_lr_final = config.scaling_lr = config.opacity_lr = config.rotation_lr = 0;
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {});
  trainer.run(30);
  const MemoryUse before = torch_memory_use();
  trainer.run(90);
  const MemoryUse after = torch_memory_use();
  EXPECT_EQ(after.n_requests, before.n_requests);
  EXPECT_EQ(after.reserved, before.reserved);
  EXPECT_EQ(after.in_use, before.in_use);
}

TEST(TrainerOnGpu, CheckpointsWrittenInTheBackgroundAreThoseOfTheirIterations) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  config.keep_checkpoints = 99;
  const Trained whole = train(config, scene, temp / "whole");
  const ModelFolder beside(temp / "beside"), paused(temp / "paused");
  config.checkpoint_interval = 3;
  config.save_iterations = {7, 22};
  EXPECT_TRUE(test::same(train(config, scene, beside.root()).ply, whole.ply)) << "writing changed the training";
  const std::vector<int> written = beside.checkpoint_iterations();
  ASSERT_EQ(written.size(), 14u);
  config.checkpoint_interval = 0;
  Trainer trainer(finalize(config, scene), scene, paused, {});
  for (const int iteration : written) {
    if (iteration == config.iterations) continue;
    trainer.run(iteration);
    trainer.write_checkpoint();
    const CheckpointFile a = read_checkpoint_file(beside.checkpoint(iteration));
    const CheckpointFile b = read_checkpoint_file(paused.checkpoint(iteration));
    ASSERT_EQ(a.tensors.size(), b.tensors.size());
    for (std::size_t i = 0; i < a.tensors.size(); ++i) {
      EXPECT_TRUE(test::same(a.tensors[i].second, b.tensors[i].second)) << iteration << ", " << a.tensors[i].first;
    }
  }
  for (const int iteration : config.save_iterations) {
    EXPECT_TRUE(test::same(test::read_bytes(beside.ply(iteration)), test::read_bytes(paused.ply(iteration))))
        << iteration;
  }
}

TEST(TrainerOnGpu, ContinuesWithoutGaussiansThatCannotBeRendered) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  config.iterations = 8;
  const fs::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  Checkpoint read = read_checkpoint(checkpoint, scene, torch::kCPU);
  read.state.gaussians.means[3][1] = NAN;
  read.state.gaussians.log_scales[9].fill_(60);
  write_checkpoint(checkpoint, read.config, read.state, scene);
  config.iterations = 40;
  config.checkpoint_iterations = {8, 30};
  config.keep_checkpoints = 9;
  const Trained run = train(config, scene, temp / "model", checkpoint);
  EXPECT_EQ(run.result.n_removed, 2);
  EXPECT_EQ(run.result.iteration, 40);
  const fs::path later = ModelFolder(temp / "model").checkpoint(30);
  EXPECT_TRUE(test::same(train(config, scene, temp / "model", later).ply, run.ply)) << "resumed after that";
}

TEST(TrainerOnGpu, ContinuesWithoutAGaussianOfWhichOnlyTheColorIsNotANumber) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  config.sh_increase_interval = 2;
  config.iterations = 8;
  const fs::path checkpoint = train(config, scene, temp / "model").result.checkpoint;
  Checkpoint read = read_checkpoint(checkpoint, scene, torch::kCPU);
  read.state.gaussians.shN[3].fill_(NAN);
  write_checkpoint(checkpoint, read.config, read.state, scene);
  config.iterations = 20;
  const Trained run = train(config, scene, temp / "model", checkpoint);
  EXPECT_EQ(run.result.n_removed, 1);
  EXPECT_EQ(run.result.iteration, 20);
}

TEST(TrainerOnGpu, CapsTheCountAndTrainsToTheEndWhereMemoryIsShort) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  auto memory = std::make_shared<test::ShortMemory>();
  memory->bytes = 200000;
  TrainHooks hooks;
  hooks.memory = memory;
  const Trained held = train(deterministic_config(), scene, temp / "capped", {}, hooks);
  const Trained again = train(deterministic_config(), scene, temp / "again", {}, hooks);
  EXPECT_TRUE(test::same(held.ply, again.ply));
  EXPECT_EQ(held.result.iteration, 40);
  EXPECT_GT(read_checkpoint_header(held.result.checkpoint).value("count_cap", 0), 0);
  EXPECT_LT(held.result.n_gaussians, train(deterministic_config(), scene, temp / "free").result.n_gaussians);
}

TEST(TrainerOnGpu, CountsTheMemoryThatItTakes) {
  B3DGS_NEEDS_GPU();
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  TrainConfig config = deterministic_config();
  Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), {});
  const std::optional<MemoryForecast> forecast = trainer.forecast_memory();
  ASSERT_TRUE(forecast);
  constexpr std::int64_t kFloats = 3 + 3 + 4 + 1 + 3 + 9;  // per Gaussian of SH degree 1
  const std::int64_t least = static_cast<std::int64_t>(scene.points.size()) * 3 * kFloats * 4;  // with its moments
  EXPECT_GE(forecast->model, least);
  EXPECT_LT(forecast->model, 10 * least);
  std::int64_t photograph_bytes = 0;
  for (const View& view : scene.train) photograph_bytes += 3 * view.camera.width * view.camera.height;
  EXPECT_GE(forecast->photographs, photograph_bytes);
  EXPECT_GT(forecast->largest_count, 100000);
  EXPECT_LE(forecast->limit, device_memory_size().total);
  const TrainResult result = trainer.run();
  EXPECT_GE(result.peak_memory_bytes, forecast->photographs + least);
  const std::string log = test::read_bytes(temp / "model" / "train.jsonl"), key = "\"gpu_peak_bytes\":";
  const std::size_t at = log.rfind(key);
  ASSERT_NE(at, std::string::npos);
  const std::int64_t logged = std::stoll(log.substr(at + key.size()));
  EXPECT_GE(logged, forecast->photographs + least);
  EXPECT_LE(logged, result.peak_memory_bytes);
}

TEST(TrainerOnGpu, TakesNoMoreThanItIsAllowed) {
  B3DGS_NEEDS_GPU();
  torch::zeros({1}, torch::kCUDA);
  release_unused_torch_memory();
  limit_torch_memory(torch_memory_use().reserved + (64 << 20));
  EXPECT_THROW(allocate_tensor({100 << 20}, torch::TensorOptions(torch::kCUDA)), OutOfMemoryError);
  EXPECT_NO_THROW(allocate_tensor({1 << 20}, torch::TensorOptions(torch::kCUDA)));
  limit_torch_memory(0);
  EXPECT_NO_THROW(allocate_tensor({100 << 20}, torch::TensorOptions(torch::kCUDA)));
}

/// Trains until the GPU fails in iteration 8. Returns 0 if training ended with one line that names the checkpoint of
/// iteration 5, and that checkpoint can be read.
int train_until_the_gpu_is_lost() {
  const Scene scene = test::make_tiny_scene();
  const test::TempDir temp;
  const ModelFolder folder(temp / "model");
  TrainConfig config = deterministic_config();
  config.checkpoint_iterations = {5};
  TrainHooks hooks;
  hooks.on_progress = [](const TrainProgress& progress) {
    if (progress.iteration != 8) return;
    // Triggers a device-side assertion, after which every CUDA call of the process fails.
    const auto on_gpu = torch::TensorOptions(torch::kCUDA).dtype(torch::kInt64);
    torch::arange(4, on_gpu).index_select(0, torch::full({1}, 9, on_gpu));
  };
  try {
    Trainer(finalize(config, scene), scene, folder, hooks).run();
  } catch (const std::exception& error) {
    const std::string message = error.what();
    std::fprintf(stderr, "%s\n", message.c_str());
    if (message.find("iteration_5.b3dgs") == std::string::npos || message.find('\n') != std::string::npos) return 1;
    return read_checkpoint_header(folder.checkpoint(5))["iteration"] == 5 ? 0 : 2;
  }
  return 3;
}

/// Runs in a separate process, because no CUDA call succeeds afterwards. This is not a death test of GoogleTest, which
/// clones the process and crashed once it had used the GPU.
TEST(LostGpu, DISABLED_TrainingEnds) {
  std::_Exit(train_until_the_gpu_is_lost());
}

TEST(TrainerOnGpu, ALostGpuNamesTheLastCheckpoint) {
  B3DGS_NEEDS_GPU();
  test::RunOptions options;
  options.program = std::filesystem::read_symlink("/proc/self/exe").string();
  const test::Outcome outcome =
      test::run_b3dgs({"--gtest_filter=LostGpu.*", "--gtest_also_run_disabled_tests"}, options);
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
}

TEST(RowEditorOnGpu, DoesWhatTheCpuDoes) {
  B3DGS_NEEDS_GPU();
  constexpr std::int64_t kRows = 700000;  // 31 M SH coefficients, in pieces of 16 M
  const auto edited = [](torch::Device device) {
    const torch::Tensor number = torch::arange(kRows, device).to(torch::kFloat32);
    const auto numbered = [&](std::vector<std::int64_t> sizes) {
      std::vector<std::int64_t> column(sizes.size(), 1);
      column[0] = kRows;
      return number.view(column).expand(sizes).contiguous();
    };
    TrainState state;
    state.gaussians = {numbered({kRows, 3}), numbered({kRows, 3}),    numbered({kRows, 4}),
                       numbered({kRows}),    numbered({kRows, 1, 3}), numbered({kRows, 15, 3})};
    state.adam = make_adam_state(state.gaussians);
    state.statistics = make_density_statistics(kRows, device);
    state.statistics.view_count.add_(2);
    RowEditor editor;
    for (int round = 0; round < 3; ++round) {  // the second and third in place
      const torch::Tensor all = torch::arange(state.gaussians.size(), device);
      const torch::Tensor kept = all.index_select(0, (all % 10 != round).nonzero().flatten());
      const torch::Tensor grown = all.index_select(0, (all % 9 == round).nonzero().flatten());
      RowEdit edit;
      edit.sources = torch::cat({kept, grown});
      edit.n_kept = kept.size(0);
      edit.new_means = state.gaussians.means.index_select(0, grown) + 0.5;
      edit.new_log_scales = state.gaussians.log_scales.index_select(0, grown) - 0.5;
      editor.reserve(edit, edit.sources.size(0) + 100000, state.gaussians, state.adam, state.statistics);
      editor.apply(edit, state.gaussians, state.adam, state.statistics);
    }
    return state;
  };
  const TrainState expected = edited(torch::kCPU), found = edited(torch::Device(torch::kCUDA, 0));
  expect_same_state(expected, found);
}

TEST(DefaultStrategyOnGpu, DoesWhatTheCpuDoes) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(4);
  constexpr std::int64_t kCount = 4000;
  GaussianTensors host{torch::randn({kCount, 3}),  torch::randn({kCount, 3}) - 2, torch::randn({kCount, 4}),
                       torch::randn({kCount}) * 3, torch::randn({kCount, 1, 3}),  torch::randn({kCount, 3, 3})};
  DensityStatistics seen = make_density_statistics(kCount, torch::kCPU);
  seen.grad_norm_sum = torch::rand({kCount}).mul(8).floor();  // many are equal
  seen.view_count += 2;
  constexpr double kExtent = 30;  // Gaussians of more than 3 are pruned
  TrainConfig config;
  config.densify_grad_threshold = 1.5;
  config.percent_dense = 0.3 / kExtent;
  config.prune_opacity = 0.05;
  config.opacity_reset_interval = 500;
  config.seed = 3;
  const std::unique_ptr<DensityStrategy> strategy = make_default_strategy(config, kExtent);
  GaussianTensors device;
  for (std::size_t i = 0; i < host.all().size(); ++i) *device.all()[i] = host.all()[i]->to(torch::kCUDA);
  DensityStatistics device_seen;
  for (std::size_t i = 0; i < seen.all().size(); ++i) *device_seen.all()[i] = seen.all()[i]->to(torch::kCUDA);
  const DensityRound expected = strategy->plan_round(host, seen, 600, kCount + 700),
                     found = strategy->plan_round(device, device_seen, 600, kCount + 700);
  EXPECT_TRUE(found.edit.new_means.is_cuda());
  EXPECT_GT(expected.n_split, 100);
  EXPECT_GT(expected.n_cloned, 20);
  EXPECT_TRUE(test::same(found.edit.sources.to(torch::kCPU), expected.edit.sources));
  EXPECT_EQ(found.edit.n_kept, expected.edit.n_kept);
  const torch::Tensor allowed = 1e-6 * (1 + expected.edit.new_means.abs());
  EXPECT_TRUE(test::within(found.edit.new_means.to(torch::kCPU), expected.edit.new_means, allowed));
  EXPECT_TRUE(test::within(found.edit.new_log_scales.to(torch::kCPU), expected.edit.new_log_scales, 1e-6));
}

TEST(McmcOnGpu, DoesWhatTheCpuDoes) {
  B3DGS_NEEDS_GPU();
  torch::manual_seed(4);
  constexpr std::int64_t kCount = 40000;
  GaussianTensors host{torch::randn({kCount, 3}),    torch::randn({kCount, 3}) * 0.5 - 3,
                       torch::randn({kCount, 4}),    torch::randn({kCount}) * 3 - 1,
                       torch::randn({kCount, 1, 3}), torch::randn({kCount, 3, 3})};
  GaussianTensors device;
  for (std::size_t i = 0; i < host.all().size(); ++i) *device.all()[i] = host.all()[i]->to(torch::kCUDA);
  const McmcRule rule{/*prune_opacity=*/0.05, /*growth=*/0.2, /*max_gaussians=*/kCount + 7000};
  const DensityRound expected = plan_mcmc_round(host, rule, 3, 600), found = plan_mcmc_round(device, rule, 3, 600);
  EXPECT_TRUE(found.edit.new_means.is_cuda());
  EXPECT_GT(expected.n_pruned, 1000);
  EXPECT_EQ(expected.n_over_limit, 1000);
  EXPECT_EQ(found.edit.n_kept, expected.edit.n_kept);
  EXPECT_TRUE(test::same(found.edit.sources.to(torch::kCPU), expected.edit.sources));
  EXPECT_TRUE(test::same(found.edit.new_means.to(torch::kCPU), expected.edit.new_means));
  EXPECT_TRUE(test::within(found.edit.new_log_scales.to(torch::kCPU), expected.edit.new_log_scales, 1e-5));
  EXPECT_TRUE(test::within(found.edit.new_logit_opacities.to(torch::kCPU), expected.edit.new_logit_opacities, 1e-5));
  const DensityRound again = plan_mcmc_round(device, rule, 3, 600);
  EXPECT_TRUE(test::same(again.edit.sources, found.edit.sources));
  EXPECT_TRUE(test::same(again.edit.new_log_scales, found.edit.new_log_scales));

  const torch::Tensor before = host.means.clone();
  add_mean_noise(host, 400, 3, 77);
  add_mean_noise(device, 400, 3, 77);
  EXPECT_GT((host.means != before).any(1).sum().item<int>(), 1000);
  EXPECT_GT((host.means == before).all(1).sum().item<int>(), 1000);
  EXPECT_TRUE(test::within(device.means.to(torch::kCPU), host.means, host.means.abs() * 0x1p-22 + 1e-37));

  const torch::Tensor rows =
      torch::arange(kCount, torch::kInt32) * 3 + 5;  // as if other ranks had the rows between them
  const torch::Tensor added_once = host.means.clone();
  add_mean_noise(host, 400, 3, 77, rows);
  add_mean_noise(device, 400, 3, 77, rows.to(torch::kCUDA));
  EXPECT_GT((host.means != added_once).any(1).sum().item<int>(), 1000);
  EXPECT_TRUE(test::within(device.means.to(torch::kCPU), host.means, host.means.abs() * 0x1p-21 + 1e-37));
}

}  // namespace
}  // namespace b3dgs
