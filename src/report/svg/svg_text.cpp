#include "report/svg/svg_text.h"

#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

namespace b3dgs {

std::string escape(const std::string& text) {
  using nlohmann::json;
  // The JSON writer replaces invalid UTF-8 by U+FFFD.
  const std::string valid =
      json::parse(json(text).dump(-1, ' ', false, json::error_handler_t::replace)).get<std::string>();
  std::string escaped;
  for (const char c : valid) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      case '\'':
        escaped += "&#39;";
        break;
      default:
        escaped += static_cast<unsigned char>(c) < 0x20 || c == 0x7f ? ' ' : c;
    }
  }
  return escaped;
}

namespace svg {

std::string px(double value) {
  if (!std::isfinite(value)) value = 0;
  char text[32];
  std::snprintf(text, sizeof text, "%.1f", value);
  std::string short_text = text;
  if (short_text.size() > 2 && short_text.compare(short_text.size() - 2, 2, ".0") == 0) {
    short_text.resize(short_text.size() - 2);
  }
  return short_text == "-0" ? "0" : short_text;
}

double text_width(const std::string& text) {
  constexpr double kPxPerCharacter = 7;  // average for a 12 px sans serif font
  double characters = 0;
  for (const char c : text)
    characters += (static_cast<unsigned char>(c) & 0xC0) != 0x80;  // skips UTF-8 continuation bytes
  return kPxPerCharacter * characters;
}

std::string text(double x, double y, const std::string& attributes, const std::string& content) {
  return "<text x=\"" + px(x) + "\" y=\"" + px(y) + "\" " + attributes + ">" + escape(content) + "</text>\n";
}

std::string line(double x1, double y1, double x2, double y2, const std::string& attributes) {
  return "<line x1=\"" + px(x1) + "\" y1=\"" + px(y1) + "\" x2=\"" + px(x2) + "\" y2=\"" + px(y2) + "\" " + attributes +
         "/>\n";
}

std::string rect(double x, double y, double width, double height, const std::string& attributes,
                 const std::string& tooltip) {
  return "<rect x=\"" + px(x) + "\" y=\"" + px(y) + "\" width=\"" + px(width) + "\" height=\"" + px(height) + "\" " +
         attributes + "><title>" + escape(tooltip) + "</title></rect>\n";
}

std::string color_class(const char* kind, int color) {
  constexpr int kColors = 10;
  return std::string("class=\"") + kind + std::to_string(color % kColors) + "\"";
}

std::string picture(int width, int height, const std::string& title, const std::string& attributes,
                    const std::string& body) {
  return "<svg class=\"chart\" role=\"img\" aria-label=\"" + escape(title) + "\" viewBox=\"0 0 " +
         std::to_string(width) + " " + std::to_string(height) + "\" " + attributes + ">\n" + body + "</svg>\n";
}

std::string legend(const std::vector<LegendEntry>& entries, double x, double right, double& y) {
  constexpr double kRow = 18, kSwatch = 11, kGap = 18;
  std::string body;
  double at = x;
  y += kRow - 6;
  for (const LegendEntry& entry : entries) {
    const double width = kSwatch + 5 + text_width(entry.name);
    if (at > x && at + width > right) {
      at = x;
      y += kRow;
    }
    body += rect(at, y - 9, kSwatch, kSwatch,
                 color_class("f", entry.color) + " fill-opacity=\"" + px(entry.opacity) + "\"", entry.name);
    body += text(at + kSwatch + 5, y, "class=\"label\"", entry.name);
    at += width + kGap;
  }
  y += 10;
  return body;
}

}  // namespace svg
}  // namespace b3dgs
