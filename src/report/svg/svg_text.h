// SVG elements that all charts use.
#pragma once

#include <string>

#include "report/svg/svg_chart.h"

namespace b3dgs::svg {

/// A coordinate rounded to 0.1 px.
std::string px(double value);

/// Approximate width of a label, px.
double text_width(const std::string& text);

/// `attributes` are inserted into the tag as given: class="tick" text-anchor="end".
std::string text(double x, double y, const std::string& attributes, const std::string& content);
std::string line(double x1, double y1, double x2, double y2, const std::string& attributes);
std::string rect(double x, double y, double width, double height, const std::string& attributes,
                 const std::string& tooltip);

/// The class attribute for a colour: color_class("s", 3) is class="s3". Kinds: "s" stroke, "f" fill, "t" text.
std::string color_class(const char* kind, int color);

/// The svg element; `title` is for screen readers.
std::string picture(int width, int height, const std::string& title, const std::string& attributes,
                    const std::string& body);

/// Names with colour swatches, in lines between x and `right`. Advances `y` to below the legend.
struct LegendEntry {
  std::string name;
  int color = 0;
  double opacity = 1;
};
std::string legend(const std::vector<LegendEntry>& entries, double x, double right, double& y);

}  // namespace b3dgs::svg
