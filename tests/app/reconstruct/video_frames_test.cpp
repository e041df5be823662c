#include "app/reconstruct/video_frames.h"

#include <gtest/gtest.h>

#include "app/reconstruct/fake_programs.h"
#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::FakePrograms;
using test::TempDir;
using Numbers = std::vector<std::size_t>;

TEST(Sharpness, IsHigherForSharperEdges) {
  constexpr int kSize = 16;
  std::vector<std::uint8_t> flat(kSize * kSize, 99), soft(flat), sharp(flat);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      soft[static_cast<std::size_t>(y * kSize + x)] = static_cast<std::uint8_t>(std::clamp(40 * (x - 5), 0, 200));
      sharp[static_cast<std::size_t>(y * kSize + x)] = x < 8 ? 0 : 200;
    }
  }
  EXPECT_EQ(sharpness(flat.data(), kSize, kSize), 0);
  EXPECT_GT(sharpness(sharp.data(), kSize, kSize), 2 * sharpness(soft.data(), kSize, kSize));
}

TEST(VideoFrames, TheSharpestOfEachWindowIsChosen) {
  EXPECT_EQ(sharpest_of_windows({1, 3, 2, 5, 4, 4}, 2), (Numbers{1, 3}));
  EXPECT_EQ(sharpest_of_windows({1, 3, 2, 5, 4, 4, 9}, 3), (Numbers{1, 3, 6}));
  EXPECT_EQ(sharpest_of_windows({1, 2}, 5), (Numbers{0, 1}));
  EXPECT_TRUE(sharpest_of_windows({}, 5).empty());
  for (std::size_t count = 1; count <= 100; ++count) {
    EXPECT_EQ(sharpest_of_windows(std::vector<double>(100, 1), count).size(), count);
  }
}

TEST(VideoFrames, AsManyAsTheLengthAsksFor) {
  EXPECT_EQ(automatic_frame_count(10, 300), 100u);
  EXPECT_EQ(automatic_frame_count(75, 2000), 150u);
  EXPECT_EQ(automatic_frame_count(3600, 100000), 300u);
  EXPECT_EQ(automatic_frame_count(10, 60), 60u);
}

TEST(VideoFrames, AreWrittenFromTheNumbersOfTheSharpest) {
  const TempDir folder;
  const FakePrograms programs;
  test::write_bytes(folder / "film.mp4", "x");
  std::string frames;
  for (const bool is_sharp : {false, true, false, false, false, true}) {
    std::string frame(16, 'a');
    if (is_sharp) frame[10] = '\0';
    frames += frame;
  }
  programs.set_video(frames, 6, 4);
  ProgramLog log(folder / "log", nullptr);
  std::vector<std::string> stages;
  const std::vector<std::string> names =
      extract_frames(folder / "film.mp4", 2, folder / "frames 100%", log,
                     [&](const char* stage, std::size_t, std::size_t) { stages.emplace_back(stage); });
  EXPECT_EQ(names, (std::vector<std::string>{"frame_00001.jpg", "frame_00002.jpg"}));
  ASSERT_EQ(programs.calls().size(), 2u);
  EXPECT_NE(programs.calls()[1].find("select='(eq(n,1)+eq(n,5))'"), std::string::npos) << programs.calls()[1];
  EXPECT_NE(programs.calls()[1].find("frames 100%%/frame_%05d.jpg"), std::string::npos) << programs.calls()[1];
  EXPECT_EQ(stages.size(), 7u);
}

TEST(VideoFrames, MoreThanACommandLineHolds) {
  const TempDir folder;
  const FakePrograms programs;
  test::write_bytes(folder / "film.mp4", "x");
  programs.set_video(std::string(11000, 'a'), 11000, 1);
  ProgramLog log(folder / "log", nullptr);
  const std::vector<std::string> names =
      extract_frames(folder / "film.mp4", 11000, folder / "frames", log, [](auto, auto, auto) {});
  EXPECT_EQ(names.size(), 11000u);
  EXPECT_EQ(programs.calls().size(), 4u) << "one to measure, and one for each 5000";
}

TEST(VideoFrames, OneFrameIsTooFew) {
  const TempDir folder;
  const FakePrograms programs;
  test::write_bytes(folder / "film.mp4", "x");
  ProgramLog log(folder / "log", nullptr);
  programs.set_video(std::string(16, 'a'), 1, 4);
  EXPECT_TRUE(fails_with<InputError>({"film.mp4: only one frame"}, [&] {
    extract_frames(folder / "film.mp4", 0, folder / "frames", log, [](auto, auto, auto) {});
  }));
}

TEST(VideoFrames, FilesThatAreNoVideoAreRefused) {
  const TempDir folder;
  const FakePrograms programs;
  ProgramLog log(folder / "log", nullptr);
  const auto extract = [&] { extract_frames(folder / "film.mp4", 0, folder / "frames", log, [](auto, auto, auto) {}); };
  EXPECT_TRUE(fails_with<InputError>({"film.mp4: not a video that ffmpeg can read", "Invalid data found"}, extract));
  EXPECT_FALSE(fs::exists(folder / "frames"));
  programs.set_video("", 0, 4);
  EXPECT_TRUE(fails_with<InputError>({"no frames that can be decoded"}, extract));
  programs.hide("ffmpeg");
  EXPECT_TRUE(fails_with<InputError>({"ffmpeg was not found in PATH", "apt install ffmpeg"}, extract));
}

TEST(VideoFrames, PlaylistsLeadToNoOtherFiles) {
  if (find_program("ffmpeg").empty()) GTEST_SKIP() << "no ffmpeg";
  const TempDir folder;
  ProgramLog log(folder / "log", nullptr);
  const std::string other = (folder / "private.ts").string();
  log.run({"ffmpeg", "-v", "error", "-f", "lavfi", "-i", "testsrc=size=64x48:duration=1", other});
  EXPECT_EQ(read_video_info(other, log).width, 64);
  test::write_bytes(folder / "film.mp4", "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nprivate.ts\n#EXT-X-ENDLIST\n");
  test::write_bytes(folder / "list.mp4", "ffconcat version 1.0\nfile private.ts\n");
  for (const char* name : {"film.mp4", "list.mp4"}) {
    EXPECT_TRUE(fails_with<InputError>({name, "not a video that ffmpeg can read"},
                                       [&] { read_video_info(folder / name, log); }));
  }
}

}  // namespace
}  // namespace b3dgs
