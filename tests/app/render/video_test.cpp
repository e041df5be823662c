// b3dgs render --video: the file has the frames, and a failure never leaves a partial file.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>

#include "app/render/video_writer.h"
#include "core/check.h"
#include "core/process/child_process.h"
#include "scene/images/image.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::Outcome;
using test::run_b3dgs;
using Words = std::vector<std::string>;

double psnr(const Image8& a, const Image8& b) {
  double sum = 0;
  for (int row = 0; row < b.height; ++row) {
    for (int i = 0; i < b.width * b.channels; ++i) {
      const int in_a = a.pixels[static_cast<std::size_t>(row * a.width * a.channels + i)],
                in_b = b.pixels[static_cast<std::size_t>(row * b.width * b.channels + i)];
      const double difference = in_a - in_b;
      sum += difference * difference;
    }
  }
  return 10 * std::log10(255.0 * 255.0 * b.width * b.height * b.channels / std::max(sum, 1e-9));
}

class Video : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    scene_ = new test::TempDir;
    const Outcome made = run_b3dgs({"synth", "orbit", (*scene_ / "scene").string(), "--points", "800", "--views", "4",
                                    "--width", "64", "--height", "48", "--quiet"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
  }
  static void TearDownTestSuite() { delete scene_; }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  /// Renders a turntable of 7 frames.
  static Outcome render(Words more, const test::RunOptions& options = {}) {
    Words words{"render",    (*scene_ / "scene/truth.ply").string(),
                "--device",  "cpu",
                "--quiet",   "--path",
                "turntable", "--frames",
                "7",         "--up",
                "z"};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words, options);
  }
  /// Returns the frames of a video, decoded by ffmpeg.
  std::vector<Image8> decode(const std::string& video) const {
    fs::create_directories(folder_ / "decoded");
    std::string output;
    const ChildResult result = run_program_lines(
        {"ffmpeg", "-loglevel", "error", "-i", video, "-fps_mode", "passthrough", "-y", path("decoded/%05d.png")},
        [&](const std::string& line) { output += line; });
    EXPECT_TRUE(result.succeeded()) << output;
    std::vector<Image8> frames;
    for (int i = 1; fs::exists(folder_ / "decoded" / name_of(i)); ++i) {
      frames.push_back(read_image(folder_ / "decoded" / name_of(i), false));
    }
    remove_tree(folder_ / "decoded");
    return frames;
  }
  static std::string name_of(int i) {
    const std::string number = std::to_string(i);
    return std::string(5 - number.size(), '0') + number + ".png";
  }
  /// Puts a program `ffmpeg` with this script first in PATH, until the end of the test.
  void replace_ffmpeg(const std::string& script) {
    test::write_bytes(folder_ / "bin/ffmpeg", "#!/bin/sh\n" + script);
    fs::permissions(folder_ / "bin/ffmpeg", fs::perms::owner_all);
    set_path(path("bin") + ":" + path_);
  }
  static void set_path(const std::string& folders) { ::setenv("PATH", folders.c_str(), 1); }
  void TearDown() override { set_path(path_); }
  std::vector<std::string> files() const {
    std::vector<std::string> names;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder_.path())) {
      if (!entry.is_directory()) names.push_back(entry.path().filename().string());
    }
    std::sort(names.begin(), names.end());
    return names;
  }

  static test::TempDir* scene_;
  test::TempDir folder_;
  const std::string path_ = std::getenv("PATH") == nullptr ? "/usr/bin:/bin" : std::getenv("PATH");
};

test::TempDir* Video::scene_ = nullptr;

#define B3DGS_NEED_FFMPEG() \
  if (find_program("ffmpeg").empty()) GTEST_SKIP() << "ffmpeg is not installed"

TEST_F(Video, HasTheFramesInEveryFormat) {
  B3DGS_NEED_FFMPEG();
  const auto expect_frames = [&](const std::string& name, const std::string& of, const std::string& images, double db) {
    const Outcome outcome = render(
        {"--video", path(name), "--video_of", of, "--output", path("images"), "--width", "128", "--height", "96"});
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_NE(outcome.out.find("7 frames"), std::string::npos) << outcome.out;
    const std::vector<Image8> frames = decode(path(name));
    ASSERT_EQ(frames.size(), 7u) << name;
    for (const int i : {0, 3, 6}) {
      const Image8& frame = frames[static_cast<std::size_t>(i)];
      EXPECT_EQ(frame.width, 128);
      EXPECT_EQ(frame.height, 96);
      EXPECT_GT(psnr(read_image(folder_ / "images" / images / name_of(i), false), frame), db) << name << " frame " << i;
    }
  };
  expect_frames("a.mp4", "color", "renders", 30);
  expect_frames("b.webm", "color", "renders", 30);
  expect_frames("c.gif", "color", "renders", 25);  // 256 colours
  expect_frames("d.mp4", "alpha", "alpha", 30);
  expect_frames("e.mp4", "depth", "depth", 25);  // saturated colours, at half their resolution
  EXPECT_EQ(files(), (Words{"a.mp4", "b.webm", "c.gif", "d.mp4", "e.mp4"})) << "nothing else is left";
}

TEST_F(Video, OfOddSizeLosesOneRowAndColumn) {
  B3DGS_NEED_FFMPEG();
  const Outcome outcome =
      render({"--video", path("odd.mp4"), "--output", path("images"), "--width", "63", "--height", "47"});
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const std::vector<Image8> frames = decode(path("odd.mp4"));
  ASSERT_EQ(frames.size(), 7u);
  EXPECT_EQ(frames[0].width, 62);
  EXPECT_EQ(frames[0].height, 46);
  EXPECT_GT(psnr(read_image(folder_ / "images/renders/00000.png", false), frames[0]), 28);
}

TEST_F(Video, OfAPathIsFullHdUnlessASizeIsNamed) {
  B3DGS_NEED_FFMPEG();
  const auto size_of_video = [&](const std::string& name, Words words) {
    words.insert(words.begin(), {"render", (*scene_ / "scene/truth.ply").string(), "-s", (*scene_ / "scene").string(),
                                 "--video", path(name), "--frames", "1", "--device", "cpu", "--quiet"});
    const Outcome outcome = run_b3dgs(words);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
    const std::vector<Image8> frames = decode(path(name));
    return frames.empty() ? ImageSize{} : frames[0].size();
  };
  EXPECT_EQ(size_of_video("a.mp4", {"--path", "orbit"}), (ImageSize{1920, 1080}));
  EXPECT_EQ(size_of_video("b.webm", {"--path", "interpolated"}), (ImageSize{1920, 1080}));
  EXPECT_EQ(size_of_video("c.mp4", {"--path", "orbit", "--width", "128"}), (ImageSize{128, 96}));
  EXPECT_EQ(size_of_video("d.mp4", {"--path", "orbit", "-r", "1"}), (ImageSize{64, 48}));
  EXPECT_EQ(size_of_video("e.gif", {"--path", "orbit"}), (ImageSize{64, 48}));
}

TEST_F(Video, WithoutOutputIsAllThatIsWritten) {
  B3DGS_NEED_FFMPEG();
  const std::size_t before = static_cast<std::size_t>(
      std::distance(fs::recursive_directory_iterator(scene_->path()), fs::recursive_directory_iterator()));
  ASSERT_EQ(render({"--video", path("a.mp4")}).exit_code, 0);
  EXPECT_EQ(static_cast<std::size_t>(
                std::distance(fs::recursive_directory_iterator(scene_->path()), fs::recursive_directory_iterator())),
            before);
  EXPECT_EQ(files(), Words{"a.mp4"});
}

TEST_F(Video, IsNotReplacedByAccident) {
  B3DGS_NEED_FFMPEG();
  test::write_bytes(folder_ / "a.mp4", "mine");
  const Outcome refused = render({"--video", path("a.mp4")});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_NE(refused.err.find("a.mp4 exists"), std::string::npos) << refused.err;
  EXPECT_EQ(test::read_bytes(folder_ / "a.mp4"), "mine");
  EXPECT_EQ(render({"--video", path("a.mp4"), "--overwrite"}).exit_code, 0);
  EXPECT_EQ(decode(path("a.mp4")).size(), 7u);
}

TEST_F(Video, WithoutFfmpegSaysHowToInstallIt) {
  set_path(path("empty"));
  const Outcome outcome = render({"--video", path("a.mp4")});
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_NE(outcome.err.find("apt-get install ffmpeg"), std::string::npos) << outcome.err;
  EXPECT_TRUE(files().empty());
}

TEST_F(Video, FailureOfFfmpegIsAnErrorWithItsLastLine) {
  for (const char* reads : {"", "cat > /dev/null\n"}) {  // fails at once, and at the end
    replace_ffmpeg(std::string(reads) + "echo first >&2\necho 'no such encoder' >&2\nexit 3\n");
    test::write_bytes(folder_ / "a.mp4", "mine");
    const Outcome outcome = render({"--video", path("a.mp4"), "--overwrite"});
    EXPECT_EQ(outcome.exit_code, 2);
    EXPECT_NE(outcome.err.find("a.mp4: ffmpeg failed (exit code 3): no such encoder"), std::string::npos)
        << outcome.err;
    EXPECT_EQ(files(), Words{"a.mp4"});
    EXPECT_EQ(test::read_bytes(folder_ / "a.mp4"), "mine");
  }
}

TEST_F(Video, ASignalLeavesNoFile) {
  replace_ffmpeg("touch " + path("bin/started") + "\nsleep 60\n");  // does not read, so that rendering waits for it
  test::RunOptions options;
  options.signal_when = [&] { return fs::exists(folder_ / "bin/started"); };
  options.signal = SIGTERM;
  const Outcome outcome = render({"--video", path("a.mp4"), "--width", "1280", "--height", "960"}, options);
  EXPECT_EQ(outcome.exit_code, 128 + SIGTERM) << outcome.err;
  EXPECT_TRUE(files().empty()) << files()[0];
}

TEST_F(Video, BadNamesAndSizesAreErrors) {
  B3DGS_NEED_FFMPEG();
  for (const char* name : {"a.avi", "a", "a.mp4.png"}) {
    const Outcome outcome = render({"--video", path(name)});
    EXPECT_EQ(outcome.exit_code, 2);
    EXPECT_NE(outcome.err.find(".mp4, .webm or .gif"), std::string::npos) << outcome.err;
  }
  EXPECT_TRUE(fails_with<InputError>({"a.mp4", "at least 2 x 2"}, [&] {
    VideoWriter(folder_ / "a.mp4", {5, 1}, 3, 30, -1);
  }));
  EXPECT_TRUE(files().empty());
}

}  // namespace
}  // namespace b3dgs
