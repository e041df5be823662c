// Pieces of SVG that all charts are made of.
#pragma once

#include <string>

#include "report/svg/svg_chart.h"

namespace b3dgs::svg {

/// A coordinate: a tenth of a px is enough.
std::string px(double value);

/// About how wide a label is, px.
double text_width(const std::string& text);

/// `attributes` as they stand in the tag: class="tick" text-anchor="end".
std::string text(double x, double y, const std::string& attributes, const std::string& content);
std::string line(double x1, double y1, double x2, double y2, const std::string& attributes);
std::string rect(double x, double y, double width, double height, const std::string& attributes,
                 const std::string& tooltip);

/// A colour of the palette: class="s3" for strokes, "f3" for areas, "t3" for text.
std::string color_class(const char* kind, int color);

/// The whole picture, with its title for screen readers.
std::string picture(int width, int height, const std::string& title, const std::string& attributes,
                    const std::string& body);

/// Names with their colours in a row from (x, y) on, broken at `right`. Adds the height it took to `y`.
struct LegendEntry {
  std::string name;
  int color = 0;
  double opacity = 1;
};
std::string legend(const std::vector<LegendEntry>& entries, double x, double right, double& y);

}  // namespace b3dgs::svg
