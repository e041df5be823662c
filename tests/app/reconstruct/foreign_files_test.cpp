// Files of the user in the scene folder keep every byte, wherever they are and whenever they were added.
#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>

#include "app/reconstruct/fake_programs.h"
#include "app/reconstruct/reconstruct.h"
#include "core/check.h"
#include "core/files/folders.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/same.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::FakePrograms;
using test::read_bytes;
using test::TempDir;
using test::write_bytes;
using test::write_photographs;
using Words = std::vector<std::string>;

class FilesInAScene : public testing::Test {
 protected:
  FilesInAScene() {
    options_.input = (folder_ / "photos").string();
    options_.output = (folder_ / "scene").string();
    write_photographs(options_.input, 4);
    programs_.set_models({4});
  }
  fs::path scene() const { return options_.output; }
  void call() {
    reconstruct(options_, {}, nullptr, [&](const std::string& line) { warnings_.push_back(line); });
  }
  /// Makes a call whose error, such as a rejection, does not matter.
  void try_call() {
    try {
      call();
    } catch (const Error&) {
    }
  }
  void fail_in(const std::string& command) {
    programs_.set_colmap_prelude("if [ $1 = " + command + " ]; then exit 3; fi");
    try_call();
    programs_.set_colmap_prelude("");
  }
  /// Returns whether some file below the scene folder has these bytes.
  bool is_kept(const std::string& bytes) const {
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(scene())) {
      if (entry.is_regular_file() && read_bytes(entry.path()) == bytes) return true;
    }
    return false;
  }
  bool has_warning(const std::string& part) const {
    for (const std::string& line : warnings_) {
      if (line.find(part) != std::string::npos) return true;
    }
    return false;
  }
  TempDir folder_;
  FakePrograms programs_;
  ReconstructOptions options_;
  std::vector<std::string> warnings_;
};

// All paths where the program or the programs that it runs write, and others beside them.
const Words kPlaces{"images/a.png",
                    "images/mine.txt",
                    "images/frame_00001.jpg",
                    "images.previous/a.png",
                    "sparse/0/points3D.bin",
                    "sparse/0/mine.txt",
                    "sparse.previous/0/images.bin",
                    "reconstruct.log",
                    "reconstruct.log.previous",
                    "reconstruct/stages.json",
                    "reconstruct/photographs.txt",
                    "reconstruct/database.db",
                    "reconstruct/database.db-wal",
                    "reconstruct/database.db.previous-wal",
                    "reconstruct/models/0/cameras.bin",
                    "reconstruct/models/mine.txt",
                    "reconstruct/sparse/0/images.bin",
                    "reconstruct/frames/frame_00001.jpg",
                    "reconstruct/mine.txt",
                    "masks/a.png",
                    ".mine"};

TEST_F(FilesInAScene, OfAFolderThatWasNoSceneOutliveTheFirstCalls) {
  int n_scenes = 0;
  for (const std::string& place : kPlaces) {
    options_.output = (folder_ / ("scene " + std::to_string(++n_scenes))).string();
    write_bytes(scene() / place, "mine, " + place);
    try_call();
    EXPECT_TRUE(is_kept("mine, " + place)) << place;
  }
}

TEST_F(FilesInAScene, OfASceneOutliveEveryCall) {
  const std::string photographs = options_.input, other = (folder_ / "other").string();
  write_photographs(other, 3, 6, 6);
  std::string video;
  for (int i = 0; i < 6; ++i) video += std::string(16, static_cast<char>('a' + i));
  programs_.set_video(video, 6, 4);
  const std::string film = (folder_ / "film.mp4").string();
  write_bytes(film, "x");
  const std::string first = read_bytes(folder_ / "photos/a.png");
  for (const char* moment : {"exhaustive_matcher", "mapper", "none"}) {
    options_ = {};
    options_.input = photographs;
    options_.output = (folder_ / moment).string();
    fail_in(moment);
    // Files with these bytes replace those that the program has written. Without a valid stages.json, every call would
    // be rejected; see above.
    for (const std::string& place : kPlaces) {
      if (place != "reconstruct/stages.json") write_bytes(scene() / place, "mine, " + place);
    }
    const auto expect_kept = [&](const char* call) {
      try_call();
      for (const std::string& place : kPlaces) {
        if (place != "reconstruct/stages.json") {
          EXPECT_TRUE(is_kept("mine, " + place)) << place << ", " << moment << ", " << call;
        }
      }
    };
    // A call that continues uses the existing database. Others begin a new one.
    options_.max_features = 500;
    expect_kept("other features");
    expect_kept("the same call");
    options_.input = other;
    expect_kept("other photographs");
    options_.input = film;
    expect_kept("a video");
    options_.frames = 3;
    expect_kept("other frames");
    options_.frames = 0;
    options_.input = photographs;
    expect_kept("the first photographs again");
  }
  EXPECT_TRUE(test::same(read_bytes(folder_ / "photos/a.png"), first));
}

TEST_F(FilesInAScene, OriginalsThatWereUsedInPlaceAreNotReplacedByOthers) {
  options_.input = (scene() / "images").string();
  write_photographs(options_.input, 4);
  write_bytes(scene() / "images/notes.txt", "mine");
  const std::string original = read_bytes(scene() / "images/b.png");
  call();
  EXPECT_TRUE(warnings_.empty());
  options_.input = (folder_ / "other").string();
  write_photographs(options_.input, 4, 10, 10);
  call();
  EXPECT_TRUE(test::same(read_bytes(scene() / "images/b.png"), read_bytes(folder_ / "other/b.png")));
  EXPECT_TRUE(test::same(read_bytes(scene() / "images.previous/b.png"), original));
  EXPECT_EQ(read_bytes(scene() / "images.previous/notes.txt"), "mine");
  EXPECT_TRUE(has_warning("images is now images.previous, with 5 files that this program did not write"));
}

TEST_F(FilesInAScene, CopiesWhoseOriginalsAreGoneAreKept) {
  call();
  const std::string original = read_bytes(folder_ / "photos/a.png");
  ASSERT_TRUE(remove_tree(options_.input));  // a memory card that was formatted and filled again
  write_photographs(options_.input, 4, 10, 10);
  call();
  EXPECT_TRUE(test::same(read_bytes(scene() / "images.previous/a.png"), original));
  EXPECT_TRUE(test::same(read_bytes(scene() / "images/a.png"), read_bytes(folder_ / "photos/a.png")));
}

TEST_F(FilesInAScene, AProjectInTheWorkFolderIsRefused) {
  for (const char* name : {"database.db", "models/0/cameras.bin", "sparse/0/cameras.bin", "frames/frame_00001.jpg"}) {
    options_.output = (folder_ / ("scene of " + fs::path(name).stem().string())).string();
    write_bytes(scene() / "reconstruct" / name, "mine");
    EXPECT_TRUE(fails_with<InputError>({"reconstruct: expected no other files here", "choose another scene folder"},
                                       [&] { call(); }))
        << name;
    EXPECT_EQ(read_bytes(scene() / "reconstruct" / name), "mine");
    EXPECT_FALSE(fs::exists(scene() / "images"));
    EXPECT_FALSE(fs::exists(scene() / "reconstruct.log"));
  }
}

TEST_F(FilesInAScene, WithoutItsRecordTheProgramsOwnWorkFolderIsBegunAgain) {
  fail_in("mapper");
  fs::remove(scene() / "reconstruct/stages.json");
  fs::rename(scene() / "images", scene() / "moved");
  programs_.forget_calls();
  call();
  EXPECT_EQ(programs_.calls().size(), 3u);
  EXPECT_TRUE(warnings_.empty()) << warnings_[0];
}

TEST_F(FilesInAScene, AnEmptyOrLockedWorkFolderIsUsed) {
  write_bytes(scene() / "reconstruct/.b3dgs-lock", "1\n");  // from an earlier version that was killed
  EXPECT_NO_THROW(call());
  EXPECT_TRUE(fs::exists(scene() / "sparse/0/images.bin"));
}

/// Converts stages.json to that of the previous version, which had a stage for each group of photographs.
void split_groups(const fs::path& record) {
  using Json = nlohmann::ordered_json;
  Json json = Json::parse(read_bytes(record)), stages = Json::array();
  for (const Json& stage : json["stages"]) {
    if (stage["stage"] != "features") {
      stages.push_back(stage);
      continue;
    }
    for (const Json& names : stage["settings"]["groups"]) {
      Json group = stage;
      group["stage"] = "features " + std::to_string(stages.size() - 1);
      group["settings"].erase("groups");
      group["settings"].update({{"cameras", "8x6"}, {"photographs", names}});
      group["notes"].erase("groups");
      stages.push_back(group);
    }
  }
  json["stages"] = stages;
  write_bytes(record, json.dump(1));
}

TEST_F(FilesInAScene, ScenesOfEarlierVersionsGoOn) {
  write_photographs(options_.input, 2, 6, 8);  // a second group
  for (const char* command : {"exhaustive_matcher", "mapper", "none"}) {
    options_.output = (folder_ / command).string();
    fail_in(command);
    fs::remove(scene() / ".b3dgs-files");
    split_groups(scene() / "reconstruct/stages.json");
    for (const fs::directory_entry& entry : fs::directory_iterator(options_.input)) {
      const fs::path placed = scene() / "images" / entry.path().filename();
      fs::remove(placed);
      fs::create_hard_link(entry.path(), placed);
    }
    const std::string log = read_bytes(scene() / "reconstruct.log");
    warnings_.clear();
    programs_.forget_calls();
    call();
    const std::map<std::string, std::size_t> n_calls{{"exhaustive_matcher", 2}, {"mapper", 1}, {"none", 0}};
    EXPECT_EQ(programs_.calls().size(), n_calls.at(command)) << command;
    EXPECT_TRUE(warnings_.empty()) << command << ": " << warnings_[0];
    EXPECT_EQ(read_bytes(scene() / "reconstruct.log").rfind(log, 0), 0u);
    // With other options, files made without a list of own files are moved aside, not removed.
    const std::string database = read_bytes(scene() / "reconstruct/database.db");
    options_.max_features = 1000;
    call();
    EXPECT_TRUE(is_kept(database));
    options_.max_features = 8192;
  }
}

TEST_F(FilesInAScene, TheProgramsOwnFilesAreNotKeptTwice) {
  call();
  options_.max_features = 500;
  call();
  options_.camera_model = "PINHOLE";
  fail_in("mapper");
  call();
  for (const char* name : {"images.previous", "reconstruct.log.previous", "reconstruct/database.db.previous",
                           "reconstruct/models.previous", "reconstruct/sparse.previous"}) {
    EXPECT_FALSE(fs::exists(scene() / name)) << name;
  }
  EXPECT_FALSE(fs::exists(scene() / "reconstruct/models"));
  EXPECT_TRUE(warnings_.empty()) << warnings_[0];
}

TEST_F(FilesInAScene, FilesBesideAnEarlierModelAreNamedWhenItIsReplaced) {
  call();
  write_bytes(scene() / "sparse/geo.txt", "mine");
  options_.matcher = "sequential";
  call();
  EXPECT_EQ(read_bytes(scene() / "sparse.previous/geo.txt"), "mine");
  EXPECT_TRUE(has_warning("sparse is now sparse.previous, with 1 file that this program did not write"));
  EXPECT_TRUE(has_warning("geo.txt"));
}

}  // namespace
}  // namespace b3dgs
