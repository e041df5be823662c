// Charts as inline SVG for report.html, whose style sheet gives the colours: class "c0" to "c9" stands for the palette
// (html_report.h), so that one picture serves light, dark and paper. Text is escaped here.
#pragma once

#include <string>
#include <vector>

#include "report/svg/svg_axis.h"

namespace b3dgs {

struct ChartPoint {
  double x = 0, y = 0;
};

struct ChartSeries {
  std::string name;
  std::vector<ChartPoint> points;  // by x
  int color = 0;                   // of the palette
  bool has_markers = false;        // points are few, and each was measured
};

/// The area between two curves over the same x.
struct ChartBand {
  std::string name;
  std::vector<ChartPoint> lower, upper;
  int color = 0;
  double opacity = 0.3;
};

/// A vertical line where something happened.
struct ChartEvent {
  double x = 0;
  std::string label;
};

/// Curves over iterations. Up to four series are named at their right end, more in a legend; bands always in one.
struct LineChart {
  std::string title;             // for those who cannot see it
  std::string x_label, y_label;  // y_label with its unit, "seconds"
  ScaleKind y_scale = ScaleKind::kLinear;
  bool from_zero = true;  // a linear y axis begins at 0
  std::vector<ChartBand> bands{};
  std::vector<ChartSeries> series{};
  std::vector<ChartEvent> events{};
  int height = 280;  // px
};
std::string draw(const LineChart& chart);

/// One horizontal bar per row, cut into parts; every part has a colour, its own over all rows.
struct StackedBars {
  struct Row {
    std::string name;
    std::vector<double> parts;  // as many as part_names, not negative
  };
  std::string title, unit;
  std::vector<std::string> part_names;
  std::vector<Row> rows;
};
std::string draw(const StackedBars& chart);

/// Small histograms side by side, on the same axes: shares of all items by value, in bins that double.
struct HistogramRow {
  struct Panel {
    std::string name;
    std::vector<double> counts;  // bin 0: value 0, bin k: values in [2^(k-1), 2^k)
  };
  std::string title, x_label;
  std::vector<Panel> panels;
};
std::string draw(const HistogramRow& chart);

/// `text` for HTML and XML: markup characters escaped, control characters and broken UTF-8 replaced.
std::string escape(const std::string& text);

}  // namespace b3dgs
