#include "scene/images/image_memory.h"

#include <gtest/gtest.h>

#include "core/host_memory.h"
#include "scene/cameras/undistort.h"
#include "scene/colmap/colmap.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::TempDir;
using test::write_bytes;

constexpr std::int64_t kUnknown = std::numeric_limits<std::int64_t>::max();

TEST(ImageMemory, HoldsAllIfTheyFit) {
  ImageMemory memory({/*limit=*/1000, /*photographs=*/900, /*largest=*/100, /*fixed=*/100, /*n_readers=*/2});
  for (int i = 0; i < 9; ++i) EXPECT_TRUE(memory.try_hold(100)) << i;
  EXPECT_EQ(memory.used(), 1000);
  EXPECT_FALSE(memory.try_hold(1));
  memory.release_held(100);
  EXPECT_TRUE(memory.try_hold(100));
  EXPECT_EQ(memory.peak(), 1000);
}

TEST(ImageMemory, ReservesBuffersIfNotAllFit) {
  ImageMemory memory({/*limit=*/4100, /*photographs=*/9000, /*largest=*/100, /*fixed=*/100, /*n_readers=*/2});
  EXPECT_EQ(memory.n_buffers(), 5);  // a quarter of 4000 for both readers
  int n_held = 0;
  while (memory.try_hold(100)) ++n_held;
  EXPECT_EQ(n_held, 30);
  {
    const ImageMemory::Use training = memory.use_buffers(5 * 100), evaluation = memory.use_buffers(5 * 100);
    EXPECT_EQ(memory.used(), memory.limit());
  }
  EXPECT_EQ(memory.used(), 3100);
  EXPECT_EQ(memory.peak(), 4100);
}

TEST(ImageMemory, HasAtLeastOneBufferPerReader) {
  ImageMemory memory({/*limit=*/100, /*photographs=*/9000, /*largest=*/100, /*fixed=*/0, /*n_readers=*/2});
  EXPECT_EQ(memory.n_buffers(), 1);
  EXPECT_FALSE(memory.try_hold(100));
  EXPECT_EQ(ImageMemory({kUnknown, 900000, 100, 0, 1}).n_buffers(), ImageMemory::kMaxBuffers);
}

TEST(ImageMemory, ReservedBytesCountAsFixedOnes) {
  ImageMemory memory({/*limit=*/1000, /*photographs=*/900, /*largest=*/100, /*fixed=*/0, /*n_readers=*/2});
  const ImageMemory planned({/*limit=*/1000, /*photographs=*/900, /*largest=*/100, /*fixed=*/200, /*n_readers=*/2});
  {
    const auto reserved = memory.reserve(200);
    ASSERT_NE(reserved, nullptr);
    EXPECT_EQ(memory.fixed(), 200);
    EXPECT_EQ(memory.used(), 200);
    EXPECT_EQ(memory.n_buffers(), planned.n_buffers());
    int n_held = 0;
    while (memory.try_hold(100)) ++n_held;
    EXPECT_EQ(n_held, 6) << "the photographs no longer fit: a buffer for each of two readers";
    for (int i = 0; i < n_held; ++i) memory.release_held(100);
    EXPECT_EQ(memory.reserve(601), nullptr) << "no buffers would be left";
    EXPECT_NE(memory.reserve(600), nullptr);
  }
  EXPECT_EQ(memory.used(), 0);
  int n_held = 0;
  while (memory.try_hold(100)) ++n_held;
  EXPECT_EQ(n_held, 10) << "as before";
  ImageMemory without_limit;
  EXPECT_EQ(without_limit.fixed(), 0);
  EXPECT_NE(without_limit.reserve(std::int64_t{1} << 50), nullptr) << "no limit";
}

TEST(ImageMemory, LimitIsInGigabytesOrFourFifthsOfAvailableMemory) {
  EXPECT_EQ(image_memory_limit(1.5, 1000), 1500000000);
  EXPECT_EQ(image_memory_limit(0, 1000), 0);
  EXPECT_EQ(image_memory_limit(-1, 1000), 800);
  EXPECT_GT(image_memory_limit(-1, kUnknown), std::int64_t{1} << 60);
  EXPECT_GT(image_memory_limit(1e30, 1000), std::int64_t{1} << 60);
}

TEST(HostMemory, IsTheMinimumOfSystemAndControlGroups) {
  const TempDir root;
  EXPECT_EQ(available_host_memory(root.path()), kUnknown);
  write_bytes(root / "proc/meminfo", "MemTotal:  9000 kB\nMemFree:  10 kB\nMemAvailable:   5000 kB\nCached: 1 kB\n");
  EXPECT_EQ(available_host_memory(root.path()), 5000 * 1024);

  write_bytes(root / "proc/self/cgroup", "0::/a/b\n");
  EXPECT_EQ(available_host_memory(root.path()), 5000 * 1024);
  const fs::path group = root / "sys/fs/cgroup";
  write_bytes(group / "a/b/memory.max", "max\n");
  write_bytes(group / "a/b/memory.current", "1000\n");
  EXPECT_EQ(available_host_memory(root.path()), 5000 * 1024);
  write_bytes(group / "a/memory.max", "1000000\n");  // the limit of the parent group applies too
  write_bytes(group / "a/memory.current", "900000\n");
  write_bytes(group / "a/memory.stat", "anon 700000\ninactive_file 200000\nactive_file 50\n");
  EXPECT_EQ(available_host_memory(root.path()), 300000);
  write_bytes(group / "a/b/memory.max", "1500\n");
  EXPECT_EQ(available_host_memory(root.path()), 500);
  write_bytes(group / "a/b/memory.current", "1600\n");
  EXPECT_EQ(available_host_memory(root.path()), 0);

  // Version 1, in a container whose own group is mounted at the root.
  write_bytes(root / "proc/self/cgroup", "12:cpu,cpuacct:/x\n9:memory:/docker/1234\n");
  write_bytes(group / "memory/memory.limit_in_bytes", "3000\n");
  write_bytes(group / "memory/memory.usage_in_bytes", "2000\n");
  write_bytes(group / "memory/memory.stat", "total_inactive_file 400\n");
  EXPECT_EQ(available_host_memory(root.path()), 1400);
}

TEST(UndistorterCache, KeepsTheMostRecentlyUsedMaps) {
  const Camera camera = camera_of({1, CameraModel::kSimpleRadial, 40, 30, {50, 20, 15, 0.1}}, "camera 1");
  constexpr std::int64_t kMap = 9 * 40 * 30;
  UndistorterCache cache(2 * kMap);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(cache.add_group(camera, "camera"), i);
  EXPECT_EQ(cache.most_kept_bytes(), 2 * kMap);
  const std::weak_ptr<const Undistorter> first = cache.get(0), second = cache.get(1);
  EXPECT_EQ(cache.get(0), first.lock());
  const std::weak_ptr<const Undistorter> third = cache.get(2);
  EXPECT_FALSE(first.expired());
  EXPECT_TRUE(second.expired()) << "the least recently used one";
  EXPECT_FALSE(third.expired());
  UndistorterCache none(kMap - 1);
  none.add_group(camera, "camera");
  EXPECT_NE(none.get(0), nullptr);
}

}  // namespace
}  // namespace b3dgs
