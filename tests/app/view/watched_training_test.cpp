// The live view of a training: its display and commands, and that it does not change the training.
#include "app/view/watched_training.h"

#include <gtest/gtest.h>

#include <thread>

#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

FrameRequest request_of(const WatchedTraining& watched, FrameMode mode, int view = 1) {
  FrameRequest request;
  request.view = view;
  request.camera = watched.scene().views[static_cast<std::size_t>(view)].camera;
  request.mode = mode;
  if (mode == FrameMode::kDifference) {
    request.photograph =
        std::make_shared<Image8>(watched.photograph(view, {request.camera.width, request.camera.height}));
  }
  return request;
}

/// A training on its own thread, and its live view.
class LiveTraining {
 public:
  LiveTraining(const TrainConfig& config, const Scene& scene, const fs::path& folder, bool asks_every_step = false)
      : watched(finalize(config, scene), scene, [this] { stop_signal = SIGINT; }) {
    TrainHooks hooks;
    hooks.stop_signal = &stop_signal;
    watched.attach(hooks);
    if (asks_every_step) hooks.wants_model = [] { return true; };
    trainer_ = std::make_unique<Trainer>(finalize(config, scene), scene, ModelFolder(folder), hooks);
    watched.set_save([this] { return trainer_->save(); });
  }
  ~LiveTraining() {
    if (thread_.joinable()) thread_.join();
  }

  void start() {
    thread_ = std::thread([this] {
      result = trainer_->run();
      watched.finish(result);
    });
  }
  void join() { thread_.join(); }

  std::atomic<int> stop_signal{0};
  WatchedTraining watched;
  TrainResult result;

 private:
  std::unique_ptr<Trainer> trainer_;
  std::thread thread_;
};

/// Uses the maximum number of viewers: frames of all modes, pauses and checkpoints.
void expect_same_bytes(TrainConfig config) {
  const test::TempDir folder;
  const Scene scene = test::make_tiny_scene();
  config.deterministic = true;  // on a GPU too
  const test::Trained alone = test::train(config, scene, folder.path() / "alone");

  LiveTraining live(config, scene, folder.path() / "watched", /*asks_every_step=*/true);
  live.watched.command(ViewCommand::kPause);
  live.start();
  std::atomic<int> n_frames{0};
  std::vector<std::thread> viewers;
  for (int viewer = 0; viewer < 3; ++viewer) {
    viewers.emplace_back([&] {
      try {
        for (;;) {
          for (const FrameMode mode :
               {FrameMode::kRender, FrameMode::kDifference, FrameMode::kDepth, FrameMode::kAlpha, FrameMode::kLoad}) {
            live.watched.render(request_of(live.watched, mode));
            ++n_frames;
          }
        }
      } catch (const BusyError&) {  // the training has ended
      }
    });
  }
  while (n_frames < 20) std::this_thread::yield();
  live.watched.command(ViewCommand::kSave);
  live.watched.command(ViewCommand::kResume);
  for (std::thread& viewer : viewers) viewer.join();
  live.join();

  EXPECT_EQ(live.result.iteration, config.iterations);
  EXPECT_TRUE(test::same(test::read_bytes(live.result.ply), alone.ply)) << "PLY";
  EXPECT_TRUE(test::same(test::timeless_bytes(live.result.checkpoint), alone.checkpoint)) << "checkpoint";
}

TEST(WatchedTraining, MakesTheSameBytesAsUnwatched) {
  expect_same_bytes(test::eventful_config());
}

TEST(WatchedTraining, MakesTheSameBytesWithBatchesFiltersAndRefinedPoses) {
  TrainConfig config = test::eventful_config();
  config.batch = 2;
  config.antialiasing = true;
  config.random_background = false;
  expect_same_bytes(config);
  config = test::eventful_config();
  config.pose_opt = true;
  config.strategy = Strategy::kMcmc;
  config.max_gaussians = 200;
  expect_same_bytes(config);
}

TEST(WatchedTraining, PausesSavesAndStops) {
  const test::TempDir folder;
  const Scene scene = test::make_tiny_scene();
  TrainConfig config = test::eventful_config();
  config.iterations = 1000000;
  LiveTraining live(config, scene, folder.path());
  live.start();
  live.watched.command(ViewCommand::kPause);
  while (!live.watched.state(0).is_paused || live.watched.state(0).iteration == 0) std::this_thread::yield();
  const int paused_at = live.watched.render(request_of(live.watched, FrameMode::kRender)).iteration;
  EXPECT_EQ(live.watched.render(request_of(live.watched, FrameMode::kDepth)).iteration, paused_at);
  EXPECT_EQ(live.watched.state(0).activity, "paused");

  live.watched.command(ViewCommand::kSave);
  while (live.watched.state(0).notice.empty()) std::this_thread::yield();
  EXPECT_EQ(live.watched.state(0).notice, "saved iteration_" + std::to_string(paused_at) + ".b3dgs");
  EXPECT_TRUE(fs::exists(ModelFolder(folder.path()).checkpoint(paused_at)));
  EXPECT_TRUE(fs::exists(ModelFolder(folder.path()).ply(paused_at))) << "what a viewer can open";

  live.watched.command(ViewCommand::kResume);
  while (live.watched.state(0).iteration <= paused_at) std::this_thread::yield();
  live.watched.command(ViewCommand::kPause);
  live.watched.command(ViewCommand::kStop);
  live.join();
  EXPECT_TRUE(live.result.interrupted);
  EXPECT_TRUE(fs::exists(live.result.checkpoint));
  EXPECT_EQ(live.watched.state(0).activity, "stopped");
  EXPECT_THROW(live.watched.render(request_of(live.watched, FrameMode::kRender)), BusyError);
}

TEST(WatchedTraining, ShowsProgressAndCurves) {
  const test::TempDir folder;
  const Scene scene = test::make_tiny_scene();
  TrainConfig config = test::eventful_config();
  config.eval = true;
  config.test_iterations = {10, 20};
  LiveTraining live(config, scene, folder.path());
  live.start();
  live.join();
  const ViewState state = live.watched.state(0);
  EXPECT_EQ(state.iteration, 20);
  EXPECT_EQ(state.iterations, 20);
  EXPECT_GT(state.loss, 0);
  EXPECT_EQ(state.n_gaussians, live.result.n_gaussians);
  ASSERT_EQ(state.curve.size(), 20u);
  EXPECT_EQ(state.curve.front().iteration, 1);
  ASSERT_EQ(state.psnr.size(), 2u);
  EXPECT_EQ(state.psnr[1].iteration, 20);
  EXPECT_DOUBLE_EQ(state.psnr[1].psnr, live.result.evaluations[1].second.mean.psnr);
  const std::vector<CurvePoint> later = live.watched.state(15).curve;
  ASSERT_EQ(later.size(), 5u);
  EXPECT_EQ(later.front().iteration, 16);
}

TEST(WatchedTraining, TellsHowATrainingEnded) {
  const test::TempDir folder;
  const Scene scene = test::make_tiny_scene();
  TrainConfig config = test::eventful_config();
  config.model_path = folder.path().string();
  const fs::path ply = ModelFolder(folder.path()).ply(7);
  fs::create_directories(ply.parent_path());
  fs::create_symlink(ply.filename(), ply);  // a link to itself
  WatchedTraining failed(finalize(config, scene), scene, [] {}), resumed(finalize(config, scene), scene, [] {});
  failed.close();
  EXPECT_EQ(failed.state(0).activity, "failed");
  EXPECT_EQ(failed.state(0).notice, "See the terminal.");

  TrainResult complete_before;
  complete_before.iteration = 20;
  complete_before.n_gaussians = 300;
  resumed.finish(complete_before);
  resumed.close();
  resumed.command(ViewCommand::kPause);
  const ViewState state = resumed.state(0);
  EXPECT_EQ(state.activity, "finished");
  EXPECT_EQ(state.iteration, 20);
  EXPECT_EQ(state.n_gaussians, 300);
  EXPECT_FALSE(state.is_paused);
}

TEST(WatchedTraining, CurvesOfLongTrainingsStayShort) {
  const Scene scene = test::make_tiny_scene();
  WatchedTraining watched(finalize(test::eventful_config(), scene), scene, [] {});
  TrainHooks hooks;
  watched.attach(hooks);
  for (int iteration = 1; iteration <= 30000; ++iteration) {
    TrainProgress progress;
    progress.iteration = iteration;
    progress.loss = 1.0 / iteration;
    hooks.on_progress(progress);
  }
  const std::vector<CurvePoint> curve = watched.state(0).curve;
  EXPECT_GE(curve.size(), 900u);
  EXPECT_LE(curve.size(), 2000u);
  EXPECT_EQ(curve.front().iteration, 1);
  EXPECT_GT(curve.back().iteration, 29900);
  for (std::size_t i = 1; i < curve.size(); ++i) EXPECT_GT(curve[i].iteration, curve[i - 1].iteration);
}

TEST(WatchedTraining, AModelThatCannotBeRenderedIsAnErrorOfTheFrame) {
  const Scene scene = test::make_tiny_scene();
  WatchedTraining watched(finalize(test::eventful_config(), scene), scene, [] {});
  TrainHooks hooks;
  watched.attach(hooks);
  GaussianTensors gaussians;
  test::make_tiny_scene({}, &gaussians);
  gaussians.means[3][0] = std::nan("");
  std::string error;
  std::thread viewer([&] {
    try {
      watched.render(request_of(watched, FrameMode::kRender));
    } catch (const std::exception& e) {
      error = e.what();
    }
  });
  while (!hooks.wants_model()) std::this_thread::yield();
  hooks.on_model({5, gaussians, {}, 0, "naive"});
  viewer.join();
  EXPECT_FALSE(error.empty());
  EXPECT_TRUE(std::isnan(gaussians.means[3][0].item<float>())) << "nothing is removed";
}

/// Asks for a picture of a free camera that is too large for the first frame of a training.
FrameRequest large_request(FrameMode mode) {
  FrameRequest request;
  request.camera = test::look_at_origin(0, 0, -3, 600, 400);
  request.mode = mode;
  if (mode == FrameMode::kDifference) request.photograph = std::make_shared<Image8>(600, 400, 3);
  return request;
}

TEST(WatchedTraining, TheFirstPictureIsSmallAndAPauseHasTimeForTheLargeOne) {
  const Scene scene = test::make_tiny_scene();
  GaussianTensors gaussians;
  test::make_tiny_scene({}, &gaussians);
  for (const FrameMode mode : {FrameMode::kRender, FrameMode::kLoad, FrameMode::kDifference}) {
    WatchedTraining watched(finalize(test::eventful_config(), scene), scene, [] {});
    TrainHooks hooks;
    std::atomic<int> stop_signal{0};
    hooks.stop_signal = &stop_signal;
    watched.attach(hooks);
    std::thread trainer([&] {
      while (stop_signal == 0) {
        if (hooks.wants_model()) hooks.on_model({5, gaussians, {}, 0, "naive"});
      }
    });
    const Frame first = watched.render(large_request(mode));
    EXPECT_LE(first.image.width * first.image.height, 16000);
    EXPECT_NEAR(first.image.width, 1.5 * first.image.height, 2) << "the same shape";
    watched.command(ViewCommand::kPause);
    const Frame paused = watched.render(large_request(mode));
    EXPECT_EQ(paused.image.width, 600);
    stop_signal = 1;
    trainer.join();
  }
}

TEST(FrameBudget, ADraftCostsLittleHoweverLargeFramesAre) {
  FrameBudget budget(0.05);
  const double all = 1e6, of_all = 1.0;  // pixels of a frame that would take a second
  double now_s = 0, last_draft_s = 0;
  EXPECT_TRUE(budget.allows(now_s));
  EXPECT_LE(budget.pixels(false), 0.02 * all) << "nothing is known of the time that a pixel takes";
  budget.learn(0.02, 0.02 * all, false);
  budget.spend(0.02);
  const auto draw = [&](bool is_draft) {
    const double share = std::min(1.0, budget.pixels(is_draft) / all);
    budget.learn(share * of_all, share * all, is_draft);
    budget.spend(share * of_all);
    now_s += share * of_all;
    return share * of_all;
  };
  for (int i = 0; i < 100; ++i) {  // a drag
    while (!budget.allows(now_s)) now_s += 0.01;
    EXPECT_LE(now_s - last_draft_s, 0.6) << i;
    last_draft_s = now_s;
    EXPECT_NEAR(draw(true), 0.025, 1e-9);
  }
  const double wait_s = budget.wait_s(all);
  EXPECT_GT(wait_s, 1);
  EXPECT_LE(wait_s, 6);
  now_s += wait_s + 0.001;
  EXPECT_TRUE(budget.allows(now_s));
  EXPECT_NEAR(draw(false), 0.15, 0.001) << "a larger one";
  EXPECT_TRUE(budget.allows(now_s));
  EXPECT_NEAR(draw(true), 0.025, 1e-9) << "the reserve pays for what is clicked on next";
}

TEST(FrameBudget, TheFixedPartOfTheTimeDoesNotShrinkLargeFrames) {
  FrameBudget budget(0.05);
  double now_s = 0;
  const auto draw = [&](bool is_draft) {
    const double pixels = budget.pixels(is_draft), seconds = 0.01 + 5e-7 * pixels;
    budget.learn(seconds, pixels, is_draft);
    budget.spend(seconds);
    return seconds;
  };
  for (int i = 0; i < 10; ++i) {
    for (const bool is_draft : {true, true, true, false}) {
      now_s += 100;
      EXPECT_TRUE(budget.allows(now_s));
      const double seconds = draw(is_draft);
      if (i <= 5) continue;  // it learns
      EXPECT_NEAR(seconds, is_draft ? 0.025 : 0.15, is_draft ? 0.005 : 0.03) << i;
    }
  }
}

TEST(FrameBudget, FramesTakeTheirShareOfTheTime) {
  FrameBudget budget(0.05);
  double now_s = 100, frames_s = 0;
  const double start_s = now_s;
  while (now_s < start_s + 1000) {
    if (budget.allows(now_s)) {
      budget.spend(0.2);
      frames_s += 0.2;
      now_s += 0.2;
    } else {
      now_s += 0.01;  // a step
    }
  }
  EXPECT_LE(frames_s, 0.05 * (now_s - start_s) + 0.25 + 0.2);
  EXPECT_GE(frames_s, 0.045 * (now_s - start_s));
}

TEST(FrameBudget, TimeWithoutViewersIsNotSavedUpForLong) {
  FrameBudget budget(0.05);
  EXPECT_TRUE(budget.allows(0));
  int n = 0;
  for (; budget.allows(10000); ++n) budget.spend(0.1);
  EXPECT_LE(n, 3);
}

}  // namespace
}  // namespace b3dgs
