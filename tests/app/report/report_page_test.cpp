// The HTML page around a report's data.
#include "app/report/page_data.h"

#include <gtest/gtest.h>

#include <limits>

#include "support/page_data.h"

namespace b3dgs {
namespace {

TEST(ReportPage, NoTextOfTheDataBecomesHtml) {
  const std::string hostile = "</script><script>alert(1)</script><!--<img src=x onerror=alert(1)>&\"'\\\x01\xff";
  const nlohmann::ordered_json data{{"kind", "training"}, {hostile, {hostile, 1}}};
  const std::string page = report_page(data);
  EXPECT_EQ(page.find("alert(1)</script"), std::string::npos);
  EXPECT_EQ(page.find("<!--"), std::string::npos);
  EXPECT_EQ(page.find("<img"), std::string::npos);
  EXPECT_EQ(page.find('\x01'), std::string::npos);
  EXPECT_EQ(page.find('\xff'), std::string::npos);
  const nlohmann::ordered_json read = test::data_of_page(page);
  std::string shown = hostile;
  shown.replace(shown.size() - 1, 1, "\xef\xbf\xbd");
  EXPECT_EQ(read.at(shown).at(0), shown) << "the page shows the text itself";
}

TEST(ReportPage, RefersToNothingOutsideOfItself) {
  std::string page = report_page({{"kind", "training"}});
  EXPECT_EQ(page.compare(0, 15, "<!DOCTYPE html>"), 0);
  EXPECT_EQ(page.find('@'), page.find("@media")) << "every mark of the template is replaced";
  EXPECT_NE(page.find("Permission is hereby granted"), std::string::npos) << "the page has uPlot's licence";
  const std::string notice = "https://github.com/leeoniya/uPlot";  // in a comment
  page.erase(page.find(notice), notice.size());
  for (const char* from_elsewhere : {"https:", "src=\"", "href=\"h", "@import", "url("}) {
    EXPECT_EQ(page.find(from_elsewhere), std::string::npos) << from_elsewhere;
  }
}

TEST(ReportPage, NumbersKeepTheDigitsThatAreShown) {
  const auto read = test::data_of_page(report_page({{"loss", 0.12345678},
                                                    {"mean", 1050457.5},
                                                    {"n", 1234567890},
                                                    {"none", std::numeric_limits<double>::quiet_NaN()}}));
  EXPECT_EQ(read["loss"], 0.123457);
  EXPECT_EQ(read["mean"], 1050457.5);
  EXPECT_EQ(read["n"], 1234567890);
  EXPECT_TRUE(read["none"].is_null());
}

TEST(ReportPage, ImagesAreJpegsInDataUris) {
  EXPECT_EQ(data_uri(Image8(5, 4, 3)).find("data:image/jpeg;base64,/9j/"), 0u) << "the first bytes of any JPEG";
}

TEST(Figures, HaveAsManyDigitsAsTheyNeed) {
  EXPECT_EQ(format_seconds(3.2, 3.2), "3.20 s");
  EXPECT_EQ(format_seconds(120, 100), "120.0 s");
}

}  // namespace
}  // namespace b3dgs
