#include "app/reconstruct/stage_record.h"

#include <gtest/gtest.h>

#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;
using test::TempDir;

class StageRecordTest : public testing::Test {
 protected:
  StageRecord open() const { return StageRecord(folder_ / "stages.json"); }
  /// Finishes stages "a" and "b" with settings 1, and begins "c" with settings 1 and a note.
  void record_two_and_a_half() const {
    StageRecord record = open();
    for (const char* stage : {"a", "b"}) {
      EXPECT_FALSE(record.is_done(stage, 1, true));
      EXPECT_FALSE(record.was_begun());
      record.finish();
    }
    EXPECT_FALSE(record.is_done("c", 1, true));
    record.set_notes({{"camera", 4}});
  }
  TempDir folder_;
};

TEST_F(StageRecordTest, FinishedStagesAreDoneAndOthersGoOn) {
  record_two_and_a_half();
  StageRecord record = open();
  EXPECT_TRUE(record.is_done("a", 1, true));
  EXPECT_TRUE(record.is_done("b", 1, true));
  EXPECT_FALSE(record.is_done("c", 1, true));
  EXPECT_TRUE(record.was_begun());
  EXPECT_EQ(record.notes(), (Json{{"camera", 4}}));
}

TEST_F(StageRecordTest, OtherSettingsRedoTheStageAndAllAfterIt) {
  record_two_and_a_half();
  {
    StageRecord record = open();
    EXPECT_FALSE(record.is_done("a", 2, true));
    EXPECT_FALSE(record.was_begun());
    record.finish();
  }
  StageRecord record = open();
  EXPECT_TRUE(record.is_done("a", 2, true));
  EXPECT_FALSE(record.is_done("b", 1, true));
  record.finish();
  EXPECT_FALSE(record.is_done("c", 1, true));
  EXPECT_FALSE(record.was_begun());
  EXPECT_EQ(record.notes(), Json::object());
}

TEST_F(StageRecordTest, AStageWhoseResultIsGoneIsDoneAgain) {
  record_two_and_a_half();
  StageRecord record = open();
  EXPECT_FALSE(record.is_done("a", 1, false));
  EXPECT_FALSE(record.was_begun());
}

TEST_F(StageRecordTest, ADamagedFileIsAnEmptyRecord) {
  record_two_and_a_half();
  const std::string whole = test::read_bytes(folder_ / "stages.json");
  for (const std::string& text :
       {whole.substr(0, whole.size() / 2), std::string("[]"), std::string("{\"version\": 1, \"stages\": [3]}"),
        std::string("{\"version\": 1, \"stages\": {}}"), std::string("{\"version\": 2, \"stages\": []}")}) {
    test::write_bytes(folder_ / "stages.json", text);
    StageRecord record = open();
    EXPECT_FALSE(record.is_done("a", 1, true)) << text;
    EXPECT_FALSE(record.was_begun()) << text;
  }
}

/// Returns the stages of a file of the previous version, in its format.
std::string stages_of_groups(const std::string& done_of_last) {
  return R"({"version": 1, "stages": [
    {"stage": "photographs", "settings": {}, "done": true, "notes": {}},
    {"stage": "features 0", "settings": {"colmap": "COLMAP 3.8", "camera_model": "OPENCV", "camera_per": "size",
     "max_features": 8192, "cameras": "360x300", "photographs": ["d.png", "e.png"]},
     "done": true, "notes": {"camera": 1}},
    {"stage": "features 1", "settings": {"colmap": "COLMAP 3.8", "camera_model": "OPENCV", "camera_per": "size",
     "max_features": 8192, "cameras": "400x300", "photographs": ["a.png"]},
     "notes": {"camera": 2}, "done": )" +
         done_of_last + "}";
}

TEST_F(StageRecordTest, GroupsOfThePreviousVersionAreOneStage) {
  const Json settings{{"colmap", "COLMAP 3.8"},
                      {"camera_model", "OPENCV"},
                      {"camera_per", "size"},
                      {"max_features", 8192},
                      {"groups", {{"d.png", "e.png"}, {"a.png"}}}};
  const std::string matches = R"(, {"stage": "matches", "settings": 1, "done": true, "notes": {}}]})";
  test::write_bytes(folder_ / "stages.json", stages_of_groups("true") + matches);
  StageRecord done = open();
  EXPECT_TRUE(done.is_done("photographs", Json::object(), true));
  EXPECT_TRUE(done.is_done("features", settings, true));
  EXPECT_TRUE(done.is_done("matches", 1, true));

  test::write_bytes(folder_ / "stages.json", stages_of_groups("false") + "]}");
  StageRecord begun = open();
  EXPECT_TRUE(begun.is_done("photographs", Json::object(), true));
  EXPECT_FALSE(begun.is_done("features", settings, true));
  EXPECT_TRUE(begun.was_begun());
  EXPECT_EQ(begun.notes(), (Json{{"camera", 2}, {"groups", 1}}));
}

TEST_F(StageRecordTest, DamagedGroupsOfThePreviousVersionAreNotDone) {
  const std::string end = R"(, "done": true, "notes": {}})", group = R"({"stage": "features 0", "settings": )";
  for (const std::string& stages :
       {group + "3" + end, group + "{}" + end, group + R"({"photographs": 3})" + end + ", " + group + "[]" + end,
        R"({"stage": "features", "settings": 3)" + end + ", " + group + "{}" + end,
        R"({"stage": "features", "settings": {"groups": 3})" + end + ", " + group + "{}" + end,
        R"({"stage": "features", "settings": {})" + end + ", " + group + R"({"groups": 3})" + end}) {
    test::write_bytes(folder_ / "stages.json", R"({"version": 1, "stages": [)" + stages + "]}");
    EXPECT_FALSE(open().is_done("features", {{"groups", {{"a.png"}}}}, true)) << stages;
  }
}

TEST_F(StageRecordTest, NamesThatAreNoUtf8AreFoundAgain) {
  const Json settings{{"name", "gr\xfcn.jpg"}};
  {
    StageRecord record = open();
    record.is_done("a", settings, true);
    record.finish();
  }
  EXPECT_TRUE(open().is_done("a", settings, true));
  EXPECT_FALSE(open().is_done("a", {{"name", "gruen.jpg"}}, true));
}

TEST_F(StageRecordTest, TellsItsFilesFromOthers) {
  record_two_and_a_half();
  EXPECT_TRUE(is_stage_record(folder_ / "stages.json"));
  EXPECT_FALSE(is_stage_record(folder_ / "none.json"));
  for (const char* text : {"mine", "[]", "{}", "{\"version\": 1}"}) {
    test::write_bytes(folder_ / "other.json", text);
    EXPECT_FALSE(is_stage_record(folder_ / "other.json")) << text;
  }
}

TEST_F(StageRecordTest, TextsOfEarlierSettingsAreFound) {
  open().is_done("a", {{"folder", "/photos/"}, {"n", 3}}, true);
  EXPECT_EQ(open().earlier_text("a", "folder"), "/photos/");
  for (const char* key : {"n", "none"}) EXPECT_EQ(open().earlier_text("a", key), "") << key;
  EXPECT_EQ(open().earlier_text("b", "folder"), "");
}

}  // namespace
}  // namespace b3dgs
