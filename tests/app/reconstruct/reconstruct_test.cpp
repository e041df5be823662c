#include "app/reconstruct/reconstruct.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "app/georeference/gps.h"
#include "app/georeference/gps_photograph.h"
#include "app/reconstruct/fake_programs.h"
#include "core/check.h"
#include "scene/images/image.h"
#include "scene/photograph.h"
#include "support/expect_error.h"
#include "support/files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::FakePrograms;
using test::read_bytes;
using test::TempDir;
using test::write_bytes;
using test::write_photographs;

class Reconstruct : public testing::Test {
 protected:
  Reconstruct() {
    options_.input = (folder_ / "photos").string();
    options_.output = (folder_ / "scene").string();
    write_photographs(options_.input, 10);
    programs_.set_models({10});
  }
  void make_scene() {
    result_ = reconstruct(options_, {}, nullptr, [&](const std::string& line) { warnings_.push_back(line); });
  }
  /// Returns the commands of colmap that the call runs, one word each.
  std::vector<std::string> commands_of_call() {
    programs_.forget_calls();
    make_scene();
    std::vector<std::string> commands;
    for (const std::string& call : programs_.calls()) commands.push_back(call.substr(0, call.find(' ')));
    return commands;
  }
  testing::AssertionResult fails(std::initializer_list<std::string> parts) {
    return fails_with<InputError>(parts, [&] { make_scene(); });
  }
  fs::path scene() const { return options_.output; }

  TempDir folder_;
  FakePrograms programs_;
  ReconstructOptions options_;
  ReconstructResult result_;
  std::vector<std::string> warnings_;
};

using Words = std::vector<std::string>;
const Words kAll{"feature_extractor", "exhaustive_matcher", "mapper"};

TEST_F(Reconstruct, MakesASceneAndLeavesThePhotographs) {
  EXPECT_EQ(commands_of_call(), kAll);
  EXPECT_EQ(result_.n_photographs, 10u);
  EXPECT_EQ(result_.n_registered, 10u);
  EXPECT_EQ(result_.n_points, 1u);
  EXPECT_NEAR(result_.mean_error, 0.5, 1e-9);
  EXPECT_TRUE(warnings_.empty());
  EXPECT_TRUE(fs::exists(scene() / "images/j.png"));
  EXPECT_TRUE(fs::exists(folder_ / "photos/j.png"));
  EXPECT_EQ(count_colmap_images(scene() / "sparse/0"), 10u);
  EXPECT_NE(read_bytes(scene() / "reconstruct.log").find("Processed file [10/10]"), std::string::npos);
}

TEST_F(Reconstruct, SaysWhatItCounts) {
  const auto steps_of_matching = [&] {
    std::vector<std::string> steps;
    reconstruct(options_, [&](const std::string& stage, std::size_t done, std::size_t total) {
      if (stage.rfind("matching", 0) == 0)
        steps.push_back(stage + " " + std::to_string(done) + "/" + std::to_string(total));
    });
    return steps;
  };
  // The stub has its own four blocks.
  EXPECT_EQ(steps_of_matching(), (Words{"matching, pairs 0/45", "matching, pairs 45/45", "matching, pairs 45/45"}));
  options_.matcher = "sequential";
  EXPECT_EQ(steps_of_matching(),
            (Words{"matching, photographs 0/0", "matching, photographs 1/10", "matching, photographs 10/10"}));
}

/// 12 photographs with GPS positions, and a model of them in units of 10 m.
class ReconstructWithGps : public Reconstruct {
 protected:
  void SetUp() override {
    if (!can_read_gps()) GTEST_SKIP() << "built without libexiv2 and GeographicLib";
    options_.input = (folder_ / "flight").string();
    ColmapModel model;
    model.cameras[1] = {1, CameraModel::kOpenCv, 8, 6, {10, 10, 4, 3, 0, 0, 0, 0}};
    for (std::uint32_t i = 0; i < 12; ++i) {
      const std::array<double, 3> place{20.0 * (i % 4), 25.0 * (i / 4), 30 + 2.0 * (i % 3)};  // m east, north, up
      ColmapImage image;
      image.id = i + 1;
      image.camera_id = 1;
      image.name = std::string(1, static_cast<char>('a' + i)) + ".jpg";
      image.translation = {-place[1] / 10, place[0] / 10, -place[2] / 10};  // turned about the vertical
      model.images.push_back(image);
      write_gps(i, place);
    }
    model.points.push_back({1, {0, 0, 1}, {}, 0.5, {1, 2}});
    programs_.set_model(model);
  }
  void write_gps(std::uint32_t i, const std::array<double, 3>& place) {
    test::write_gps_photograph(fs::path(options_.input) / (std::string(1, static_cast<char>('a' + i)) + ".jpg"),
                               test::position_of({47, 8, 400}, place));
  }
};

TEST_F(ReconstructWithGps, PutsTheModelInMetres) {
  EXPECT_EQ(commands_of_call(), kAll);
  ASSERT_TRUE(result_.georeference);
  EXPECT_EQ(result_.georeference->n_kept, 12);
  EXPECT_LT(result_.georeference->largest_residual, 0.01);
  EXPECT_NEAR(*result_.georeference->height, 410, 0.01) << "of the point";
  const ColmapModel model = read_colmap_model(scene() / "sparse/0");
  EXPECT_NEAR(distance(center_of(model.images[0]), center_of(model.images[3])), 60, 0.01);
  EXPECT_NEAR(center_of(model.images[0])[2], 20, 0.01);
  EXPECT_FALSE(fs::exists(scene() / "sparse.previous")) << "the program's own model needs no copy";
  EXPECT_TRUE(warnings_.empty());
  const std::string before = read_bytes(scene() / "sparse/0/images.txt");
  EXPECT_EQ(commands_of_call(), Words{});
  EXPECT_TRUE(result_.georeference);
  EXPECT_EQ(read_bytes(scene() / "sparse/0/images.txt"), before);
}

TEST_F(ReconstructWithGps, CanBeTurnedOffAndOn) {
  options_.georeference = false;
  make_scene();
  EXPECT_FALSE(result_.georeference);
  options_.georeference = true;
  EXPECT_EQ(commands_of_call(), Words{});
  EXPECT_TRUE(result_.georeference);
}

TEST_F(ReconstructWithGps, KeepsTheModelIfPositionsContradictIt) {
  for (std::uint32_t i = 0; i < 12; ++i) write_gps(i, {30.0 * (i * 7 % 12), 20.0 * (i * 5 % 11), 10.0 * (i * 5 % 7)});
  make_scene();
  EXPECT_FALSE(result_.georeference);
  EXPECT_FALSE(fs::exists(scene() / Georeference::kFile));
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_TRUE(test::contains(warnings_[0], "the model keeps COLMAP's unit of length and axes")) << warnings_[0];
}

class LargeReconstruction : public Reconstruct {
 protected:
  LargeReconstruction() {
    const std::string photograph = read_bytes(fs::path(options_.input) / "a.png");
    ColmapModel model;
    model.cameras[1] = {1, CameraModel::kOpenCv, 8, 6, {10, 10, 4, 3, 0, 0, 0, 0}};
    for (std::uint32_t i = 0; i < 201; ++i) {
      ColmapImage image;
      image.id = i + 1;
      image.camera_id = 1;
      image.name = std::to_string(1000 + i) + ".png";
      write_bytes(folder_ / "large" / image.name, photograph);
      model.images.push_back(image);
    }
    model.points.push_back({1, {0, 0, 1}, {}, 0.5, {1, 2}});
    options_.input = (folder_ / "large").string();
    programs_.set_model(model);
  }
};

TEST_F(LargeReconstruction, UsesTheGlobalMapperWhereColmapHasIt) {
  EXPECT_EQ(commands_of_call(), kAll) << "this version has none";
  options_.output = (folder_ / "other").string();
  programs_.add_colmap_command("global_mapper");
  EXPECT_EQ(commands_of_call(), (Words{"feature_extractor", "exhaustive_matcher", "global_mapper"}));
  EXPECT_EQ(result_.n_registered, 201u);
  EXPECT_TRUE(warnings_.empty()) << warnings_[0];
}

TEST_F(LargeReconstruction, AGlobalMapperThatFailsIsReplacedByTheOther) {
  programs_.add_colmap_command("global_mapper");
  // It fails, or it ends well without a model.
  for (const std::string failure : {"echo 'ERROR: bad luck'; exit 3", "exit 0"}) {
    options_.output += "2";
    warnings_.clear();
    programs_.set_colmap_prelude("if [ $1 = global_mapper ]; then " + failure + "; fi");
    EXPECT_EQ(commands_of_call(), (Words{"feature_extractor", "exhaustive_matcher", "global_mapper", "mapper"}));
    EXPECT_EQ(result_.n_registered, 201u);
    ASSERT_EQ(warnings_.size(), 1u);
    EXPECT_TRUE(test::contains(warnings_[0], "the slower mapper is used instead")) << warnings_[0];
  }
}

TEST_F(LargeReconstruction, BothMappersMayFail) {
  programs_.add_colmap_command("global_mapper");
  programs_.set_colmap_prelude("case $1 in *mapper) echo 'ERROR: bad luck'; exit 3; esac");
  EXPECT_TRUE(fails({"colmap mapper failed (exit code 3): ERROR: bad luck"}));
}

TEST_F(Reconstruct, FewPhotographsDoNotNeedTheGlobalMapper) {
  programs_.add_colmap_command("global_mapper");
  EXPECT_EQ(commands_of_call(), kAll);
}

TEST_F(Reconstruct, DoesNotRepeatWhatIsDone) {
  commands_of_call();
  EXPECT_EQ(commands_of_call(), Words{});
  EXPECT_EQ(result_.n_registered, 10u);
  options_.matcher = "sequential";
  EXPECT_EQ(commands_of_call(), (Words{"sequential_matcher", "mapper"}));
  options_.max_features = 500;
  EXPECT_EQ(commands_of_call(), (Words{"feature_extractor", "sequential_matcher", "mapper"}));
  EXPECT_TRUE(fs::exists(scene() / "sparse.previous.2/0")) << "earlier models are kept";
  write_photographs(options_.input, 11);
  EXPECT_EQ(commands_of_call(), (Words{"feature_extractor", "sequential_matcher", "mapper"}));
  EXPECT_EQ(result_.n_photographs, 11u);
}

TEST_F(Reconstruct, GoesOnAfterAFailureInEachStage) {
  const std::pair<const char*, Words> stages[]{
      {"feature_extractor", kAll}, {"exhaustive_matcher", {"exhaustive_matcher", "mapper"}}, {"mapper", {"mapper"}}};
  for (const auto& [stage, rest] : stages) {
    options_.output = (folder_ / stage).string();
    programs_.set_colmap_prelude(std::string("if [ $1 = ") + stage + " ]; then echo 'ERROR: bad luck'; exit 3; fi");
    EXPECT_TRUE(fails({std::string("colmap ") + stage + " failed (exit code 3): ERROR: bad luck", "reconstruct.log"}));
    EXPECT_FALSE(fs::exists(scene() / "sparse")) << stage;
    programs_.set_colmap_prelude("");
    EXPECT_EQ(commands_of_call(), rest) << stage;
    EXPECT_EQ(result_.n_registered, 10u) << stage;
  }
}

TEST_F(Reconstruct, AnInterruptedExtractionKeepsItsFeaturesAndItsCamera) {
  programs_.slow_down();
  std::atomic<int> stop{0};
  const ReconstructResult stopped = reconstruct(
      options_,
      [&](const std::string& stage, std::size_t done, std::size_t) {
        // The camera is known only from the lines after this one.
        if (stage == "extracting features" && done == 2) stop = 2;
      },
      &stop);
  EXPECT_TRUE(stopped.is_stopped);
  const std::string database = read_bytes(scene() / "reconstruct/database.db");
  EXPECT_FALSE(database.empty());
  EXPECT_EQ(commands_of_call(), kAll);
  EXPECT_NE(programs_.calls()[0].find("--ImageReader.existing_camera_id 7"), std::string::npos) << programs_.calls()[0];
  EXPECT_EQ(read_bytes(scene() / "reconstruct/database.db").rfind(database, 0), 0u);
}

TEST_F(Reconstruct, AnExtractionThatEndedBeforeItsCameraWasKnownBeginsAgain) {
  write_photographs(folder_ / "photos/upright", 2, 6, 8);
  // In the second group, two photographs are in the database, but the line with their camera is missing.
  programs_.set_colmap_prelude("if [ -e '" + (scene() / "reconstruct/database.db").string() +
                               "' ] && [ $1 = feature_extractor ]; then echo x >> '" +
                               (scene() / "reconstruct/database.db").string() + "'; kill -TERM $$; fi");
  EXPECT_TRUE(fails({"feature_extractor failed"}));
  programs_.set_colmap_prelude("");
  EXPECT_EQ(commands_of_call(), (Words{"feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"}));
  for (const std::size_t call : {0u, 1u}) {
    EXPECT_EQ(programs_.calls()[call].find("existing_camera_id"), std::string::npos);
  }
  EXPECT_EQ(read_bytes(scene() / "reconstruct/database.db").find('x'), std::string::npos);
}

TEST_F(Reconstruct, AnExtractionThatEndedBeforeItsDatabaseWasEmptiedBeginsAgain) {
  options_.camera_per = "photo";
  programs_.set_colmap_prelude("if [ $1 = feature_extractor ]; then exit 3; fi");
  EXPECT_TRUE(fails({"feature_extractor failed"}));
  programs_.set_colmap_prelude("");
  const fs::path file = scene() / "reconstruct/stages.json";
  nlohmann::ordered_json record = nlohmann::ordered_json::parse(read_bytes(file));
  record["stages"].back()["notes"] = nlohmann::ordered_json::object();
  write_bytes(file, record.dump());
  write_bytes(scene() / "reconstruct/database.db", "x of other options\n");
  EXPECT_EQ(commands_of_call(), kAll);
  EXPECT_EQ(read_bytes(scene() / "reconstruct/database.db").find('x'), std::string::npos);
}

TEST_F(Reconstruct, TheSameFoldersGoOnHoweverTheyAreWritten) {
  const std::string photos = options_.input, place = options_.output;
  make_scene();
  fs::create_directory_symlink(photos, folder_ / "link");
  fs::create_directory_symlink(place, folder_ / "scene link");
  for (const std::string& input : {photos + "/", photos + "/.", photos + "/../photos//", (folder_ / "link").string()}) {
    for (const std::string& output : {place + "/", (folder_ / "scene link/").string()}) {
      options_.input = input;
      options_.output = output;
      EXPECT_EQ(commands_of_call(), Words{}) << input << " " << output;
    }
  }
  // Earlier versions noted it in this form.
  std::string record = read_bytes(scene() / "reconstruct/stages.json");
  const std::string noted = "\"folder\": \"" + fs::canonical(photos).string();
  ASSERT_NE(record.find(noted), std::string::npos);
  record.insert(record.find(noted) + noted.size(), "/");
  write_bytes(scene() / "reconstruct/stages.json", record);
  EXPECT_EQ(commands_of_call(), Words{});
}

TEST_F(Reconstruct, TheSameVideoGoesOnHoweverItIsWritten) {
  std::string video;
  for (int i = 0; i < 6; ++i) video += std::string(16, static_cast<char>('a' + i));
  programs_.set_video(video, 6, 4);
  programs_.set_models({6});
  write_bytes(folder_ / "film.mp4", "x");
  fs::create_symlink("film.mp4", folder_ / "link.mp4");
  options_.input = (folder_ / "film.mp4").string();
  make_scene();
  options_.input = (folder_ / "link.mp4").string();
  EXPECT_EQ(commands_of_call(), Words{});
}

TEST_F(Reconstruct, TheFolderOfThePhotographsIsNoSceneFolder) {
  options_.output = options_.input;
  for (const char* end : {"", "/"}) {
    options_.input += end;
    EXPECT_TRUE(fails({"is the folder of the photographs, too", "choose another scene folder"}));
  }
  EXPECT_FALSE(fs::exists(scene() / "reconstruct"));
}

TEST_F(Reconstruct, ASceneInsideTheFolderOfPhotographsIsNotTakenForPhotographs) {
  options_.output = options_.input + "/scene";
  make_scene();
  write_photographs(folder_ / "photos", 10, 10, 10);
  make_scene();
  EXPECT_TRUE(fs::exists(scene() / "images.previous/a.png"));
  EXPECT_EQ(result_.n_photographs, 10u);
  EXPECT_EQ(commands_of_call(), Words{});
}

TEST_F(Reconstruct, SaysWhatIsLeftOutBesidePhotographs) {
  write_bytes(folder_ / "photos/x.HEIC", "x");
  make_scene();
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("1 raw or HEIC files are left out (the first: x.HEIC)"), std::string::npos);
}

TEST_F(Reconstruct, NamesWithLineBreaksAreRefusedBeforeAnythingIsDone) {
  write_bytes(folder_ / "photos/x\ny.png", read_bytes(folder_ / "photos/a.png"));
  EXPECT_TRUE(fails({"x?y.png", "control characters", "rename"}));
  EXPECT_FALSE(fs::exists(scene()));
}

TEST_F(Reconstruct, NamesThatAreNoUtf8AreNotDoneAgain) {
  write_bytes(folder_ / "photos/gr\xfcn.png", read_bytes(folder_ / "photos/a.png"));
  make_scene();
  EXPECT_EQ(commands_of_call(), Words{});
}

TEST_F(Reconstruct, WhatThisColmapCannotDoIsRefusedBeforeAnythingIsDone) {
  options_.camera_model = "EUCM";
  EXPECT_TRUE(fails({"--camera_model EUCM"}));
  options_.camera_model = "OPENCV";
  options_.use_gpu = "1";
  EXPECT_TRUE(fails({"--use_gpu 1"}));
  EXPECT_FALSE(fs::exists(scene() / "images"));
}

TEST_F(Reconstruct, PhotographsThatLieOnTheirSideAreTurnedOrNamed) {
  const std::vector<std::uint8_t> jpeg = test::jpeg_with_orientation(48, 32, 6, true);
  write_bytes(folder_ / "photos/lying.jpg", std::string(jpeg.begin(), jpeg.end()));
  make_scene();
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("1 of 11 photographs were turned upright"), std::string::npos) << warnings_[0];
  EXPECT_EQ(read_image_size(scene() / "images/lying.jpg"), (ImageSize{32, 48}));
  warnings_.clear();
  EXPECT_EQ(commands_of_call(), Words{});
  EXPECT_TRUE(warnings_.empty());

  options_.output = (folder_ / "place").string();
  write_bytes(scene() / "images/lying.jpg", std::string(jpeg.begin(), jpeg.end()));
  write_photographs(scene() / "images", 9);
  options_.input = options_.output;
  make_scene();
  EXPECT_NE(warnings_[0].find("1 of 10 photographs lie on their side"), std::string::npos) << warnings_[0];
  EXPECT_EQ(read_bytes(scene() / "images/lying.jpg").size(), jpeg.size());
}

TEST_F(Reconstruct, AVideoNeedsTwoFrames) {
  programs_.set_video(std::string(16, 'a'), 1, 4);
  write_bytes(folder_ / "film.mp4", "x");
  options_.input = (folder_ / "film.mp4").string();
  for (int call = 0; call < 2; ++call) EXPECT_TRUE(fails({"film.mp4: only one frame"}));
  options_.frames = 1;
  EXPECT_TRUE(fails({"--frames 1: expected at least 2 frames"}));
}

TEST_F(Reconstruct, AnExtractionWithOtherOptionsBeginsANewDatabase) {
  programs_.set_colmap_prelude("if [ $1 = exhaustive_matcher ]; then exit 3; fi");
  EXPECT_TRUE(fails({"exhaustive_matcher failed"}));
  const std::string database = read_bytes(scene() / "reconstruct/database.db");
  options_.camera_model = "PINHOLE";
  EXPECT_TRUE(fails({"exhaustive_matcher failed"}));
  EXPECT_EQ(read_bytes(scene() / "reconstruct/database.db"), database) << "not twice as many";
}

TEST_F(Reconstruct, TakesTheLargestOfSeveralModels) {
  programs_.set_models({3, 7});
  reconstruct(options_);
  EXPECT_EQ(count_colmap_images(scene() / "sparse/0"), 7u);
  EXPECT_EQ(count_colmap_images(scene() / "sparse/1"), 3u);
}

TEST_F(Reconstruct, WarnsAndRefusesWhereTooFewAreRegistered) {
  programs_.set_models({7});
  make_scene();
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("only 7 of 10 photographs (70 %) are registered"), std::string::npos);

  options_.output = (folder_ / "other").string();
  programs_.set_models({5, 4});
  EXPECT_TRUE(fails({"only 5 of 10 photographs (50 %) are registered in the largest of 2 models", "overlap",
                     "--min_registered 0.5", "other/reconstruct/sparse"}));
  EXPECT_FALSE(fs::exists(scene() / "sparse"));
  EXPECT_EQ(count_colmap_images(scene() / "reconstruct/sparse/0"), 5u) << "nothing is deleted";
  EXPECT_TRUE(fails({"only 5 of 10"})) << "nor is it accepted the next time";
  options_.min_registered = 0.5;
  EXPECT_EQ(commands_of_call(), Words{});
  EXPECT_EQ(count_colmap_images(scene() / "sparse/0"), 5u);
}

TEST_F(Reconstruct, SaysWhatToDoWithoutMatches) {
  programs_.set_models({});
  EXPECT_TRUE(fails({"photos: too few matches", "overlap", "reconstruct.log"}));
}

TEST_F(Reconstruct, TellsAFullDiskAndTooLittleMemory) {
  programs_.set_colmap_prelude("echo 'SQLite error [sqlite3_utils.h, line 61]: database or disk is full'; exit 1");
  EXPECT_TRUE(fails_with<IoError>({"the disk is full", "same command again"}, [&] { reconstruct(options_); }));
  programs_.set_colmap_prelude("if [ $1 = mapper ]; then kill -KILL $$; fi");
  EXPECT_TRUE(fails({"mapper was killed", "memory", "--threads"}));
}

TEST_F(Reconstruct, UsesPhotographsInPlace) {
  options_.output = (folder_ / "place").string();
  fs::create_directories(scene());
  fs::rename(folder_ / "photos", scene() / "images");
  for (const std::string& input : {options_.output + "/images", options_.output}) {
    options_.input = input;
    reconstruct(options_);
    EXPECT_EQ(count_colmap_images(scene() / "sparse/0"), 10u);
  }
  EXPECT_EQ(commands_of_call(), Words{});
}

TEST_F(Reconstruct, NeverTouchesWhatIsTheUsers) {
  write_bytes(scene() / "images/mine.jpg", "mine");
  EXPECT_TRUE(fails({"images: there are files already"}));
  EXPECT_FALSE(fs::exists(scene() / "reconstruct"));
  options_.output = (folder_ / "other").string();
  programs_.set_models({2});
  fs::create_directories(scene() / "sparse");
  write_bytes(scene() / "sparse/0/cameras.bin", "mine");
  write_bytes(scene() / "sparse/0/images.bin", "mine");
  write_bytes(scene() / "sparse/0/points3D.bin", "mine");
  EXPECT_TRUE(fails({"sparse/0: there is a COLMAP model already", "b3dgs train"}));
  EXPECT_EQ(read_bytes(scene() / "sparse/0/images.bin"), "mine");
}

TEST_F(Reconstruct, LeavesDamagedPhotographsOut) {
  write_bytes(folder_ / "photos/c.png", "damaged");
  make_scene();
  EXPECT_EQ(result_.n_photographs, 9u);
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("left out: "), std::string::npos);
  EXPECT_NE(warnings_[0].find("c.png"), std::string::npos);
  EXPECT_EQ(read_bytes(scene() / "reconstruct/photographs.txt").find("c.png"), std::string::npos);
  for (int i = 0; i < 10; ++i) {
    if (i != 3) write_bytes(folder_ / ("photos/" + std::string(1, static_cast<char>('a' + i)) + ".png"), "damaged");
  }
  options_.output = (folder_ / "other").string();
  warnings_.clear();
  EXPECT_TRUE(fails({"1 of 10 photographs can be read"}));
  EXPECT_EQ(warnings_.size(), 6u) << "five by name, and how many more";
}

TEST_F(Reconstruct, RefusesOtherInput) {
  options_.input = (folder_ / "none").string();
  EXPECT_TRUE(fails({"photographs not found"}));
  options_.input = (folder_ / "photos/a.png").string();
  EXPECT_TRUE(fails({"only one photograph"}));
  write_bytes(folder_ / "file", "x");
  options_.input = (folder_ / "photos").string();
  options_.frames = 5;
  EXPECT_TRUE(fails({"--frames has no effect on photographs"}));
  options_.frames = 0;
  options_.output = (folder_ / "file").string();
  EXPECT_TRUE(fails({"not a folder"}));
  EXPECT_EQ(programs_.calls(), Words{});
}

TEST_F(Reconstruct, WithoutColmapOrFfmpegNothingIsWritten) {
  write_bytes(folder_ / "film.mp4", "x");
  const std::string photos = options_.input;
  options_.input = (folder_ / "film.mp4").string();
  programs_.hide("ffmpeg");
  EXPECT_TRUE(fails({"ffmpeg was not found in PATH", "apt install ffmpeg"}));
  options_.input = photos;
  programs_.hide("colmap");
  EXPECT_TRUE(fails({"colmap was not found in PATH", "apt install colmap"}));
  EXPECT_FALSE(fs::exists(scene()));
}

TEST_F(Reconstruct, MakesAGroupForEachSize) {
  write_photographs(folder_ / "photos/upright", 2, 6, 8);
  const Words commands = commands_of_call();
  EXPECT_EQ(commands, (Words{"feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"}));
  for (const std::size_t call : {0u, 1u}) {
    EXPECT_NE(programs_.calls()[call].find("--ImageReader.single_camera 1"), std::string::npos);
  }
}

TEST_F(Reconstruct, AVideoIsMatchedInSequence) {
  std::string video;
  for (int i = 0; i < 6; ++i) video += std::string(16, static_cast<char>('a' + i));
  programs_.set_video(video, 6, 4);
  programs_.set_models({3});
  write_bytes(folder_ / "film.mp4", "x");
  options_.input = (folder_ / "film.mp4").string();
  options_.frames = 4;
  EXPECT_EQ(commands_of_call(), (Words{"ffmpeg", "ffmpeg", "feature_extractor", "sequential_matcher", "mapper"}));
  EXPECT_TRUE(fs::exists(scene() / "images/frame_00004.jpg"));
  EXPECT_EQ(result_.n_photographs, 4u);
  EXPECT_EQ(commands_of_call(), Words{});
  options_.frames = 3;
  EXPECT_EQ(commands_of_call().size(), 5u);
  EXPECT_FALSE(fs::exists(scene() / "images/frame_00004.jpg"));
  EXPECT_TRUE(fs::exists(scene() / "images.previous/frame_00004.jpg"));
}

}  // namespace
}  // namespace b3dgs
