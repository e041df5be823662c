// Tests strings of any bytes in JSON.
#include "core/json_text.h"

#include <gtest/gtest.h>

#include <set>

#include "core/random.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

bool is_utf8(const std::string& text) {
  try {
    return !Json(text).dump().empty();
  } catch (const nlohmann::json::exception&) {
    return false;
  }
}

TEST(JsonText, OfValidNamesIsThatOfEarlierVersions) {
  const Json json{{"caf\u00e9/\U0001F600.png", {"\u4e2d", "a\\x \"b\"", 1, nullptr, {{"z", 0.1}, {"a", "\x7f"}}}}};
  EXPECT_EQ(dump_json(json), json.dump());
  EXPECT_EQ(dump_json(json, 2), json.dump(2));
  EXPECT_EQ(parse_json(json.dump()), json);
}

TEST(JsonText, KeepsNamesThatAreNotUtf8) {
  const Json json{{"caf\xe9.png", "caf\xe8.png"},
                  {"caf\xe8.png",
                   {"\xff",
                    {{"\x80",
                      "a\x1a"
                      "e9"}}}}};
  const std::string text = dump_json(json);
  EXPECT_EQ(text.substr(0, 34), R"({"caf\u001ae9.png":"caf\u001ae8.pn)");
  EXPECT_TRUE(is_utf8(text));
  EXPECT_EQ(parse_json(text), json);
}

TEST(JsonText, EscapesWhatTheLibraryDoesNotAccept) {
  const RandomKey key{1, RandomStream::kExposureJitter, 0};
  // The first and last bytes of characters of each length, and their neighbours.
  const std::string bytes =
      "a\x1a"
      "e9\x7f\x80\x8f\x90\x9f\xa0\xbf\xc0\xc1\xc2\xdf\xe0\xed\xef\xf0\xf4\xf5\xff";
  std::set<std::string> names, texts;
  for (std::uint64_t i = 0; i < 20000; ++i) {
    std::string name;
    for (const float random : random_uniform(key, i)) name += bytes[static_cast<std::size_t>(random * bytes.size())];
    const std::string text = escape_bytes(name);
    ASSERT_TRUE(is_utf8(text)) << i;
    ASSERT_EQ(text == name, is_utf8(name) && name.find(kByteEscape) == std::string::npos) << i;
    ASSERT_EQ(unescape_bytes(text), name) << i;
    names.insert(name);
    texts.insert(text);
  }
  EXPECT_EQ(names.size(), texts.size());
}

TEST(JsonText, LeavesEscapesOfOthersAlone) {
  for (const char* const text : {"\x1a",
                                 "a\x1a"
                                 "e",
                                 "\x1a"
                                 "zz",
                                 "\x1a"
                                 "41",
                                 "\x1a"
                                 "00",
                                 "\x1a-1",
                                 "\x1a"
                                 "E"}) {
    EXPECT_EQ(unescape_bytes(text), text);
  }
}

}  // namespace
}  // namespace b3dgs
