#include "report/svg/svg_chart.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "report/html_report.h"
#include "support/xml.h"

namespace b3dgs {
namespace {

constexpr const char* kHostile = "a<b>&\"'\x01\xff</text>";

std::size_t count(const std::string& text, const std::string& part) {
  std::size_t n = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

LineChart line_chart_of(int n_series, int n_points) {
  LineChart chart;
  chart.title = chart.x_label = chart.y_label = kHostile;
  for (int s = 0; s < n_series; ++s) {
    chart.series.push_back({kHostile + std::to_string(s), {}, s});
    for (int i = 0; i < n_points; ++i) chart.series.back().points.push_back({10.0 * i, 1.0 + i * (s + 1)});
  }
  return chart;
}

TEST(SvgChart, EscapesMarkupControlCharactersAndBrokenUtf8) {
  EXPECT_EQ(escape("a<b>&\"'"), "a&lt;b&gt;&amp;&quot;&#39;");
  EXPECT_EQ(escape("x\x01y\nz"), "x y z");
  EXPECT_EQ(escape("\xff"), "\xef\xbf\xbd");
  EXPECT_EQ(escape("\xc3\xa9"), "\xc3\xa9");
}

TEST(SvgChart, EveryChartIsWellFormed) {
  for (const int n_series : {0, 1, 3, 7}) {
    for (const int n_points : {0, 1, 2, 5000}) {
      LineChart chart = line_chart_of(n_series, n_points);
      chart.events = {{20, kHostile}};
      EXPECT_EQ(test::xml_fault(draw(chart)), "") << n_series << " x " << n_points;
      chart.y_scale = ScaleKind::kLog;
      EXPECT_EQ(test::xml_fault(draw(chart)), "") << n_series << " x " << n_points;
    }
  }
  StackedBars bars{kHostile, kHostile, {kHostile, "b"}, {{kHostile, {1, 2}}, {"none", {0, 0}}}};
  EXPECT_EQ(test::xml_fault(draw(bars)), "");
  EXPECT_EQ(test::xml_fault(draw(StackedBars{})), "");
  HistogramRow histograms{kHostile, kHostile, {{kHostile, {1, 0, 5}}, {"empty", {}}, {"zero", {0, 0}}}};
  histograms.panels.push_back({"far too many bins", std::vector<double>(200, 1.0)});
  EXPECT_EQ(test::xml_fault(draw(histograms)), "");
  EXPECT_EQ(test::xml_fault(draw(HistogramRow{})), "");
}

TEST(SvgChart, AScatterChartIsWellFormedWithADotForEachValidPoint) {
  ScatterChart chart{kHostile, kHostile, kHostile, {}};
  EXPECT_EQ(test::xml_fault(draw(chart)), "");
  chart.dots.push_back({kHostile, 10, 28, 300, 27, 29, 0, kHostile});
  EXPECT_EQ(test::xml_fault(draw(chart)), "");
  EXPECT_EQ(count(draw(chart), "stroke-dasharray"), 0u) << "one dot has no front";
  chart.dots.push_back({"better", 5, 29, 0, 0, 0, 1, ""});
  chart.dots.push_back({"slower and better", 10.5, 29.5, 75, 0, 0, 2, ""});
  chart.dots.push_back({"invalid", std::numeric_limits<double>::quiet_NaN(), 29, 1, 0, 0, 2, ""});
  const std::string svg = draw(chart);
  EXPECT_EQ(test::xml_fault(svg), "");
  EXPECT_EQ(count(svg, "<circle"), 3u);
  EXPECT_EQ(count(svg, "r=\"18\""), 1u) << "the largest";
  EXPECT_EQ(count(svg, "r=\"9\""), 1u) << "a quarter of its area";
  EXPECT_EQ(count(svg, "r=\"4\""), 1u) << "no Gaussians, but visible";
  const std::size_t front = svg.find("stroke-dasharray");
  ASSERT_NE(front, std::string::npos);
  const std::string points = svg.substr(front, svg.find("/>", front) - front);
  EXPECT_EQ(count(points, ","), 2u) << "the first dot is beaten: " << points;
}

TEST(SvgChart, FewSeriesAreLabelledAtTheirEndAndManyInALegend) {
  const std::string few = draw(line_chart_of(3, 10)), many = draw(line_chart_of(6, 10));
  EXPECT_EQ(count(few, "class=\"t"), 3u + count(few, "class=\"tick\""));
  EXPECT_EQ(count(few, "<rect"), 0u);
  EXPECT_EQ(count(many, "<rect"), 6u);
}

TEST(SvgChart, IgnoresNonFiniteNumbers) {
  LineChart chart = line_chart_of(1, 3);
  const std::string before = draw(chart);
  chart.series[0].points.push_back({15, std::numeric_limits<double>::quiet_NaN()});
  chart.series[0].points.push_back({15, std::numeric_limits<double>::infinity()});
  EXPECT_EQ(draw(chart), before);
  chart.y_scale = ScaleKind::kLog;
  chart.series[0].points.push_back({15, 0});
  EXPECT_EQ(count(draw(chart), "nan"), 0u);
}

TEST(SvgChart, LongCurvesAreThinnedAndKeepTheirEnds) {
  const std::string svg = draw(line_chart_of(1, 30000));
  EXPECT_LT(svg.size(), 10000u);
  LineChart ends = line_chart_of(1, 30000);
  auto& points = ends.series[0].points;
  points = {points.front(), points.back()};
  const auto last_point = [](const std::string& text) {
    const std::size_t begin = text.find("points=\"");
    const std::string list = text.substr(begin, text.find('"', begin + 8) - begin);
    return list.substr(list.rfind(' '));
  };
  EXPECT_EQ(last_point(svg), last_point(draw(ends)));
}

TEST(SvgAxis, TicksAreRoundAndInside) {
  EXPECT_EQ(nice_ticks(ScaleKind::kLinear, 0, 30000, 6),
            (std::vector<double>{0, 5000, 10000, 15000, 20000, 25000, 30000}));
  EXPECT_EQ(nice_ticks(ScaleKind::kLinear, 0, 1.05, 5).size(), 6u);  // 0, 0.2, ... 1
  EXPECT_EQ(nice_ticks(ScaleKind::kLinear, 1, 2, 6, 1), (std::vector<double>{1, 2})) << "there is no iteration 1.2";
  EXPECT_EQ(nice_ticks(ScaleKind::kLinear, 0, 5, 6, 1), (std::vector<double>{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(nice_ticks(ScaleKind::kLinear, 0, 30000, 6, 1), nice_ticks(ScaleKind::kLinear, 0, 30000, 6));
  EXPECT_EQ(nice_ticks(ScaleKind::kLog, 1, 5000, 5), (std::vector<double>{1, 10, 100, 1000}));
  EXPECT_EQ(nice_ticks(ScaleKind::kLog, 1, 12, 5), (std::vector<double>{1, 2, 5, 10}));
  for (const double high : {1e-6, 0.3, 7.0, 123456.0}) {
    const std::vector<double> ticks = nice_ticks(ScaleKind::kLinear, -high / 3, high, 5);
    EXPECT_GE(ticks.size(), 3u) << high;
    EXPECT_LE(ticks.size(), 12u) << high;
    EXPECT_GE(ticks.front(), -high / 3 * 1.0001);
    EXPECT_LE(ticks.back(), high * 1.0001);
  }
  EXPECT_EQ(nice_ticks(ScaleKind::kLinear, 3, 3, 5).size(), 1u);
}

TEST(SvgAxis, NumbersHaveAsManyDigitsAsTheyNeed) {
  EXPECT_EQ(format_tick(0, 1), "0");
  EXPECT_EQ(format_tick(30000, 5000), "30,000");
  EXPECT_EQ(format_tick(0.25, 0.05), "0.25");
  EXPECT_EQ(format_tick(1500000, 500000), "1.5 M");
  EXPECT_EQ(format_tick(500000, 500000), "0.5 M");
  EXPECT_EQ(format_tick(1020000, 20000), "1,020,000");
  EXPECT_EQ(format_seconds(3.2, 3.2), "3.20 s");
  EXPECT_EQ(format_seconds(120, 100), "120.0 s");
  EXPECT_EQ(format_figure(16), "16");
  EXPECT_EQ(format_figure(12.345), "12.3");
  EXPECT_EQ(format_figure(0.012345), "0.0123");
  EXPECT_EQ(format_figure(54321.5), "54,322");
}

TEST(SvgAxis, RangesAreNeverEmpty) {
  for (const ScaleKind kind : {ScaleKind::kLinear, ScaleKind::kLog}) {
    for (const double value : {0.0, 5.0, 1e9}) {
      double low = value, high = value;
      pad_range(kind, false, low, high);
      EXPECT_LT(low, high) << value;
    }
  }
}

TEST(HtmlReport, APageIsWellFormedAndHasNoExternalLinks) {
  Image8 image(5, 4, 3);
  image.pixels[0] = 255;
  const std::string body = html::section(kHostile, html::paragraph(kHostile) + html::figure("<b>x</b>", kHostile)) +
                           html::table({kHostile, "b"}, {{kHostile, "1"}, {"c", "2"}}, html::Columns::kFigures, 1) +
                           html::table({}, {{"a", "b"}}) +
                           html::picture_grid({{kHostile, kHostile, html::data_uri(image)}}, 2) +
                           html::folded_section(kHostile, html::paragraph(kHostile));
  const std::string page = html::page(kHostile, kHostile, body);
  EXPECT_EQ(test::xml_fault(page), "");
  EXPECT_EQ(page.find("http"), std::string::npos);
  EXPECT_EQ(page.find("a<b>"), std::string::npos);
  EXPECT_NE(page.find("data:image/jpeg;base64,/9j/"), std::string::npos) << "the first bytes of any JPEG";
}

}  // namespace
}  // namespace b3dgs
