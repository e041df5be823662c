// Tests with the real programs colmap and ffmpeg, if they are installed.
#include <gtest/gtest.h>

#include "app/reconstruct/reconstruct.h"
#include "app/reconstruct/video_frames.h"
#include "core/process/child_process.h"
#include "core/text.h"
#include "data_synth/synth_writer.h"
#include "scene/images/image.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::TempDir;

TEST(InstalledColmap, RegistersASyntheticScene) {
  if (find_program("colmap").empty()) GTEST_SKIP() << "colmap is not installed";
  const TempDir folder;
  SynthConfig config;
  config.scene = "orbit";
  config.output = (folder / "synth").string();
  config.views = 72;  // 5 degrees apart
  config.width = 320;
  config.height = 240;
  config = with_scene_defaults(config);
  write_synth_scene(config, make_scene(config), {});
  for (int i = 0; i < 8; ++i) {
    const std::string name = print_to_string("%05d.png", i);
    test::write_bytes(folder / ("photos/" + name), test::read_bytes(folder / ("synth/images/" + name)));
  }
  setenv("QT_QPA_PLATFORM", "offscreen", 0);
  ReconstructOptions options;
  options.input = (folder / "photos").string();
  options.output = (folder / "scene").string();
  options.camera_model = "SIMPLE_PINHOLE";
  options.threads = 2;
  std::vector<std::string> stages;
  const ReconstructResult result = reconstruct(options, [&](const std::string& stage, std::size_t done, std::size_t) {
    stages.push_back(stage + (done > 0 ? "" : " begins"));
  });
  EXPECT_EQ(result.n_photographs, 8u);
  EXPECT_GE(result.n_registered, 7u);
  EXPECT_LT(result.mean_error, 1);
  EXPECT_TRUE(fs::exists(folder / "scene/sparse/0/points3D.bin"));
  for (const char* stage : {"extracting features", "matching, pairs", "registering photographs"}) {
    EXPECT_NE(std::find(stages.begin(), stages.end(), stage), stages.end()) << "no progress of " << stage;
  }
}

TEST(InstalledFfmpeg, WritesTheSharpestFrames) {
  if (find_program("ffmpeg").empty()) GTEST_SKIP() << "ffmpeg is not installed";
  const TempDir folder;
  const std::string video = (folder / "film: 1.mp4").string();
  // Every 5th frame is sharp, beginning with the 3rd.
  const ChildResult made = run_program_lines(
      {"ffmpeg", "-nostdin", "-v", "error", "-f", "lavfi", "-i", "testsrc=size=160x120:rate=30:duration=1", "-vf",
       "boxblur=3:enable='not(eq(mod(n,5),3))'", "-c:v", "mpeg4", "-q:v", "2", "file:" + video},
      {});
  if (!made.succeeded()) GTEST_SKIP() << "this ffmpeg cannot make the test's video";
  ProgramLog log(folder / "log", nullptr);
  const VideoInfo info = read_video_info(video, log);
  EXPECT_EQ(info.n_frames, 30u);
  EXPECT_NEAR(info.seconds, 1, 0.1);
  std::size_t measured = 0;
  const std::vector<std::string> names =
      extract_frames(video, 6, folder / "frames", log, [&](const char* stage, std::size_t done, std::size_t) {
        if (std::string(stage) == "measuring frames") measured = done;
      });
  EXPECT_EQ(measured, 30u);
  ASSERT_EQ(names.size(), 6u);
  for (const std::string& name : names) {
    const Image8 image = read_image(folder / "frames" / name, false);
    std::vector<std::uint8_t> green;
    for (std::size_t i = 1; i < image.pixels.size(); i += 3) green.push_back(image.pixels[i]);
    EXPECT_EQ(image.width, 160);
    EXPECT_GT(sharpness(green.data(), image.width, image.height), 1000) << name << " is blurred";
  }
}

TEST(InstalledFfmpeg, WritesHundredsOfFrames) {
  if (find_program("ffmpeg").empty()) GTEST_SKIP() << "ffmpeg is not installed";
  const TempDir folder;
  const std::string video = (folder / "film.mp4").string();
  const ChildResult made =
      run_program_lines({"ffmpeg", "-nostdin", "-v", "error", "-f", "lavfi", "-i",
                         "testsrc=size=32x24:rate=25:duration=12", "-c:v", "mpeg4", "file:" + video},
                        {});
  if (!made.succeeded()) GTEST_SKIP() << "this ffmpeg cannot make the test's video";
  ProgramLog log(folder / "log", nullptr);
  const std::vector<std::string> names = extract_frames(video, 280, folder / "frames", log, [](auto, auto, auto) {});
  EXPECT_EQ(names.size(), 280u);
  EXPECT_TRUE(fs::exists(folder / "frames/frame_00280.jpg"));
}

}  // namespace
}  // namespace b3dgs
