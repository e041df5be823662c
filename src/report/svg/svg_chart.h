// Charts as inline SVG for report.html. Colours are CSS classes numbered 0 to 9, defined in the page's style sheet
// (html_report.cpp) for light mode, dark mode and print. All text is escaped.
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
  bool has_markers = false;        // draw a dot at each point
};

/// The area between two curves with the same x values.
struct ChartBand {
  std::string name;
  std::vector<ChartPoint> lower, upper;
  int color = 0;
  double opacity = 0.3;
};

/// A labelled vertical line.
struct ChartEvent {
  double x = 0;
  std::string label;
};

/// Curves over iterations. Two to four series are labelled at their right end, more in a legend; bands in a legend.
struct LineChart {
  std::string title;             // for screen readers
  std::string x_label, y_label;  // y_label includes the unit
  ScaleKind y_scale = ScaleKind::kLinear;
  bool from_zero = true;  // a linear y axis starts at 0
  std::vector<ChartBand> bands{};
  std::vector<ChartSeries> series{};
  std::vector<ChartEvent> events{};
  int height = 280;  // px
};
std::string draw(const LineChart& chart);

/// Labelled dots, whose areas stand for a third quantity, and a line through those that no other dot beats in both:
/// none has a smaller x and a larger y (the Pareto front).
struct ScatterChart {
  struct Dot {
    std::string name;
    double x = 0, y = 0;
    double size = 0;               // not negative; the largest dot has a radius of 18 px
    double y_low = 0, y_high = 0;  // drawn as a vertical line if they differ
    int color = 0;
    std::string note;  // shown with the name at the pointer
  };
  std::string title, x_label, y_label;  // labels include the unit
  std::vector<Dot> dots;
  int height = 320;  // px
};
std::string draw(const ScatterChart& chart);

/// One horizontal bar per row, divided into parts. A part has the same colour in all rows.
struct StackedBars {
  struct Row {
    std::string name;
    std::vector<double> parts;  // one per entry of part_names, not negative
  };
  std::string title, unit;
  std::vector<std::string> part_names;
  std::vector<Row> rows;
};
std::string draw(const StackedBars& chart);

/// Small histograms side by side on the same axes: share of items by value, in bins of doubling width.
struct HistogramRow {
  struct Panel {
    std::string name;
    std::vector<double> counts;  // bin 0: value 0, bin k: values in [2^(k-1), 2^k)
  };
  std::string title, x_label;
  std::vector<Panel> panels;
};
std::string draw(const HistogramRow& chart);

/// Escapes `text` for HTML and XML; control characters become spaces and invalid UTF-8 becomes U+FFFD.
std::string escape(const std::string& text);

}  // namespace b3dgs
