// Draws line charts: curves, bands and events over iterations.
#include <algorithm>
#include <cmath>
#include <limits>

#include "report/svg/svg_chart.h"
#include "report/svg/svg_text.h"

namespace b3dgs {
namespace {

constexpr int kWidth = 760;                 // px
constexpr double kLeft = 58, kBottom = 38;  // px
constexpr std::size_t kMaxPoints = 300;     // per curve: more cannot be distinguished at this width
constexpr std::size_t kMaxDirectLabels = 4;
constexpr double kLabelHeight = 15, kMaxLabelWidth = 200;  // px

/// Reduces a curve to kMaxPoints by averaging groups of equal size; keeps the first and the last point.
std::vector<ChartPoint> thin(const std::vector<ChartPoint>& points) {
  if (points.size() <= kMaxPoints) return points;
  std::vector<ChartPoint> thinned{points.front()};
  const std::size_t inner = points.size() - 2, runs = kMaxPoints - 2;
  for (std::size_t run = 0; run < runs; ++run) {
    const std::size_t begin = 1 + run * inner / runs, end = 1 + (run + 1) * inner / runs;
    ChartPoint mean;
    for (std::size_t i = begin; i < end; ++i) {
      mean.x += points[i].x / static_cast<double>(end - begin);
      mean.y += points[i].y / static_cast<double>(end - begin);
    }
    thinned.push_back(mean);
  }
  thinned.push_back(points.back());
  return thinned;
}

class LineChartPainter {
 public:
  explicit LineChartPainter(const LineChart& chart) : chart_(chart) {
    remove_invalid_points();
    double widest = 0;
    for (const ChartSeries& series : chart_.series) widest = std::max(widest, svg::text_width(series.name));
    is_labelled_directly_ = chart_.bands.empty() && chart_.series.size() > 1 &&
                            chart_.series.size() <= kMaxDirectLabels && widest <= kMaxLabelWidth;
    right_ = kWidth - (is_labelled_directly_ ? widest + 14 : 14);
  }

  std::string paint() {
    top_ = 4;
    std::string head = paint_legend();
    head += svg::text(0, top_ + 12, "class=\"axis\"", chart_.y_label);
    top_ += 26;
    bottom_ = top_ + chart_.height - kBottom;
    set_scales();
    const std::string body =
        head + paint_axes() + paint_bands() + paint_events() + paint_series() + paint_event_labels() + paint_labels();
    return svg::picture(kWidth, static_cast<int>(bottom_ + kBottom), chart_.title, hover_data(), body);
  }

 private:
  bool can_be_drawn(const ChartPoint& point) const {
    return std::isfinite(point.x) && std::isfinite(point.y) && (chart_.y_scale == ScaleKind::kLinear || point.y > 0);
  }

  void remove_invalid_points() {
    for (ChartSeries& series : chart_.series) {
      auto& points = series.points;
      points.erase(std::remove_if(points.begin(), points.end(), [&](const auto& p) { return !can_be_drawn(p); }),
                   points.end());
      series.points = thin(points);
    }
    if (chart_.y_scale == ScaleKind::kLinear) return;
    for (ChartBand& band : chart_.bands) {  // a logarithmic axis starts at 1; smaller values are drawn there
      for (auto* edge : {&band.lower, &band.upper}) {
        for (ChartPoint& point : *edge) point.y = std::max(point.y, 1.0);
      }
    }
  }

  template <class Visitor>
  void visit_points(Visitor&& visit) const {
    for (const ChartSeries& series : chart_.series) std::for_each(series.points.begin(), series.points.end(), visit);
    for (const ChartBand& band : chart_.bands) {
      std::for_each(band.lower.begin(), band.lower.end(), visit);
      std::for_each(band.upper.begin(), band.upper.end(), visit);
    }
  }

  void set_scales() {
    constexpr double kFar = std::numeric_limits<double>::max();
    double x_low = kFar, x_high = -kFar, y_low = kFar, y_high = -kFar;
    visit_points([&](const ChartPoint& point) {
      x_low = std::min(x_low, point.x), x_high = std::max(x_high, point.x);
      y_low = std::min(y_low, point.y), y_high = std::max(y_high, point.y);
    });
    if (x_low > x_high) x_low = y_low = 0, x_high = y_high = 1;
    if (x_low > 0 && x_low < 0.5 * x_high) x_low = 0;  // iterations start at 0
    if (x_high <= x_low) x_high = x_low + 1;
    pad_range(chart_.y_scale, chart_.from_zero, y_low, y_high);
    x_ = {ScaleKind::kLinear, x_low, x_high, kLeft, right_};
    y_ = {chart_.y_scale, y_low, y_high, bottom_, top_};
  }

  std::string paint_legend() {
    std::vector<svg::LegendEntry> entries;
    if (!is_labelled_directly_ && chart_.series.size() + chart_.bands.size() > 1) {
      for (const ChartSeries& series : chart_.series) entries.push_back({series.name, series.color});
    }
    for (const ChartBand& band : chart_.bands) entries.push_back({band.name, band.color, band.opacity});
    return entries.empty() ? "" : svg::legend(entries, 0, kWidth, top_);
  }

  std::string paint_axes() const {
    std::string body;
    const std::vector<double> y_ticks = nice_ticks(y_.kind, y_.low, y_.high, 5);
    for (std::size_t i = 0; i < y_ticks.size(); ++i) {
      const double at = y_(y_ticks[i]);
      const double step = y_.kind == ScaleKind::kLog ? y_ticks[i] : y_ticks.size() > 1 ? y_ticks[1] - y_ticks[0] : 1;
      const bool is_base = y_.kind == ScaleKind::kLinear && y_ticks[i] == 0;
      body += svg::line(kLeft, at, right_, at, is_base ? "class=\"base\"" : "class=\"grid\"");
      body += svg::text(kLeft - 8, at + 4, "class=\"tick\" text-anchor=\"end\"", format_tick(y_ticks[i], step));
    }
    const std::vector<double> x_ticks = nice_ticks(ScaleKind::kLinear, x_.low, x_.high, 6, 1);  // iterations
    const double step = x_ticks.size() > 1 ? x_ticks[1] - x_ticks[0] : 1;
    for (const double tick : x_ticks) {
      body += svg::line(x_(tick), bottom_, x_(tick), bottom_ + 4, "class=\"base\"");
      body += svg::text(x_(tick), bottom_ + 17, "class=\"tick\" text-anchor=\"middle\"", format_tick(tick, step));
    }
    body += svg::line(kLeft, bottom_, right_, bottom_, "class=\"base\"");
    return body + svg::text(right_, bottom_ + 33, "class=\"axis\" text-anchor=\"end\"", chart_.x_label);
  }

  bool is_inside(const ChartEvent& event) const { return x_(event.x) > kLeft - 1 && x_(event.x) < right_ + 1; }

  std::string paint_events() const {
    std::string body;
    for (const ChartEvent& event : chart_.events) {
      if (is_inside(event)) body += svg::line(x_(event.x), top_, x_(event.x), bottom_, "class=\"event\"");
    }
    return body;
  }

  /// At the bottom, where curves rarely are.
  std::string paint_event_labels() const {
    std::string body;
    for (const ChartEvent& event : chart_.events) {
      if (!is_inside(event)) continue;
      const double at = x_(event.x);
      const bool fits_right = at + 6 + svg::text_width(event.label) < right_;
      body += svg::text(at + (fits_right ? 5 : -5), bottom_ - 8,
                        fits_right ? "class=\"note\"" : "class=\"note\" text-anchor=\"end\"", event.label);
    }
    return body;
  }

  std::string path(const std::vector<ChartPoint>& points) const {
    std::string text;
    for (const ChartPoint& point : points) text += svg::px(x_(point.x)) + "," + svg::px(y_(point.y)) + " ";
    if (!text.empty()) text.pop_back();
    return text;
  }

  std::string paint_bands() const {
    std::string body;
    for (const ChartBand& band : chart_.bands) {
      std::vector<ChartPoint> outline = band.upper;
      outline.insert(outline.end(), band.lower.rbegin(), band.lower.rend());
      body += "<polygon " + svg::color_class("f", band.color) + " fill-opacity=\"" + svg::px(band.opacity) +
              "\" points=\"" + path(outline) + "\"/>\n";
    }
    return body;
  }

  std::string paint_series() const {
    std::string body;
    for (const ChartSeries& series : chart_.series) {
      body += "<polyline " + svg::color_class("s", series.color) + " data-name=\"" + escape(series.name) +
              "\" points=\"" + path(series.points) + "\"/>\n";
      if (!series.has_markers && series.points.size() > 1) continue;
      for (const ChartPoint& point : series.points) {
        body += "<circle " + svg::color_class("f", series.color) + " cx=\"" + svg::px(x_(point.x)) + "\" cy=\"" +
                svg::px(y_(point.y)) + "\" r=\"3\"><title>" +
                escape(series.name + ": " + format_figure(point.y) + " at " + format_tick(point.x, 1)) +
                "</title></circle>\n";
      }
    }
    return body;
  }

  /// Names at the ends of the curves, moved apart vertically where they would overlap.
  std::string paint_labels() const {
    if (!is_labelled_directly_) return "";
    struct Label {
      double y;
      const ChartSeries* series;
    };
    std::vector<Label> labels;
    for (const ChartSeries& series : chart_.series) {
      if (!series.points.empty()) labels.push_back({y_(series.points.back().y), &series});
    }
    std::sort(labels.begin(), labels.end(), [](const Label& a, const Label& b) { return a.y < b.y; });
    for (std::size_t i = 1; i < labels.size(); ++i) {
      labels[i].y = std::max(labels[i].y, labels[i - 1].y + kLabelHeight);
    }
    double limit = bottom_;
    for (auto label = labels.rbegin(); label != labels.rend(); ++label, limit -= kLabelHeight) {
      label->y = std::min(label->y, limit);
    }
    std::string body;
    for (const Label& label : labels) {
      body += svg::text(right_ + 7, label.y + 4, svg::color_class("t", label.series->color), label.series->name);
    }
    return body;
  }

  /// Axis ranges in values and pixels, for the page's script to show the values at the pointer.
  std::string hover_data() const {
    const auto number = [](double value) {
      char text[32];
      std::snprintf(text, sizeof text, "%.8g", value);
      return std::string(text);
    };
    return "data-x=\"" + number(x_.low) + " " + number(x_.high) + " " + svg::px(x_.from_px) + " " + svg::px(x_.to_px) +
           "\" data-y=\"" + number(y_.low) + " " + number(y_.high) + " " + svg::px(y_.from_px) + " " +
           svg::px(y_.to_px) + " " + (y_.kind == ScaleKind::kLog ? "log" : "linear") + "\"";
  }

  LineChart chart_;
  bool is_labelled_directly_ = false;
  double top_ = 0, bottom_ = 0, right_ = 0;
  Scale x_, y_;
};

}  // namespace

std::string draw(const LineChart& chart) {
  return LineChartPainter(chart).paint();
}

}  // namespace b3dgs
