#include "train/images/image_store.h"

#include <gtest/gtest.h>

#include "config/view_order.h"
#include "core/check.h"
#include "support/expect_error.h"
#include "support/train/disk_scene.h"
#include "support/train/tiny_scene.h"
#include "train/images/image_reader.h"

namespace b3dgs {
namespace {

using Views = std::vector<std::int32_t>;

TEST(UploadSlots, UploadEachWantedViewOnceAndKeepItsSlot) {
  UploadSlots slots(3);
  EXPECT_EQ(slots.slot_of(4), -1);
  const auto first = slots.assign({4, 7, 2});
  ASSERT_EQ(first.size(), 3u);
  EXPECT_EQ(first[0].view, 4) << "the next view first";
  const int slot_of_7 = slots.slot_of(7), slot_of_4 = slots.slot_of(4);
  EXPECT_TRUE(slots.assign({4, 7, 2}).empty());
  const auto second = slots.assign({7, 2, 9});
  ASSERT_EQ(second.size(), 1u);
  EXPECT_EQ(second[0].view, 9);
  EXPECT_EQ(second[0].slot, slot_of_4) << "the slot of the view that is not wanted any more";
  EXPECT_EQ(slots.slot_of(7), slot_of_7);
  EXPECT_EQ(slots.slot_of(4), -1);
  EXPECT_TRUE(test::fails_with<LogicError>({"4 views for 3 slots"}, [&] { slots.assign({1, 2, 3, 4}); }));
}

TEST(UploadSlots, UploadTwoStepsAheadInAnyOrderOfViews) {
  // Makes the requests of ImageStore over three passes, in which a view may come last in one pass and first in the
  // next.
  constexpr std::int32_t kViews = 7;
  constexpr std::size_t kAhead = ImageStore::kUploadAhead;
  ViewOrder order;
  UploadSlots slots(static_cast<int>(kAhead) + 1);
  int n_uploads = 0;
  for (int step = 0; step < 3 * kViews; ++step) {
    const std::int32_t view = order.next(5, kViews);
    const bool was_there = slots.slot_of(view) >= 0;
    EXPECT_TRUE(step == 0 || was_there) << "step " << step << " must wait for its photograph";
    Views wanted{view};
    for (const std::int32_t next : order.upcoming(5, kViews, kAhead)) {
      if (std::find(wanted.begin(), wanted.end(), next) == wanted.end()) wanted.push_back(next);
    }
    const int slot_in_use = slots.slot_of(view);
    for (const auto& upload : slots.assign(wanted)) {
      ++n_uploads;
      EXPECT_FALSE(was_there && upload.slot == slot_in_use) << "overwritten while it is read";
    }
    for (const std::int32_t next : wanted) EXPECT_GE(slots.slot_of(next), 0);
  }
  EXPECT_LE(n_uploads, 3 * kViews + static_cast<int>(kAhead));
  EXPECT_GE(n_uploads, 2 * kViews);
}

TEST(ViewOrder, TellsTheUpcomingViewsWithoutTakingThem) {
  ViewOrder order;
  for (int step = 0; step < 23; ++step) {
    for (const std::size_t n : {0u, 1u, 3u, 12u}) {  // 12 spans two refills
      const ViewOrder before = order;
      const Views upcoming = order.upcoming(3, 5, n);
      EXPECT_EQ(order.remaining, before.remaining);
      EXPECT_EQ(order.n_refills, before.n_refills);
      ViewOrder copy = order;
      Views expected;
      for (std::size_t i = 0; i < n; ++i) expected.push_back(copy.next(3, 5));
      EXPECT_EQ(upcoming, expected) << "step " << step;
    }
    order.next(3, 5);
  }
}

TEST(ImageStore, OnTheCpuSharesTheImagesOfTheSceneWhateverTheBudget) {
  test::TinySceneOptions options;
  options.masked = true;
  const Scene scene = test::make_tiny_scene(options);
  ImageStore store(scene.train, torch::kCPU, /*budget_bytes=*/0);
  ASSERT_EQ(store.size(), static_cast<std::int32_t>(scene.train.size()));
  EXPECT_EQ(store.n_resident(), store.size());
  for (std::int32_t i : {3, 0, 5}) {
    const TrainView view = store.take(i, {1, 2});
    const View& expected = scene.train[static_cast<std::size_t>(i)];
    EXPECT_EQ(view.name, expected.name);
    EXPECT_EQ(view.truth.data_ptr<std::uint8_t>(), expected.image->held()->pixels.data()) << "copied";
    EXPECT_EQ(view.valid.data_ptr<std::uint8_t>(), expected.valid->pixels.data()) << "copied";
    EXPECT_EQ(view.truth.sizes(), (std::vector<std::int64_t>{44, 60, 3}));
    EXPECT_EQ(view.n_valid, 44 * 48);
    EXPECT_EQ(store.stored_view(i).n_valid, view.n_valid);
  }
}

TEST(ImageStore, OnTheCpuKeepsWhatFitsAndReadsTheRestAhead) {
  const test::DiskScene disk(/*distorted=*/true);
  const Scene whole = disk.load();
  for (const double photographs : {0.0, 1.0, 4.5, 100.0}) {
    SCOPED_TRACE(std::to_string(photographs) + " photographs");
    const Scene scene = disk.load(photographs);
    ImageStore store(scene.train, torch::kCPU, 0);
    const ImageMemory& memory = *scene.train.front().image->memory();
    EXPECT_EQ(store.n_resident() == store.size(), photographs == 100);
    EXPECT_EQ(store.n_upcoming_wanted() > 0, store.n_resident() < store.size());
    EXPECT_EQ(store.places().in_memory.count, store.n_resident());
    EXPECT_EQ(store.places().on_disk.count, store.size() - store.n_resident());
    EXPECT_EQ(store.release_resident(1), 0);
    ViewOrder order;
    for (int step = 0; step < 3 * store.size(); ++step) {
      const std::vector<std::int32_t> upcoming = order.upcoming(1, store.size(), 1 + store.n_upcoming_wanted());
      const auto index = static_cast<std::size_t>(order.next(1, store.size()));
      ASSERT_EQ(upcoming.front(), static_cast<std::int32_t>(index));
      const TrainView view = store.take(upcoming.front(), {upcoming.begin() + 1, upcoming.end()});
      const auto expected = whole.train[index].image->read();
      ASSERT_EQ(view.truth.numel(), static_cast<std::int64_t>(expected->pixels.size()));
      ASSERT_TRUE(std::equal(expected->pixels.begin(), expected->pixels.end(), view.truth.data_ptr<std::uint8_t>()))
          << "step " << step;
      EXPECT_EQ(view.valid.data_ptr<std::uint8_t>(), scene.train[index].valid->pixels.data()) << "copied";
      EXPECT_EQ(view.n_valid, store.stored_view(upcoming.front()).n_valid);
    }
    EXPECT_LE(memory.used(), std::max(memory.limit(), scene.train.front().image->n_bytes() + memory.fixed()));
  }
}

TEST(ImageStore, TellsWhereThePhotographsAreStored) {
  ImagePlaces places;
  EXPECT_EQ(describe(places), "none");
  places.on_device = {1200, 6150000000};
  places.on_disk = {1, 5120000};
  EXPECT_EQ(describe(places), "1200 on the GPU (6.15 GB), 1 read ahead from disk (5.1 MB)");
  places = {};
  places.in_memory = {2, 2004000000};
  EXPECT_EQ(describe(places), "2 in memory (2.00 GB)");
}

TEST(ImageStore, CountsItsBudgetInDecimalGigabytes) {
  EXPECT_EQ(image_budget(0, torch::kCPU), 0);
  EXPECT_EQ(image_budget(1.5, torch::kCPU), 1500000000);
  EXPECT_GT(image_budget(1e30, torch::kCPU), std::int64_t{1} << 60);
}

TEST(ImageStore, RejectsPhotographsThatDifferInSizeFromTheCamera) {
  Scene scene = test::make_tiny_scene();
  scene.train[1].camera.width += 1;
  EXPECT_TRUE(test::fails_with<LogicError>({scene.train[1].name, "61 x 44"},
                                           [&] { ImageStore(scene.train, torch::kCPU, 1 << 30); }));
}

}  // namespace
}  // namespace b3dgs
