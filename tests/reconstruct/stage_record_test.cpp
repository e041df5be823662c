#include "reconstruct/stage_record.h"

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
