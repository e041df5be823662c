#include "report/html_report.h"

#include <cstdint>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "core/check.h"
#include "report/svg/svg_chart.h"

namespace b3dgs::html {
namespace {

// Colours are those of Okabe and Ito, distinguishable with any type of colour vision; lighter in dark mode. Neither the
// style sheet nor the script contains & or <, so that the page is well-formed XML.
constexpr const char* kStyle = R"css(
:root { color-scheme: light dark;
  --paper: #ffffff; --ink: #1b1f24; --soft: #5b6572; --grid: #e6e9ed; --base: #9aa4af; --mark: #eef4f9;
  --c0: #0072b2; --c1: #d55e00; --c2: #009e73; --c3: #cc79a7; --c4: #e69f00;
  --c5: #56b4e9; --c6: #8a6d3b; --c7: #93920b; --c8: #a4abb3; --c9: #5f6872; }
@media (prefers-color-scheme: dark) { :root {
  --paper: #15181c; --ink: #e6e9ec; --soft: #a0a9b3; --grid: #2a3037; --base: #616b76; --mark: #1d2731;
  --c0: #4fa9e2; --c1: #ff8a4c; --c2: #35c79c; --c3: #e39bc4; --c4: #f2b84b;
  --c5: #93d3f7; --c6: #c3a36a; --c7: #c9c848; --c8: #6d7680; --c9: #aab2bb; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 40px 24px 64px; max-width: 844px; background: var(--paper); color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 26px; line-height: 1.3; margin: 0 0 12px; font-weight: 650; text-wrap: balance; }
h2 { font-size: 18px; margin: 44px 0 8px; font-weight: 650; }
h3 { font-size: 15px; margin: 28px 0 6px; font-weight: 650; }
h1, p { overflow-wrap: anywhere; }
p { margin: 8px 0; } .soft, figcaption { color: var(--soft); font-size: 13.5px; }
figure { margin: 18px 0 24px; } figcaption { margin-top: 6px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 14px 0; font-variant-numeric: tabular-nums; font-size: 14px; }
th, td { padding: 5px 18px 5px 0; text-align: right; border-bottom: 1px solid var(--grid); vertical-align: top; }
th:first-child, td:first-child { text-align: left; overflow-wrap: anywhere; min-width: 9.5em; }
th { color: var(--soft); font-weight: 500; }
table.words th, table.words td { text-align: left; overflow-wrap: break-word; }
tr.marked td { background: var(--mark); font-weight: 600; }
details { margin-top: 28px; border-top: 1px solid var(--grid); padding-top: 14px; }
summary { cursor: pointer; font-size: 18px; font-weight: 650; }
svg.chart { display: block; width: 100%; height: auto; overflow: visible;
  font: 12px system-ui, "DejaVu Sans", sans-serif; }
.tick, .axis, .note { fill: var(--soft); } .label { fill: var(--ink); }
.note, .t0, .t1, .t2, .t3, .t4, .t5, .t6, .t7, .t8, .t9 {
  paint-order: stroke; stroke: var(--paper); stroke-width: 3px; }
.inside { fill: var(--paper); }
.grid { stroke: var(--grid); } .base { stroke: var(--base); } .event { stroke: var(--soft); stroke-dasharray: 3 3; }
polyline { fill: none; stroke-width: 2; stroke-linejoin: round; stroke-linecap: round; }
.s0 { stroke: var(--c0); } .f0, .t0 { fill: var(--c0); } .s1 { stroke: var(--c1); } .f1, .t1 { fill: var(--c1); }
.s2 { stroke: var(--c2); } .f2, .t2 { fill: var(--c2); } .s3 { stroke: var(--c3); } .f3, .t3 { fill: var(--c3); }
.s4 { stroke: var(--c4); } .f4, .t4 { fill: var(--c4); } .s5 { stroke: var(--c5); } .f5, .t5 { fill: var(--c5); }
.s6 { stroke: var(--c6); } .f6, .t6 { fill: var(--c6); } .s7 { stroke: var(--c7); } .f7, .t7 { fill: var(--c7); }
.s8 { stroke: var(--c8); } .f8, .t8 { fill: var(--c8); } .s9 { stroke: var(--c9); } .f9, .t9 { fill: var(--c9); }
.pictures { display: grid; gap: 12px 8px; }
.pictures img { width: 100%; height: auto; display: block; border-radius: 3px; }
.pictures div { font-size: 12.5px; color: var(--soft); overflow-wrap: anywhere; min-width: 0; }
.hover { position: fixed; pointer-events: none; padding: 4px 8px; border-radius: 4px; font-size: 12.5px;
  white-space: pre;
  background: var(--ink); color: var(--paper); font-variant-numeric: tabular-nums; }
@media print { body { max-width: none; padding: 0; } figure, tr, .pictures { break-inside: avoid; }
  h2, h3, summary { break-after: avoid; }
  details::details-content { content-visibility: visible; block-size: auto; } }
@media (max-width: 560px) { body { padding: 24px 14px 40px; } }
)css";

// Shows the curves' values at the pointer, converted from pixels by the axis ranges in the chart's data attributes.
// Unfolds sections for printing in browsers that do not know ::details-content.
constexpr const char* kScript = R"js(
(function () {
  var folded = [];
  window.addEventListener("beforeprint", function () {
    folded = Array.from(document.querySelectorAll("details:not([open])"));
    folded.forEach(function (section) { section.open = true; });
  });
  window.addEventListener("afterprint", function () { folded.forEach(function (section) { section.open = false; }); });
  var box = document.createElement("div");
  box.className = "hover"; box.hidden = true; document.body.appendChild(box);
  function show(v) {
    return Math.abs(v) >= 1000 ? Math.round(v).toLocaleString("en") : String(Number(v.toPrecision(3)));
  }
  document.querySelectorAll("svg[data-x]").forEach(function (svg) {
    var x = svg.dataset.x.split(" ").map(Number), y = svg.dataset.y.split(" ");
    var isLog = y[4] === "log"; y = y.slice(0, 4).map(Number);
    function value(py) {
      var share = (py - y[2]) / (y[3] - y[2]);
      return isLog ? y[0] * Math.pow(y[1] / y[0], share) : y[0] + share * (y[1] - y[0]);
    }
    var curves = Array.from(svg.querySelectorAll("polyline")).map(function (line) {
      return { name: line.dataset.name, points: line.getAttribute("points").split(" ").map(function (p) {
        return p.split(",").map(Number); }) };
    });
    svg.addEventListener("mouseleave", function () { box.hidden = true; });
    svg.addEventListener("mousemove", function (event) {
      var frame = svg.getBoundingClientRect();
      var px = (event.clientX - frame.left) * svg.viewBox.baseVal.width / frame.width, at = px;
      var lines = curves.map(function (curve) {
        var near = curve.points.reduce(function (a, b) { return Math.abs(b[0] - px) > Math.abs(a[0] - px) ? a : b; });
        at = near[0];
        return show(value(near[1])) + "  " + curve.name;
      });
      if (!lines.length) { return; }
      lines.unshift("iteration " + Math.round(x[0] + (at - x[2]) / (x[3] - x[2]) * (x[1] - x[0])).toLocaleString("en"));
      box.textContent = lines.join("\n"); box.hidden = false;
      box.style.left = Math.min(event.clientX + 14, window.innerWidth - box.offsetWidth - 8) + "px";
      box.style.top = event.clientY + 14 + "px";
    });
  });
})();
)js";

std::string base64(const std::vector<std::uint8_t>& bytes) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t left = bytes.size() - i;
    const std::uint32_t b = left > 1 ? bytes[i + 1] : 0, c = left > 2 ? bytes[i + 2] : 0;
    const std::uint32_t triple = std::uint32_t{bytes[i]} << 16 | b << 8 | c;
    text += kDigits[triple >> 18];
    text += kDigits[triple >> 12 & 63];
    text += left > 1 ? kDigits[triple >> 6 & 63] : '=';
    text += left > 2 ? kDigits[triple & 63] : '=';
  }
  return text;
}

std::string row_html(const char* cell, const Row& row, bool is_marked) {
  std::string html = is_marked ? "<tr class=\"marked\">" : "<tr>";
  for (const std::string& text : row) html += std::string("<") + cell + ">" + escape(text) + "</" + cell + ">";
  return html + "</tr>\n";
}

}  // namespace

std::string page(const std::string& title, const std::string& headline, const std::string& body) {
  return "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n"
         "<link rel=\"icon\" href=\"data:,\"/>\n<title>" +
         escape(title) + "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n<h1>" + escape(headline) +
         "</h1>\n" + body + "<script>" + kScript + "</script>\n</body>\n</html>\n";
}

std::string paragraph(const std::string& text, const std::string& css_class) {
  return (css_class.empty() ? "<p>" : "<p class=\"" + css_class + "\">") + escape(text) + "</p>\n";
}

std::string section(const std::string& heading, const std::string& body_html) {
  return "<section>\n<h2>" + escape(heading) + "</h2>\n" + body_html + "</section>\n";
}

std::string folded_section(const std::string& heading, const std::string& body_html) {
  return "<details>\n<summary>" + escape(heading) + "</summary>\n" + body_html + "</details>\n";
}

std::string subsection(const std::string& heading, const std::string& body_html) {
  return "<h3>" + escape(heading) + "</h3>\n" + body_html;
}

std::string figure(const std::string& content_html, const std::string& caption) {
  return "<figure>\n" + content_html + "<figcaption>" + escape(caption) + "</figcaption>\n</figure>\n";
}

std::string table(const Row& head, const std::vector<Row>& rows, Columns columns, int marked) {
  std::string html = "<div class=\"scroll\"><table class=\"";
  html += columns == Columns::kWords ? "words\">\n" : "figures\">\n";
  if (!head.empty()) html += "<thead>" + row_html("th", head, false) + "</thead>\n";
  html += "<tbody>\n";
  for (std::size_t i = 0; i < rows.size(); ++i) html += row_html("td", rows[i], static_cast<int>(i) == marked);
  return html + "</tbody></table></div>\n";
}

std::string picture_grid(const std::vector<Picture>& pictures, std::size_t columns) {
  std::string html =
      "<div class=\"pictures\" style=\"grid-template-columns: repeat(" + std::to_string(columns) + ", 1fr)\">\n";
  for (const Picture& picture : pictures) {
    html += "<div><img alt=\"" + escape(picture.alt) + "\" src=\"" + picture.data_uri + "\"/>" +
            escape(picture.caption) + "</div>\n";
  }
  return html + "</div>\n";
}

std::string data_uri(const Image8& rgb) {
  constexpr int kQuality = 82;
  const cv::Mat from(rgb.height, rgb.width, CV_8UC3, const_cast<std::uint8_t*>(rgb.pixels.data()));
  cv::Mat bgr;
  cv::cvtColor(from, bgr, cv::COLOR_RGB2BGR);
  std::vector<std::uint8_t> bytes;
  if (!cv::imencode(".jpg", bgr, bytes, {cv::IMWRITE_JPEG_QUALITY, kQuality})) {
    io_error("cannot encode an image of ", rgb.width, " x ", rgb.height, " px as JPEG for report.html");
  }
  return "data:image/jpeg;base64," + base64(bytes);
}

}  // namespace b3dgs::html
