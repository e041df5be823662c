#include "app/reconstruct/colmap_program.h"

#include <gtest/gtest.h>

#include "app/reconstruct/fake_programs.h"
#include "app/reconstruct/scene_folder.h"
#include "support/expect_error.h"
#include "support/files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::FakePrograms;
using test::TempDir;
using Words = std::vector<std::string>;

TEST(ColmapProgress, ReadsStepsOfSeveralVersions) {
  const auto expect = [](const char* line, std::size_t done, std::size_t total) {
    const auto step = colmap_step(line);
    ASSERT_TRUE(step) << line;
    EXPECT_EQ(step->done, done) << line;
    EXPECT_EQ(step->total, total) << line;
  };
  expect("Processed file [3/50]", 3, 50);
  expect("I20240131 10:11:12.123456 42 feature_extraction.cc:258] Processed file [3/50]", 3, 50);
  expect("Matching image [7/50] in 0.2s", 7, 50);
  expect("Matching block [1/4, 1/4] in 12.3s", 1, 16);
  expect("Matching block [2/4, 3/4]", 6, 16);  // which begins
  expect("I20250101 10:11:12.1 42 feature_matching.cc:80] Processing block [1/2, 1/2]", 0, 4);
  expect("Registering image #12 (27)", 27, 0);
  expect("I20250101 10:11:12.1 42 incremental_pipeline.cc:47] Registering image #12 (num_reg_frames=27)", 27, 0);
  for (const char* line : {"", "Processed file", "Processed file [", "Processed file [99999999999999999999999/2]",
                           "Matching block [0/4, 1/4]", "Registering image #12", "=> Image sees 12 / 30 points"}) {
    EXPECT_FALSE(colmap_step(line)) << line;
  }
}

TEST(ColmapProgress, CountsThePairsOfBlocks) {
  for (const std::size_t block : {2, 3, 5}) {
    for (const std::size_t n : {2, 3, 7, 10}) {
      // As COLMAP goes through them: of two photographs in different blocks, one of the two blocks has the pair.
      const std::size_t n_rows = (n + block - 1) / block;
      std::vector<std::size_t> counts(n_rows * n_rows);
      for (std::size_t a = 0; a < n; ++a) {
        for (std::size_t b = 0; b < n; ++b) {
          const std::size_t in_a = a % block, in_b = b % block;
          const bool is_here = (a > b && in_a <= in_b) || (a < b && in_a < in_b);
          counts[a / block * n_rows + b / block] += is_here ? 1 : 0;
        }
      }
      std::size_t sum = 0;
      for (std::size_t i = 0; i < counts.size(); ++i) {
        EXPECT_EQ(pairs_in_blocks(n, block, i), sum) << n << " photographs, blocks of " << block;
        sum += counts[i];
      }
      EXPECT_EQ(pairs_in_blocks(n, block, 1000), n * (n - 1) / 2);
    }
  }
}

TEST(ColmapProgress, ReadsTheCameraOfAPhotograph) {
  EXPECT_EQ(colmap_camera("  Camera:          #12 - OPENCV"), 12u);
  EXPECT_EQ(colmap_camera("I20240131 10:11:12.1 42 feature_extraction.cc:269]   Camera:          #3 - OPENCV"), 3u);
  EXPECT_FALSE(colmap_camera("  Camera model:    OPENCV"));
  EXPECT_FALSE(colmap_camera("Loading cameras... 1 in 0.000s"));
}

TEST(ColmapProgram, FindsOptionsInTheHelpText) {
  const std::set<std::string> options = options_in_help({"COLMAP 3.8", "  -h [ --help ] ", "  --database_path arg",
                                                         "  --SiftExtraction.use_gpu arg (=1)", "   {--x}", "--y=2"});
  EXPECT_EQ(options, (std::set<std::string>{"database_path", "SiftExtraction.use_gpu", "y"}));
}

/// Returns the words after `name`, or "" if the command does not have it.
std::string value_of(const Words& command, const std::string& name) {
  for (std::size_t i = 0; i + 1 < command.size(); ++i) {
    if (command[i] == "--" + name) return command[i + 1];
  }
  return "";
}

TEST(ColmapProgram, UsesTheNamesThatThisVersionHas) {
  const TempDir folder;
  const FakePrograms programs;
  ReconstructOptions options;
  options.use_gpu = "0";
  options.threads = 3;
  for (const std::string version : {"3.8", "3.13"}) {
    programs.set_colmap_version(version);
    ProgramLog log(folder / "log", nullptr);
    ColmapProgram colmap(options, {folder / "db", folder / "images", folder / "models"}, log);
    EXPECT_EQ(colmap.version().rfind("COLMAP " + version + " ", 0), 0u) << colmap.version();
    EXPECT_NE(colmap.version().find("without CUDA"), std::string::npos);
    const Words extract = colmap.extract_command(folder / "list", true, 4),
                match = colmap.match_command("exhaustive", 80);
    const std::string kind = version == "3.8" ? "Sift" : "Feature";
    const std::string other = version == "3.8" ? "Feature" : "Sift";
    EXPECT_EQ(value_of(extract, kind + "Extraction.use_gpu"), "0");
    EXPECT_EQ(value_of(extract, kind + "Extraction.num_threads"), "3");
    EXPECT_EQ(value_of(extract, other + "Extraction.use_gpu"), "");
    EXPECT_EQ(value_of(extract, "ImageReader.single_camera"), "1");
    EXPECT_EQ(value_of(extract, "ImageReader.existing_camera_id"), "4");
    EXPECT_EQ(value_of(extract, "ImageReader.camera_model"), "OPENCV");
    EXPECT_EQ(value_of(match, kind + "Matching.use_gpu"), "0");
    EXPECT_EQ(value_of(match, other + "Matching.use_gpu"), "");
    EXPECT_EQ(match[1], "exhaustive_matcher");
    EXPECT_EQ(value_of(match, "ExhaustiveMatching.block_size"), "16");
    EXPECT_EQ(value_of(colmap.map_command("mapper"), "Mapper.num_threads"), "3");
    EXPECT_TRUE(colmap.has_command("mapper"));
    EXPECT_FALSE(colmap.has_command("global_mapper"));
  }
}

TEST(ColmapProgram, SharesCamerasAsAsked) {
  const TempDir folder;
  const FakePrograms programs;
  ReconstructOptions options;
  ProgramLog log(folder / "log", nullptr);
  ColmapProgram colmap(options, {folder / "db", folder / "images", folder / "models"}, log);
  options.camera_per = "folder";
  EXPECT_EQ(value_of(colmap.extract_command("list", false, {}), "ImageReader.single_camera_per_folder"), "1");
  options.camera_per = "photo";
  const Words command = colmap.extract_command("list", false, {});
  EXPECT_EQ(value_of(command, "ImageReader.single_camera_per_image"), "1");
  EXPECT_EQ(value_of(command, "ImageReader.single_camera"), "");
  EXPECT_EQ(value_of(command, "ImageReader.existing_camera_id"), "");
}

TEST(ColmapProgram, RefusesWhatThisVersionCannotDo) {
  const TempDir folder;
  const FakePrograms programs;
  ProgramLog log(folder / "log", nullptr);
  ReconstructOptions options;
  const auto start = [&] { ColmapProgram(options, {}, log); };
  options.camera_model = "EUCM";
  EXPECT_TRUE(fails_with<InputError>({"--camera_model EUCM", "COLMAP 3.8 in PATH does not know it"}, start));
  programs.set_colmap_version("4.1");
  EXPECT_NO_THROW(start());
  programs.add_colmap_help("  --ImageReader.camera_model arg {OPENCV, THIN_PRISM_FISHEYE, DIVISION}");
  EXPECT_TRUE(fails_with<InputError>({"--camera_model EUCM", "COLMAP 4.1"}, start));
  options.camera_model = "DIVISION";
  EXPECT_NO_THROW(start());
  options.camera_model = "SIMPLE_DIVISION";
  EXPECT_TRUE(fails_with<InputError>({"--camera_model SIMPLE_DIVISION"}, start));
  options.camera_model = "OPENCV";
  options.use_gpu = "1";
  EXPECT_TRUE(fails_with<InputError>({"--use_gpu 1", "built without CUDA"}, start));
}

TEST(ColmapProgram, SaysHowToInstallIt) {
  const TempDir folder;
  const FakePrograms programs;
  programs.hide("colmap");
  ProgramLog log(folder / "log", nullptr);
  const ReconstructOptions options;
  EXPECT_TRUE(fails_with<InputError>({"colmap was not found in PATH", "apt install colmap"},
                                     [&] { ColmapProgram(options, {}, log); }));
}

TEST(ProgramLog, FindsTheLineThatSaysWhy) {
  EXPECT_EQ(failure_line({}), "");
  EXPECT_EQ(failure_line({"Loading", "", "ERROR: database is locked", "Elapsed time: 0.1 [minutes]", "==="}),
            "ERROR: database is locked");
  EXPECT_EQ(failure_line({"one", "two", ""}), "two");
  EXPECT_EQ(failure_line({"E20240131 10:11:12.123456 42 sfm.cc:264] failed to create sparse model"}),
            "failed to create sparse model");
}

TEST(ColmapModels, AreOrderedBySize) {
  const TempDir folder;
  const auto add = [&](const char* name, int n_images) {
    ColmapModel model;
    model.cameras[1] = {1, CameraModel::kPinhole, 8, 6, {10, 10, 4, 3}};
    for (int i = 0; i < n_images; ++i) {
      ColmapImage image;
      image.id = static_cast<std::uint32_t>(i + 1);
      image.camera_id = 1;
      image.name = std::to_string(i);
      model.images.push_back(image);
    }
    write_colmap_model(folder / name, model, ColmapFormat::kBinary);
  };
  add("models/0", 2);
  add("models/1", 9);
  add("models/2", 2);
  test::write_bytes(folder / "models/3/cameras.bin", "cut");
  test::write_bytes(folder / "models/3/images.bin", "cut");
  EXPECT_EQ(order_models(folder / "models", folder / "sparse"), 3u);
  EXPECT_EQ(count_colmap_images(folder / "sparse/0"), 9u);
  EXPECT_EQ(count_colmap_images(folder / "sparse/1"), 2u);
  EXPECT_EQ(count_colmap_images(folder / "sparse/2"), 2u);
  EXPECT_TRUE(fs::exists(folder / "models/3/images.bin"));
  EXPECT_EQ(order_models(folder / "none", folder / "nothing"), 0u);
}

}  // namespace
}  // namespace b3dgs
