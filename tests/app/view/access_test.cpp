#include "app/view/access.h"

#include <gtest/gtest.h>

#include <set>

namespace b3dgs {
namespace {

using std::chrono::seconds;

TEST(Access, TokensAre128BitsAndDiffer) {
  std::set<std::string> tokens;
  for (int i = 0; i < 100; ++i) tokens.insert(make_token());
  EXPECT_EQ(tokens.size(), 100u);
  for (const std::string& token : tokens) {
    EXPECT_EQ(token.size(), 32u);
    EXPECT_EQ(token.find_first_not_of("0123456789abcdef"), std::string::npos) << token;
  }
}

TEST(Access, ComparesWholeStrings) {
  EXPECT_TRUE(equal_in_constant_time("abc", "abc"));
  EXPECT_FALSE(equal_in_constant_time("abc", "abd"));
  EXPECT_FALSE(equal_in_constant_time("abc", "bbc"));
  EXPECT_FALSE(equal_in_constant_time("abc", "ab"));
  EXPECT_FALSE(equal_in_constant_time("", "a"));
}

TEST(Access, OnLoopbackOnlyItsOwnNamesAreTaken) {
  for (const char* host : {"127.0.0.1:8080", "127.0.0.1", "localhost:9000", "[::1]:8080", "127.0.1.1:80"}) {
    EXPECT_TRUE(is_own_host(host, "127.0.0.1")) << host;
  }
  for (const char* host : {"evil.example:8080", "evil.example", "", "192.168.1.5:8080", "localhost.evil.example",
                           "127.0.0.1.evil.example", "127.evil.example", "[::1", "[::1.evil]:80"}) {
    EXPECT_FALSE(is_own_host(host, "127.0.0.1")) << host;
  }
}

TEST(Access, OnAnotherAddressNamesAreRefusedToo) {
  EXPECT_TRUE(is_own_host("192.168.1.5:8080", "0.0.0.0"));
  EXPECT_TRUE(is_own_host("[fe80::1]:8080", "::"));
  EXPECT_TRUE(is_own_host("localhost:8080", "192.168.1.5"));
  EXPECT_FALSE(is_own_host("evil.example:8080", "0.0.0.0"));
  EXPECT_FALSE(is_own_host("192.168.1.5.evil.example", "192.168.1.5"));
}

TEST(Access, OriginIsAbsentOrThePagesOwn) {
  EXPECT_TRUE(is_own_origin("", "127.0.0.1:8080"));
  EXPECT_TRUE(is_own_origin("http://127.0.0.1:8080", "127.0.0.1:8080"));
  for (const char* origin : {"http://127.0.0.1:8081", "https://127.0.0.1:8080", "http://evil.example", "null"}) {
    EXPECT_FALSE(is_own_origin(origin, "127.0.0.1:8080")) << origin;
  }
}

TEST(ClientLimit, HoldsUntilAClientHasLeft) {
  ClientLimit limit(2);
  const ClientLimit::Clock::time_point start{};
  EXPECT_TRUE(limit.admit("a", start));
  EXPECT_TRUE(limit.admit("b", start));
  EXPECT_FALSE(limit.admit("c", start));
  EXPECT_TRUE(limit.admit("a", start + seconds(4)));
  EXPECT_FALSE(limit.admit("c", start + seconds(5)));
  EXPECT_TRUE(limit.admit("c", start + seconds(6))) << "b has not asked for anything since the start";
  EXPECT_FALSE(limit.admit("b", start + seconds(6)));
}

TEST(ClientLimit, OnePictureInWorkForEach) {
  ClientLimit limit(2);
  EXPECT_TRUE(limit.begin_picture("a"));
  EXPECT_FALSE(limit.begin_picture("a"));
  EXPECT_TRUE(limit.begin_picture("b"));
  limit.end_picture("a");
  EXPECT_TRUE(limit.begin_picture("a"));
}

TEST(ClientLimit, APictureInWorkDoesNotKeepTheClientThatHasLeft) {
  ClientLimit limit(1);
  const ClientLimit::Clock::time_point start{};
  EXPECT_TRUE(limit.admit("a", start));
  EXPECT_TRUE(limit.begin_picture("a"));
  EXPECT_FALSE(limit.admit("b", start + seconds(5)));
  EXPECT_TRUE(limit.admit("b", start + seconds(6)));
  EXPECT_FALSE(limit.begin_picture("b")) << "the number of pictures in work is limited, too";
  limit.end_picture("a");
  EXPECT_TRUE(limit.begin_picture("b"));
}

}  // namespace
}  // namespace b3dgs
