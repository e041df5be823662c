// Draws scatter charts: labelled dots and their Pareto front.
#include <algorithm>
#include <cmath>

#include "report/svg/svg_chart.h"
#include "report/svg/svg_text.h"

namespace b3dgs {
namespace {

constexpr int kWidth = 760;                                       // px
constexpr double kLeft = 58, kTop = 30, kBottom = 38;             // px
constexpr double kSmallest = 4, kLargest = 18, kLineHeight = 15;  // px

class ScatterPainter {
 public:
  explicit ScatterPainter(const ScatterChart& chart) : chart_(chart), bottom_(kTop + chart.height - kBottom) {
    auto& dots = chart_.dots;
    dots.erase(std::remove_if(dots.begin(), dots.end(),
                              [](const auto& dot) {
                                return !std::isfinite(dot.x) || !std::isfinite(dot.y) || !std::isfinite(dot.size);
                              }),
               dots.end());
    double x_low = 0, x_high = 1, y_low = 0, y_high = 1;
    for (std::size_t i = 0; i < dots.size(); ++i) {
      const ScatterChart::Dot& dot = dots[i];
      largest_ = std::max(largest_, dot.size);
      x_high = i == 0 ? dot.x : std::max(x_high, dot.x);
      y_low = std::min(i == 0 ? dot.y : y_low, std::min(dot.y, low(dot)));
      y_high = std::max(i == 0 ? dot.y : y_high, std::max(dot.y, high(dot)));
    }
    pad_range(ScaleKind::kLinear, /*from_zero=*/true, x_low, x_high);
    pad_range(ScaleKind::kLinear, /*from_zero=*/false, y_low, y_high);
    // Room for the largest dot at the right and above.
    x_ = {ScaleKind::kLinear, x_low, x_high, kLeft, kWidth - 14 - kLargest};
    y_ = {ScaleKind::kLinear, y_low, y_high, bottom_ - kLargest, kTop + kLargest};
  }

  std::string paint() const {
    const std::string body = svg::text(0, 12, "class=\"axis\"", chart_.y_label) + paint_axes() + paint_front() +
                             paint_dots() + paint_labels();
    return svg::picture(kWidth, static_cast<int>(bottom_ + kBottom), chart_.title, "", body);
  }

 private:
  static bool has_range(const ScatterChart::Dot& dot) {
    return std::isfinite(dot.y_low) && std::isfinite(dot.y_high) && dot.y_low < dot.y_high;
  }
  static double low(const ScatterChart::Dot& dot) { return has_range(dot) ? dot.y_low : dot.y; }
  static double high(const ScatterChart::Dot& dot) { return has_range(dot) ? dot.y_high : dot.y; }

  double radius(const ScatterChart::Dot& dot) const {
    return largest_ <= 0 ? kSmallest : std::max(kSmallest, kLargest * std::sqrt(std::max(0.0, dot.size) / largest_));
  }

  std::string paint_axes() const {
    std::string body;
    const double right = kWidth - 14;
    const std::vector<double> y_ticks = nice_ticks(y_.kind, y_.low, y_.high, 5);
    const double y_step = y_ticks.size() > 1 ? y_ticks[1] - y_ticks[0] : 1;
    for (const double tick : y_ticks) {
      body += svg::line(kLeft, y_(tick), right, y_(tick), "class=\"grid\"");
      body += svg::text(kLeft - 8, y_(tick) + 4, "class=\"tick\" text-anchor=\"end\"", format_tick(tick, y_step));
    }
    const std::vector<double> x_ticks = nice_ticks(x_.kind, x_.low, x_.high, 6);
    const double x_step = x_ticks.size() > 1 ? x_ticks[1] - x_ticks[0] : 1;
    for (const double tick : x_ticks) {
      body += svg::line(x_(tick), bottom_, x_(tick), bottom_ + 4, "class=\"base\"");
      body += svg::text(x_(tick), bottom_ + 17, "class=\"tick\" text-anchor=\"middle\"", format_tick(tick, x_step));
    }
    body += svg::line(kLeft, bottom_, right, bottom_, "class=\"base\"");
    return body + svg::text(right, bottom_ + 33, "class=\"axis\" text-anchor=\"end\"", chart_.x_label);
  }

  /// From left to right, each dot that is above all before it.
  std::string paint_front() const {
    std::vector<ScatterChart::Dot> dots = chart_.dots;
    std::stable_sort(dots.begin(), dots.end(),
                     [](const auto& a, const auto& b) { return a.x < b.x || (a.x == b.x && a.y > b.y); });
    std::string points;
    std::size_t n = 0;
    double best = 0;
    for (const ScatterChart::Dot& dot : dots) {
      if (n > 0 && dot.y <= best) continue;
      best = dot.y;
      points += (n++ > 0 ? " " : "") + svg::px(x_(dot.x)) + "," + svg::px(y_(dot.y));
    }
    // The class of grey curves; a single dot is its own front.
    return n < 2 ? ""
                 : "<polyline " + svg::color_class("s", 9) + " stroke-dasharray=\"4 4\" points=\"" + points + "\"/>\n";
  }

  std::string paint_dots() const {
    std::vector<const ScatterChart::Dot*> dots;
    for (const ScatterChart::Dot& dot : chart_.dots) dots.push_back(&dot);
    // Small ones last, so that none is hidden.
    std::stable_sort(dots.begin(), dots.end(), [](const auto* a, const auto* b) { return a->size > b->size; });
    std::string body;
    for (const ScatterChart::Dot* dot : dots) {
      const std::string x = svg::px(x_(dot->x));
      if (has_range(*dot)) {
        body += "<polyline " + svg::color_class("s", dot->color) + " points=\"" + x + "," + svg::px(y_(dot->y_low)) +
                " " + x + "," + svg::px(y_(dot->y_high)) + "\"/>\n";
      }
      body += "<circle " + svg::color_class("f", dot->color) + " fill-opacity=\"0.75\" cx=\"" + x + "\" cy=\"" +
              svg::px(y_(dot->y)) + "\" r=\"" + svg::px(radius(*dot)) + "\"><title>" +
              escape(dot->name + (dot->note.empty() ? "" : ": " + dot->note)) + "</title></circle>\n";
    }
    return body;
  }

  /// Names to the right of the dots, or to the left where there is no room, moved down where they would overlap.
  std::string paint_labels() const {
    struct Label {
      double left, right, y;
      const ScatterChart::Dot* dot;
    };
    std::vector<Label> labels;
    for (const ScatterChart::Dot& dot : chart_.dots) {
      const double width = svg::text_width(dot.name), gap = radius(dot) + 5;
      const bool fits = x_(dot.x) + gap + width < kWidth;
      const double left = fits ? x_(dot.x) + gap : x_(dot.x) - gap - width;
      labels.push_back({left, left + width, y_(dot.y) + 4, &dot});
    }
    std::stable_sort(labels.begin(), labels.end(), [](const Label& a, const Label& b) { return a.y < b.y; });
    std::string body;
    for (std::size_t i = 0; i < labels.size(); ++i) {
      for (std::size_t j = 0; j < i; ++j) {  // those above are in place, from top to bottom
        const bool overlaps = labels[i].left < labels[j].right && labels[j].left < labels[i].right;
        if (overlaps && labels[i].y < labels[j].y + kLineHeight) labels[i].y = labels[j].y + kLineHeight;
      }
      body += svg::text(labels[i].left, labels[i].y, svg::color_class("t", labels[i].dot->color), labels[i].dot->name);
    }
    return body;
  }

  ScatterChart chart_;
  double bottom_, largest_ = 0;
  Scale x_, y_;
};

}  // namespace

std::string draw(const ScatterChart& chart) {
  return ScatterPainter(chart).paint();
}

}  // namespace b3dgs
