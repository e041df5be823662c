// Tests training with too little memory, simulated by a MemorySource, without a GPU.
#include "train/memory/memory.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "support/approx.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/short_memory.h"
#include "support/train/tiny_scene.h"
#include "support/train/training.h"
#include "train/density/strategies/strategies.h"
#include "train/loss/loss.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

struct Outcome {
  TrainResult result;
  std::vector<std::string> messages;
  std::string log;
  std::int64_t count_cap = 0;  // in the last checkpoint
};

TrainConfig growing_config() {
  TrainConfig config = test::eventful_config();
  config.iterations = 40;
  return config;
}

Outcome train_with(const std::shared_ptr<test::ShortMemory>& memory, const TrainConfig& config, const fs::path& folder,
                   const fs::path& resume = {}) {
  const Scene scene = test::make_tiny_scene();
  Outcome outcome;
  TrainHooks hooks;
  hooks.memory = memory;
  hooks.on_message = [&](const std::string& message) { outcome.messages.push_back(message); };
  Trainer trainer(finalize(config, scene), scene, ModelFolder(folder), hooks);
  if (!resume.empty()) trainer.resume(resume);
  outcome.result = trainer.run();
  outcome.log = test::read_bytes(ModelFolder(folder).log());
  outcome.count_cap = read_checkpoint_header(outcome.result.checkpoint).value("count_cap", std::int64_t{-1});
  return outcome;
}

std::vector<int> iterations_of_event(const std::string& log, const std::string& event) {
  std::vector<int> iterations;
  std::istringstream lines(log);
  for (std::string line; std::getline(lines, line);) {
    const nlohmann::json json = nlohmann::json::parse(line);
    if (json.value("event", "") == event) iterations.push_back(json.at("iteration").get<int>());
  }
  return iterations;
}

bool says(const Outcome& outcome, const std::string& what) {
  return std::any_of(outcome.messages.begin(), outcome.messages.end(),
                     [&](const std::string& message) { return message.find(what) != std::string::npos; });
}

TEST(Memory, WithoutALimitTheCountIsNotHeld) {
  const test::TempDir temp;
  const Outcome outcome = train_with(std::make_shared<test::ShortMemory>(), growing_config(), temp / "model");
  EXPECT_GT(outcome.result.n_gaussians, 160);
  EXPECT_EQ(outcome.count_cap, 0);
  EXPECT_EQ(outcome.log.find("\"event\":\"capped\""), std::string::npos);
}

TEST(Memory, CapsTheCountBeforeARoundThatWouldNotFitAndTrainsToTheEnd) {
  const test::TempDir temp;
  auto memory = std::make_shared<test::ShortMemory>();
  memory->bytes = 290000;
  const TrainConfig config = growing_config();
  const Outcome outcome = train_with(memory, config, temp / "model");
  EXPECT_EQ(outcome.result.iteration, config.iterations);
  ASSERT_GT(outcome.count_cap, 0);
  EXPECT_LE(outcome.result.n_gaussians, outcome.count_cap);
  EXPECT_TRUE(says(outcome, "capped at " + std::to_string(outcome.count_cap) + " Gaussians: GPU memory"));
  EXPECT_NE(outcome.log.find("\"event\":\"capped\",\"reason\":\"GPU memory\",\"count\":"), std::string::npos);
  EXPECT_NE(outcome.log.find("\"limit_bytes\":290000"), std::string::npos);
  EXPECT_EQ(memory->n_releases, 0) << "nothing failed";
}

TEST(Memory, AHoldEndsWhenThereIsMemoryForMore) {
  const test::TempDir temp;
  auto memory = std::make_shared<test::ShortMemory>();
  memory->bytes = 290000;
  TrainConfig config = growing_config();
  config.iterations = 25;
  const Outcome held = train_with(memory, config, temp / "capped");
  ASSERT_GT(held.count_cap, 0);
  config.iterations = 40;
  const Outcome resumed =
      train_with(std::make_shared<test::ShortMemory>(), config, temp / "capped", held.result.checkpoint);
  EXPECT_EQ(resumed.count_cap, 0);
  EXPECT_GT(resumed.result.n_gaussians, held.count_cap);
}

TEST(Memory, AHoldStaysInDeterministicTraining) {
  const test::TempDir temp;
  auto memory = std::make_shared<test::ShortMemory>();
  memory->bytes = 290000;
  TrainConfig config = growing_config();
  config.deterministic = true;
  config.iterations = 25;
  const Outcome held = train_with(memory, config, temp / "capped");
  ASSERT_GT(held.count_cap, 0);
  config.iterations = 40;
  const Outcome resumed =
      train_with(std::make_shared<test::ShortMemory>(), config, temp / "capped", held.result.checkpoint);
  EXPECT_EQ(resumed.count_cap, held.count_cap) << "there is memory now, but a deterministic training keeps the hold";
  EXPECT_LE(resumed.result.n_gaussians, held.count_cap);
}

// The first cap after a resume is at the same iteration as without the interruption, because the views before the
// resume count.
TEST(Memory, AResumedDeterministicTrainingIsHeldAtTheSameNumber) {
  const test::TempDir temp;
  const auto limited = [] {
    auto memory = std::make_shared<test::ShortMemory>();
    memory->bytes = 290000;
    return memory;
  };
  TrainConfig config = growing_config();
  config.deterministic = true;
  const Outcome whole = train_with(limited(), config, temp / "whole");
  const std::vector<int> held = iterations_of_event(whole.log, "capped");
  ASSERT_FALSE(held.empty());
  // Only one view has been seen since.
  const Scene scene = test::make_tiny_scene();
  TrainHooks hooks;
  hooks.memory = limited();
  fs::path checkpoint;
  {
    Trainer trainer(finalize(config, scene), scene, ModelFolder(temp / "halves"), hooks);
    trainer.run(held.front() - 1);
    checkpoint = trainer.write_checkpoint();
  }
  EXPECT_EQ(read_checkpoint_header(checkpoint).value("count_cap", std::int64_t{-1}), 0);
  const Outcome resumed = train_with(limited(), config, temp / "halves", checkpoint);
  EXPECT_EQ(resumed.count_cap, whole.count_cap);
  EXPECT_TRUE(
      test::same(test::timeless_bytes(resumed.result.checkpoint), test::timeless_bytes(whole.result.checkpoint)));

  // A checkpoint of an early version has no ratios.
  CheckpointFile early = read_checkpoint_file(checkpoint);
  EXPECT_EQ(early.header.erase("view_ratios"), 1u);
  write_checkpoint_file(checkpoint, early);
  EXPECT_GT(train_with(limited(), config, temp / "halves", checkpoint).count_cap, 0);
}

TEST(Memory, GrowsIfFreeingMemoryHelps) {
  const test::TempDir temp;
  const Outcome expected = train_with(std::make_shared<test::ShortMemory>(), growing_config(), temp / "expected");
  auto memory = std::make_shared<test::ShortMemory>();
  memory->n_failures = 2;  // with and without spare capacity
  const Outcome outcome = train_with(memory, growing_config(), temp / "model");
  EXPECT_EQ(memory->n_releases, 1);
  EXPECT_EQ(outcome.count_cap, 0);
  EXPECT_TRUE(test::same(test::read_bytes(outcome.result.ply), test::read_bytes(expected.result.ply)));
}

TEST(Memory, CapsTheCountIfFreeingDoesNotHelp) {
  const test::TempDir temp;
  auto memory = std::make_shared<test::ShortMemory>();
  memory->rows_that_fit = 125;  // there are 120 at the start
  const Outcome outcome = train_with(memory, growing_config(), temp / "model");
  EXPECT_EQ(outcome.result.iteration, 40);
  EXPECT_GE(memory->n_releases, 1);
  EXPECT_EQ(outcome.count_cap, 120);
  EXPECT_LE(outcome.result.n_gaussians, 120);
  EXPECT_TRUE(says(outcome, "capped at 120 Gaussians: GPU memory"));
}

TEST(Memory, RemediesAreTriedInOrderUntilOneFreesMemory) {
  std::vector<std::string> done;
  int n_failures = 2;
  const auto work = [&] {
    if (n_failures-- > 0) throw OutOfMemoryError("no memory");
    return 7;
  };
  const MemoryRemedy first = [&] { return done.push_back("first"), true; };
  const MemoryRemedy empty = [&] { return done.push_back("empty"), false; };
  const MemoryRemedy last = [&] { return done.push_back("last"), true; };
  EXPECT_EQ(with_remedies({first, empty, last}, work), 7);
  EXPECT_EQ(done, (std::vector<std::string>{"first", "empty", "last"}));
  n_failures = 3;
  EXPECT_TRUE(test::fails_with<OutOfMemoryError>({"no memory"}, [&] { with_remedies({first, last}, work); }));
  EXPECT_THROW(with_remedies({first}, []() -> int { throw NumericError("not of memory"); }), NumericError);
}

TEST(Memory, TheAllocatorMayCacheAQuarterOfWhatIsInUse) {
  const std::int64_t mb = 1 << 20;
  EXPECT_FALSE(keeps_too_much({100 * mb, 356 * mb, 0}));
  EXPECT_TRUE(keeps_too_much({100 * mb, 357 * mb, 0}));
  EXPECT_FALSE(keeps_too_much({8000 * mb, 10000 * mb, 0}));
  EXPECT_TRUE(keeps_too_much({8000 * mb, 10001 * mb, 0}));
}

TEST(MemoryPlan, CountsTheImagesOfTheLargestView) {
  const test::TempDir temp;
  const Scene scene = test::make_tiny_scene();
  TrainHooks hooks;
  auto memory = std::make_shared<test::ShortMemory>();
  memory->bytes = 10'000'000;
  hooks.memory = memory;
  TrainConfig config = growing_config();
  const auto forecast = [&] {
    return Trainer(finalize(config, scene), scene, ModelFolder(temp / "model"), hooks).forecast_memory().value();
  };
  const Camera& camera = scene.train.front().camera;
  const std::int64_t n_pixels = std::int64_t{camera.width} * camera.height;
  const MemoryForecast usual = forecast();
  EXPECT_GE(usual.images, n_pixels * (20 + 48 + 24)) << "render, loss, and what the rasterizer keeps";
  const auto fits = [&](const MemoryForecast& of) {
    const std::int64_t n = static_cast<std::int64_t>(scene.points.size());
    return (memory->bytes.value() * 15 / 16 - of.images) * n / (of.model + of.pairs);
  };
  EXPECT_NEAR(static_cast<double>(usual.largest_count), static_cast<double>(fits(usual)), 1);
  config.strategy = Strategy::kBudget;
  config.max_gaussians = 500;
  config.exposure = true;
  EXPECT_EQ(forecast().images, usual.images + n_pixels * (4 + 12)) << "errors, and corrected colours";
}

TEST(MemoryPlan, ForgetsViewsOfEarlierRounds) {
  ViewRatios ratios;
  ratios.add(10, 300, 10);
  ratios.begin_round();
  ratios.add(10, 100, 20);
  EXPECT_EQ(ratios.pairs(), 30) << "the round before still counts";
  ratios.begin_round();
  EXPECT_EQ(ratios.pairs(), 5);
  EXPECT_EQ(ratios.splats(), 0.5);
}

TEST(MemoryPlan, CountsTheBytesOfAGaussian) {
  TrainState state;
  state.gaussians = to_tensors(splats_from_points({{0, 0, 0, 1, 1, 1}, {9, 9, 9, 9, 9, 9}}, 3), 3, torch::kCPU);
  state.adam = make_adam_state(state.gaussians);
  state.statistics = make_density_statistics(2, torch::kCPU);
  ViewRatios ratios;
  EXPECT_EQ(gaussian_memory(state, {208, 100}, ratios).state, 3 * 59 * 4 + 3 * 4);
  EXPECT_EQ(state_bytes(state), 2 * (3 * 59 * 4 + 3 * 4));
  EXPECT_EQ(gaussian_memory(state, {208, 100}, ratios).view, 208 + 500)
      << "no view yet, and a quarter more pairs than counted";
  ratios.add(1, 6, 2);
  ratios.add(2, 2, 2);
  const GaussianMemory memory = gaussian_memory(state, {208, 100}, ratios);
  EXPECT_EQ(memory.view, 208 + 375);
  EXPECT_EQ(memory.round, 64 + 180);
  EXPECT_EQ(memory.all(), 720 + 40 + 583);
  EXPECT_EQ(gaussian_memory(state, {208, 100}, ratios, 4).all(), memory.all() + 1.25 * (4 * (4 + 48) + 12))
      << "splats and indices of 4 views, and a copy of the statistics";
  // 15/16 of 3.2 GB, minus 100 MB.
  EXPECT_EQ(largest_count(3200000000, 100000000, memory), 2900000000 / 1343);
  EXPECT_EQ(largest_count(1000, 5000, memory), 1) << "0 would mean no limit";
}

TrainState numbered_state(std::int64_t n) {
  TrainState state;
  const torch::Tensor number = torch::arange(n).to(torch::kFloat32);
  const auto numbered = [&](std::vector<std::int64_t> sizes) {
    std::vector<std::int64_t> column(sizes.size(), 1);
    column[0] = n;
    return number.view(column).expand(sizes).contiguous();
  };
  state.gaussians = {numbered({n, 3}), numbered({n, 3}),    numbered({n, 4}),
                     numbered({n}),    numbered({n, 1, 3}), numbered({n, 3, 3})};
  state.adam = make_adam_state(state.gaussians);
  for (GaussianTensors* moments : {&state.adam.m, &state.adam.v}) {
    for (torch::Tensor* moment : moments->all()) moment->fill_(1);
  }
  state.statistics = make_density_statistics(n, torch::kCPU);
  return state;
}

RowEdit make_edit(const std::vector<std::int64_t>& sources, std::int64_t n_kept) {
  RowEdit edit;
  edit.sources = torch::tensor(sources);
  edit.n_kept = n_kept;
  const auto n_new = static_cast<std::int64_t>(sources.size()) - n_kept;
  edit.new_means = torch::full({n_new, 3}, 50.0f);
  edit.new_log_scales = torch::full({n_new, 3}, 60.0f);
  return edit;
}

TEST(RowEditor, ReallocatesOnlyIfCapacityIsExceeded) {
  TrainState state = numbered_state(4);
  int n_requests = 0;
  RowEditor editor([&](torch::IntArrayRef sizes, const torch::TensorOptions& options) {
    ++n_requests;
    return torch::empty(sizes, options);
  });
  const auto apply = [&](const RowEdit& edit, std::int64_t n_room) {
    editor.reserve(edit, n_room, state.gaussians, state.adam, state.statistics);
    const int n_reserved = n_requests;
    editor.apply(edit, state.gaussians, state.adam, state.statistics);
    EXPECT_EQ(n_requests, n_reserved) << "apply() allocated";
  };
  apply(make_edit({0, 2, 3, 0, 2}, 3), 8);
  EXPECT_EQ(n_requests, 21 + 1) << "all tensors, and the scratch";
  const void* const place = state.gaussians.sh0.data_ptr();
  EXPECT_TRUE(test::same(state.gaussians.quats.select(1, 0), torch::tensor({0.0f, 2.0f, 3.0f, 0.0f, 2.0f})));
  apply(make_edit({1, 3, 4, 0, 4, 1, 4, 3}, 3), 8);  // kept rows overwrite the sources of new rows
  EXPECT_EQ(n_requests, 21 + 2) << "only the scratch";
  EXPECT_EQ(state.gaussians.sh0.data_ptr(), place);
  EXPECT_TRUE(
      test::same(state.gaussians.quats.select(1, 0), torch::tensor({2.0f, 0.0f, 2.0f, 0.0f, 2.0f, 2.0f, 2.0f, 0.0f})));
  EXPECT_TRUE(test::same(state.gaussians.means.select(1, 0),
                         torch::tensor({2.0f, 50.0f, 50.0f, 50.0f, 50.0f, 50.0f, 50.0f, 50.0f})));
  EXPECT_TRUE(
      test::same(state.adam.v.logit_opacities, torch::tensor({1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f})));
  EXPECT_TRUE(state.gaussians.shN.is_contiguous());
}

TEST(RowEditor, DoesNotChangeTheModelIfMemoryIsShort) {
  const RowEdit edit = make_edit({1, 2, 3, 1, 1, 2}, 3);
  for (int n_granted = 0; n_granted < 22; ++n_granted) {
    TrainState state = numbered_state(4);
    const TrainState before = numbered_state(4);
    int n_left = n_granted;
    RowEditor editor([&](torch::IntArrayRef sizes, const torch::TensorOptions& options) {
      if (n_left-- == 0) throw OutOfMemoryError("no memory");
      return torch::empty(sizes, options);
    });
    EXPECT_THROW(editor.reserve(edit, 6, state.gaussians, state.adam, state.statistics), OutOfMemoryError);
    for (std::size_t i = 0; i < before.gaussians.all().size(); ++i) {
      EXPECT_TRUE(test::same(*state.gaussians.all()[i], *before.gaussians.all()[i])) << n_granted;
      EXPECT_TRUE(test::same(*state.adam.v.all()[i], *before.adam.v.all()[i])) << n_granted;
    }
  }
}

TEST(RowEditor, MovesMoreRowsThanAPieceHolds) {
  constexpr std::int64_t kRows = 1000;
  TrainState state = numbered_state(kRows);
  std::vector<std::int64_t> sources;
  for (std::int64_t i = 0; i < kRows; ++i) {
    if (i % 10 != 7) sources.push_back(i);
  }
  const auto n_kept = static_cast<std::int64_t>(sources.size());
  const RowEdit edit = make_edit(sources, n_kept);
  RowEditor editor(allocate_tensor, /*piece_elements=*/100);  // 11 rows of shN
  editor.reserve(edit, kRows, state.gaussians, state.adam, state.statistics);
  editor.apply(edit, state.gaussians, state.adam, state.statistics);
  EXPECT_TRUE(test::same(state.gaussians.shN.select(1, 2).select(1, 2), torch::tensor(sources).to(torch::kFloat32)));
  EXPECT_TRUE(test::same(state.gaussians.logit_opacities, torch::tensor(sources).to(torch::kFloat32)));
}

TEST(ImageLoss, KeepsItsMemoryForPhotographsOfSeveralSizes) {
  ImageLoss loss(torch::kCPU);
  const auto grad_at = [&](std::int64_t height, std::int64_t width) {
    const torch::Tensor truth = torch::zeros({height, width, 3}, torch::kUInt8);
    loss.compute(torch::full({height, width, 3}, 0.5f), truth, {}, height * width, LossWeights{0.2});
    EXPECT_EQ(loss.grad().color.sizes(), (std::vector<std::int64_t>{height, width, 3}));
    EXPECT_TRUE(loss.grad().color.is_contiguous());
    return loss.grad().color.data_ptr();
  };
  const void* const place = grad_at(40, 30);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(grad_at(20, 50), place);
    EXPECT_EQ(grad_at(40, 30), place);
  }
}

}  // namespace
}  // namespace b3dgs
