// Invalid input is rejected with a one-line error and exit code 2. No file is lost or left half-written.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <limits>

#include "core/files/atomic_file.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;
using Words = std::vector<std::string>;

/// Writes a scene of 3 views and 300 points without the program.
void write_scene(const fs::path& folder) {
  ColmapModel model;
  model.cameras[1] = {1, CameraModel::kPinhole, 32, 24, {30, 30, 16, 12}};
  for (std::uint32_t i = 0; i < 3; ++i) {
    ColmapImage image;
    image.id = i + 1;
    image.camera_id = 1;
    image.translation = {0.1 * i, 0, 0};
    image.name = "view" + std::to_string(i) + ".jpg";
    model.images.push_back(image);
    write_image(folder / "images" / image.name, Image8(32, 24, 3));
  }
  for (std::uint64_t i = 0; i < 300; ++i)
    model.points.push_back(
        {i + 1, {0.01 * static_cast<double>(i % 20), 0.01 * static_cast<double>(i / 20), 2}, {200, 100, 50}, 0});
  write_colmap_model(folder / "sparse" / "0", model, ColmapFormat::kBinary);
}

void overwrite(const fs::path& path, std::size_t offset, const void* bytes, std::size_t n) {
  std::string content = read_bytes(path);
  ASSERT_LE(offset + n, content.size());
  std::memcpy(content.data() + offset, bytes, n);
  write_file(path, content);
}

template <class Value>
void overwrite(const fs::path& path, std::size_t offset, Value value) {
  overwrite(path, offset, &value, sizeof value);
}

void truncate_file(const fs::path& path, std::size_t bytes_less) {
  fs::resize_file(path, fs::file_size(path) - bytes_less);
}

/// images.bin: count (8 bytes), then per image id (4), quaternion (32), translation (24), camera id (4), name, ...
constexpr std::size_t kFirstCameraId = 68;
/// cameras.bin: count (8 bytes), then per camera id (4), model (4), width (8), height (8), parameters, ...
constexpr std::size_t kFirstParameter = 32;

struct BadScene {
  const char* name;
  std::function<void(const fs::path& scene)> damage;
  std::vector<std::string> parts;  // parts of the error message
};

const std::vector<BadScene>& bad_scenes() {
  static const std::vector<BadScene> rows{
      {"NoSuchFolder", [](const fs::path& s) { remove_tree(s); }, {"scene"}},
      {"NoModel", [](const fs::path& s) { remove_tree(s / "sparse"); }, {"scene"}},
      {"NoCamerasFile", [](const fs::path& s) { fs::remove(s / "sparse/0/cameras.bin"); }, {"cameras"}},
      {"NoPointsFile", [](const fs::path& s) { fs::remove(s / "sparse/0/points3D.bin"); }, {"points3D"}},
      {"EmptyImagesFile", [](const fs::path& s) { fs::resize_file(s / "sparse/0/images.bin", 0); }, {"images.bin"}},
      {"TruncatedCameras", [](const fs::path& s) { truncate_file(s / "sparse/0/cameras.bin", 4); }, {"cameras.bin"}},
      {"TruncatedImages", [](const fs::path& s) { truncate_file(s / "sparse/0/images.bin", 3); }, {"images.bin"}},
      {"TruncatedPoints", [](const fs::path& s) { truncate_file(s / "sparse/0/points3D.bin", 9); }, {"points3D.bin"}},
      {"MoreImagesThanTheFileHolds",
       [](const fs::path& s) { overwrite(s / "sparse/0/images.bin", 0, std::uint64_t{1000000000000}); },
       {"images.bin", "1000000000000"}},
      {"MorePointsThanTheFileHolds",
       [](const fs::path& s) { overwrite(s / "sparse/0/points3D.bin", 0, std::uint64_t{77777}); },
       {"points3D.bin", "77777"}},
      {"CameraNotANumber",  // in all images
       [](const fs::path& s) {
         overwrite(s / "sparse/0/cameras.bin", kFirstParameter, std::numeric_limits<double>::quiet_NaN());
       },
       {"cameras.bin", "nan"}},
      {"UnknownCameraId",
       [](const fs::path& s) { overwrite(s / "sparse/0/images.bin", kFirstCameraId, std::uint32_t{42}); },
       {"images.bin", "42"}},
      {"UnsupportedCameraModel",
       [](const fs::path& s) { overwrite(s / "sparse/0/cameras.bin", 12, std::int32_t{999}); },
       {"cameras.bin", "999"}},
      {"NoImageOnDisk",
       [](const fs::path& s) {
         remove_tree(s / "images");
         fs::create_directories(s / "images");
       },
       {"images"}},
      {"CorruptJpeg",
       [](const fs::path& s) {
         const std::string jpeg = read_bytes(s / "images/view1.jpg");
         write_file(s / "images/view1.jpg", jpeg.substr(0, 40) + std::string(200, 'x'));
       },
       {"view1.jpg"}},
      {"TruncatedJpeg", [](const fs::path& s) { truncate_file(s / "images/view1.jpg", 60); }, {"view1.jpg"}},
      {"NotAnImage", [](const fs::path& s) { write_file(s / "images/view2.jpg", "hello"); }, {"view2.jpg"}},
  };
  return rows;
}

void expect_refused(const Outcome& outcome, const std::vector<std::string>& parts) {
  EXPECT_EQ(outcome.exit_code, 2) << outcome.err;
  EXPECT_EQ(outcome.err.compare(0, 7, "error: "), 0) << outcome.err;
  EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  for (const std::string& part : parts)
    EXPECT_NE(outcome.err.find(part), std::string::npos) << part << " in " << outcome.err;
}

class RejectsScene : public ::testing::TestWithParam<BadScene> {};

TEST_P(RejectsScene, InOneLineAndWritesNothing) {
  const test::TempDir folder;
  write_scene(folder.path() / "scene");
  GetParam().damage(folder.path() / "scene");
  const Outcome outcome = run_b3dgs({"train", "-s", (folder.path() / "scene").string(), "-m",
                                     (folder.path() / "model").string(), "--iterations", "2", "--quiet"});
  expect_refused(outcome, GetParam().parts);
  EXPECT_FALSE(fs::exists(folder.path() / "model"));
}

INSTANTIATE_TEST_SUITE_P(BadScene, RejectsScene, ::testing::ValuesIn(bad_scenes()),
                         [](const auto& info) { return std::string(info.param.name); });

class BadInput : public ::testing::Test {
 protected:
  BadInput() { write_scene(scene()); }
  fs::path scene() const { return folder_.path() / "scene"; }
  fs::path model() const { return folder_.path() / "model"; }
  Outcome train(const Words& more) const {
    Words words{"train", "-s", scene().string(), "-m", model().string(), "--iterations", "4", "--quiet"};
    words.insert(words.end(), more.begin(), more.end());
    return run_b3dgs(words);
  }
  fs::path checkpoint() const { return model() / "checkpoints" / "iteration_4.b3dgs"; }

  test::TempDir folder_;
};

TEST_F(BadInput, TheIntactSceneTrains) {
  EXPECT_EQ(train({}).exit_code, 0);
}

TEST_F(BadInput, AMissingPhotographIsAWarning) {
  fs::remove(scene() / "images/view1.jpg");
  const Outcome outcome = train({});
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_EQ(outcome.err.rfind("warning: " + (scene() / "images").string() + ": ", 0), 0u) << outcome.err;
  EXPECT_NE(outcome.err.find(
                "1 of 3 registered images not found (first: view1.jpg); training and evaluation leave them out\n"),
            std::string::npos)
      << outcome.err;
  EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
}

TEST_F(BadInput, WrongPly) {
  write_file(folder_.path() / "wrong.ply", "not a PLY");
  const std::string ply = (folder_.path() / "wrong.ply").string();
  expect_refused(train({"--init_ply", ply}), {"wrong.ply"});
  expect_refused(run_b3dgs({"render", "--ply", ply, "-s", scene().string()}), {"wrong.ply"});
  expect_refused(run_b3dgs({"info", ply}), {"wrong.ply: not a PLY file"});
  write_file(ply,
             "ply\nformat binary_little_endian 1.0\nelement vertex 1000\nproperty float x\nproperty float y\n"
             "property float z\nend_header\n");
  expect_refused(train({"--init_ply", ply}), {"wrong.ply"});
  expect_refused(run_b3dgs({"info", ply}), {"wrong.ply"});
}

TEST_F(BadInput, WrongCrop) {
  const std::string file = (folder_.path() / "crop.txt").string();
  expect_refused(train({"--crop", "1,2,3"}), {"--crop 1,2,3: expected a box"});
  expect_refused(train({"--crop", file}), {"crop.txt", "no such file"});
  write_file(file, "0,0,0,1\n0,0,0,2\n");
  expect_refused(train({"--crop", file}), {"crop.txt:2", "found another one"});
  write_file(file, "100,100,100,1\n");
  expect_refused(train({"--crop", file}), {"--crop 100,100,100,1: none of the 300 initial Gaussians is inside"});
  expect_refused(train({"--crop", "0,0,2,1", "--strategy", "mcmc"}),
                 {"--crop: expected --strategy budget, found mcmc"});
  EXPECT_FALSE(fs::exists(model() / "point_cloud"));
  write_file(file, "0,0,2,1\n");
  ASSERT_EQ(train({"--crop", file}).exit_code, 0);
  fs::remove(file);  // the checkpoint has the region
  EXPECT_EQ(train({"--resume", checkpoint().string(), "--iterations", "6"}).exit_code, 0);
}

TEST_F(BadInput, WrongCheckpoint) {
  ASSERT_EQ(train({}).exit_code, 0);
  const std::string good = read_bytes(checkpoint());
  ASSERT_GT(good.size(), 200u);
  const auto resume = [&] { return train({"--resume", checkpoint().string(), "--iterations", "6"}); };

  write_file(checkpoint(), "not a checkpoint");
  expect_refused(resume(), {"iteration_4.b3dgs"});
  write_file(checkpoint(), good.substr(0, good.size() / 2));
  expect_refused(resume(), {"iteration_4.b3dgs"});
  std::string flipped = good;
  flipped[good.size() / 2] = static_cast<char>(flipped[good.size() / 2] ^ 1);
  write_file(checkpoint(), flipped);
  expect_refused(resume(), {"iteration_4.b3dgs"});
  fs::remove(checkpoint());
  expect_refused(resume(), {"iteration_4.b3dgs"});
  write_file(checkpoint(), good);
  EXPECT_EQ(resume().exit_code, 0);
}

TEST_F(BadInput, ADamagedCheckpointMakesAutoFallBack) {
  ASSERT_EQ(train({"--checkpoint_iterations", "2"}).exit_code, 0);
  fs::resize_file(checkpoint(), fs::file_size(checkpoint()) / 2);
  const Outcome outcome = train({"--resume", "auto"});
  EXPECT_EQ(outcome.exit_code, 0) << outcome.err;
  EXPECT_NE(outcome.err.find("iteration_4.b3dgs"), std::string::npos) << outcome.err;
  EXPECT_NE(outcome.out.find("iteration_2.b3dgs"), std::string::npos) << outcome.out;
}

TEST_F(BadInput, UnwritableFolder) {
  write_file(folder_.path() / "file", "");
  const std::string below_a_file = (folder_.path() / "file" / "model").string();
  expect_refused(run_b3dgs({"train", "-s", scene().string(), "-m", below_a_file, "--quiet"}), {below_a_file});
  expect_refused(run_b3dgs({"synth", "orbit", below_a_file, "--views", "1", "--points", "10", "--quiet"}),
                 {below_a_file});
}

TEST_F(BadInput, FullDisk) {
  test::RunOptions full;
  full.file_size_limit = 2000;  // input.ply is larger
  const Outcome outcome = run_b3dgs({"train", "-s", scene().string(), "-m", model().string(), "--quiet"}, full);
  expect_refused(outcome, {"model"});
  if (!fs::exists(model())) return;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(model())) {
    EXPECT_FALSE(entry.is_regular_file() && entry.file_size() == 2000) << entry.path() << " is truncated";
    EXPECT_NE(entry.path().extension(), ".tmp") << entry.path();
  }
}

TEST_F(BadInput, AFullDiskLeavesNothingOfASyntheticScene) {
  test::RunOptions full;
  full.file_size_limit = 2000;  // truth.ply is larger
  const fs::path made = folder_.path() / "made";
  const Words words{"synth", "orbit", made.string(), "--views", "2", "--points", "100", "--quiet"};
  expect_refused(run_b3dgs(words, full), {"cannot write " + (made / "truth.ply").string(), "ulimit -f"});
  EXPECT_FALSE(fs::exists(made));
}

TEST_F(BadInput, ASyntheticSceneIsReplacedOnlyIfAsked) {
  const fs::path made = folder_.path() / "made";
  Words words{"synth", "orbit", made.string(), "--views", "2", "--points", "100", "--quiet"};
  EXPECT_EQ(run_b3dgs(words).exit_code, 0);
  const std::string options = read_bytes(made / "synth.json");
  words.insert(words.end(), {"--seed", "1"});
  expect_refused(run_b3dgs(words), {"already holds a synthetic scene", made.string(), "--overwrite"});
  EXPECT_EQ(read_bytes(made / "synth.json"), options);
  words.emplace_back("--overwrite");
  EXPECT_EQ(run_b3dgs(words).exit_code, 0);
  EXPECT_NE(read_bytes(made / "synth.json"), options);
}

TEST_F(BadInput, AFullDiskDuringAComparisonTellsHowToContinue) {
  test::RunOptions full;
  full.file_size_limit = 20000;  // a PLY or a checkpoint is larger
  const fs::path output = folder_.path() / "comparison";
  const Words words{
      "compare", scene().string(), "-m",     output.string(), "--configs", "naive,shared-memory", "--iterations",
      "4",       "--no_eval",      "--quiet"};
  const Outcome failed = run_b3dgs(words, full);
  expect_refused(failed,
                 {"cannot write " + output.string(), "continue with b3dgs compare --resume -m " + output.string()});
  EXPECT_EQ(failed.err.find("--resume auto"), std::string::npos) << failed.err;
  const Outcome resumed = run_b3dgs({"compare", "--resume", "-m", output.string(), "--quiet"});
  EXPECT_EQ(resumed.exit_code, 0) << resumed.err;
}

TEST_F(BadInput, CommandLines) {
  expect_refused(run_b3dgs({"trian"}), {"trian", "did you mean train?"});
  expect_refused(run_b3dgs({"metrics.py"}), {"did you mean eval?"});
  expect_refused(run_b3dgs({"eval", "-m", "a", "b", "c"}), {"unexpected argument \"b\"", "once for each"});
  expect_refused(run_b3dgs({"train"}), {"missing argument: SOURCE_PATH", "-s"});
  expect_refused(run_b3dgs({"train", (scene() / "images/view0.jpg").string()}), {"not a folder", "b3dgs reconstruct"});
  expect_refused(run_b3dgs({"train", "--resume", "none"}), {"nothing to resume: none not found"});
  expect_refused(run_b3dgs({"eval"}), {"missing argument: MODEL_PATH"});
  expect_refused(run_b3dgs({"synth", "orbit"}), {"OUTPUT"});
  expect_refused(run_b3dgs({"train", "-s", scene().string(), "--iteratons", "5"}), {"did you mean --iterations?"});
  expect_refused(run_b3dgs({"eval", "-m", scene().string()}), {"no trained model"});
  expect_refused(run_b3dgs({"eval", "-m", (scene() / "images/view0.jpg").string()}), {"expected a model folder"});
  expect_refused(train({"-r", "3"}), {"-r 3", "3 px wide", "1, 2, 4 or 8"});
  expect_refused(train({"--data-factor", "3"}), {"-r 3"});
  const Outcome info = run_b3dgs({"info", (scene() / "images").string()});
  expect_refused(info, {"neither a scene nor a model folder", "b3dgs reconstruct"});
  const Outcome report = run_b3dgs({"report", scene().string()});
  expect_refused(report, {"neither a model folder nor a comparison"});
  EXPECT_EQ(report.out, "");
  expect_refused(run_b3dgs({"report", (scene() / "images/view0.jpg").string()}), {"not a directory", "view0.jpg"});
  expect_refused(run_b3dgs({"bench", "stepp"}), {"stepp", "did you mean step?"});
  expect_refused(run_b3dgs({"bench", "nowhere"}), {"nowhere", "expected a COLMAP or model folder"});
  expect_refused(run_b3dgs({"info", (folder_.path() / "none").string()}), {"none"});
  expect_refused(run_b3dgs({"render", "--ply", "x.ply"}), {"-s"});
  expect_refused(train({"--resume", "auto", "--config", "none.json"}), {"none.json"});
  // These options would have no effect.
  expect_refused(run_b3dgs({"render", "-m", "model", "--frames", "5"}), {"--frames", "--path interpolated"});
  expect_refused(run_b3dgs({"render", "--ply", "x.ply", "-s", "scene", "--iteration", "5"}), {"--iteration"});
  expect_refused(run_b3dgs({"synth", "orbit", "new", "--skew", "2"}), {"--skew", "street"});
  expect_refused(run_b3dgs({"synth", "street", "new", "--sh_degree", "2"}), {"--sh_degree", "orbit"});
  expect_refused(run_b3dgs({"compare", "scene", "--seed", "1", "--seeds", "2"}), {"--seed and --seeds"});
}

TEST_F(BadInput, CudaWithoutAGpu) {
  if (std::system("nvidia-smi -L > /dev/null 2>&1") == 0) GTEST_SKIP() << "this machine has a GPU";
  expect_refused(train({"--device", "cuda"}), {"--device cpu"});
  EXPECT_FALSE(fs::exists(model()));
}

}  // namespace
}  // namespace b3dgs
