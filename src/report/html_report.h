// The page of a report: one file that needs no network, in light, dark and on paper, readable without its script.
#pragma once

#include <string>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs::html {

/// A whole document; `headline` is its first line, `body` is HTML.
std::string page(const std::string& title, const std::string& headline, const std::string& body);

/// Everything below takes plain text and escapes it, unless it says HTML.
std::string paragraph(const std::string& text, const std::string& css_class = "");
std::string section(const std::string& heading, const std::string& body_html);
/// A part of a section.
std::string subsection(const std::string& heading, const std::string& body_html);
std::string figure(const std::string& content_html, const std::string& caption);

using Row = std::vector<std::string>;
/// What stands in the columns after the first one: figures are aligned at the right, words at the left.
enum class Columns { kFigures, kWords };
/// `head` may be empty; `marked` is a row to be set apart, -1 for none.
std::string table(const Row& head, const std::vector<Row>& rows, Columns columns = Columns::kFigures, int marked = -1);

/// Pictures in a grid, `columns` wide, each with its caption.
struct Picture {
  std::string caption, alt, data_uri;
};
std::string picture_grid(const std::vector<Picture>& pictures, std::size_t columns);

/// A JPEG within the page. @throws IoError if it cannot be encoded
std::string data_uri(const Image8& rgb);

}  // namespace b3dgs::html
