// The "Load" section of a report: how evenly the work is distributed over tiles and pixels.
#include <algorithm>

#include "core/check.h"
#include "report/report_sections.h"

namespace b3dgs {
namespace {

using LoadField = std::optional<LoadFigures> LoadEvent::*;

std::string gini_text(const std::vector<const LoadEvent*>& events, LoadField field) {
  const auto value_at = [&](const LoadEvent& event) {
    return detail::concat(format_figure((event.*field)->gini), " at iteration ", format_tick(event.iteration, 1));
  };
  std::string text = " Gini coefficient (0 = evenly distributed, 1 = maximally uneven): " + value_at(*events.front());
  if (events.size() > 1) text += ", " + value_at(*events.back());
  return text + ".";
}

std::vector<const LoadEvent*> events_with(const TrainHistory& history, LoadField field) {
  std::vector<const LoadEvent*> events;
  for (const LoadEvent& event : history.loads) {
    if (event.*field) events.push_back(&event);
  }
  return events;
}

/// Quantiles over the iterations; a sentence if there is only one measurement.
std::string load_figure(const TrainHistory& history, LoadField field, const std::string& name,
                        const std::string& caption) {
  const std::vector<const LoadEvent*> events = events_with(history, field);
  if (events.empty()) return "";
  if (events.size() == 1) {
    const LoadFigures& load = *(events[0]->*field);
    return html::paragraph(detail::concat(name, " at iteration ", format_tick(events[0]->iteration, 1), ": median ",
                                          format_figure(load.median), ", 90th percentile ", format_figure(load.p90),
                                          ", 99th percentile ", format_figure(load.p99), ", maximum ",
                                          format_figure(load.max), ".", gini_text(events, field)));
  }
  std::vector<ChartPoint> min, median, p90, p99, max;
  for (const LoadEvent* event : events) {
    const LoadFigures& load = *(event->*field);
    const double x = event->iteration;
    min.push_back({x, load.min});
    median.push_back({x, load.median});
    p90.push_back({x, load.p90});
    p99.push_back({x, load.p99});
    max.push_back({x, load.max});
  }
  LineChart chart{name + " over the iterations", "iteration", name, ScaleKind::kLog};
  chart.bands = {{"99th percentile to maximum", p99, max, 0, 0.2},
                 {"90th to 99th percentile", p90, p99, 0, 0.4},
                 {"median to 90th percentile", median, p90, 0, 0.6},
                 {"minimum to median", min, median, 8, 0.3}};
  chart.series = {{"median", median, 0, median.size() <= 40}};
  return html::figure(draw(chart), caption + gini_text(events, field));
}

std::string load_histograms(const TrainHistory& history, LoadField field, const std::string& name,
                            const std::string& caption) {
  std::vector<const LoadEvent*> filled;
  for (const LoadEvent* event : events_with(history, field)) {
    if (!(event->*field)->log2_bins.empty()) filled.push_back(event);
  }
  if (filled.empty()) return "";
  constexpr std::size_t kMaxPanels = 4;
  const std::size_t n = std::min(kMaxPanels, filled.size());
  HistogramRow chart{"Distribution of " + name, name + ", each bin twice as wide as the one before", {}};
  for (std::size_t i = 0; i < n; ++i) {
    const LoadEvent& event = *filled[n > 1 ? i * (filled.size() - 1) / (n - 1) : 0];
    chart.panels.push_back({"iteration " + format_tick(event.iteration, 1), (event.*field)->log2_bins});
  }
  return html::figure(draw(chart), caption);
}

}  // namespace

std::string load_section(const TrainHistory& history) {
  const std::string body =
      load_figure(history, &LoadEvent::tile_lists, "Gaussians per tile",
                  "Number of Gaussians in a tile's list: quantiles over all tiles.") +
      load_figure(
          history, &LoadEvent::pixel_processed, "Gaussians processed per pixel",
          "Number of Gaussians that a pixel processes before it is saturated or its tile's list ends: quantiles "
          "over all pixels.") +
      load_histograms(history, &LoadEvent::tile_lists, "Gaussians per tile",
                      "Share of tiles by the length of their list. A kernel that assigns one thread block to each tile "
                      "waits for the longest lists.") +
      load_histograms(history, &LoadEvent::pixel_processed, "Gaussians processed per pixel",
                      "Share of pixels by the number of Gaussians that they process. A kernel that assigns one thread "
                      "to each pixel leaves threads idle while others of their warp continue.");
  return body.empty() ? html::paragraph("Load statistics were not recorded (--stats_interval 0).", "soft") : body;
}

}  // namespace b3dgs
