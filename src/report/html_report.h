// Building blocks of report.html: a single file without external resources, for screen (light and dark) and print, that
// is readable without its script.
#pragma once

#include <string>
#include <vector>

#include "scene/images/image.h"

namespace b3dgs::html {

/// The whole document. `headline` becomes its h1; `body` is HTML.
std::string page(const std::string& title, const std::string& headline, const std::string& body);

/// The functions below take plain text and escape it, except for parameters named *_html.
std::string paragraph(const std::string& text, const std::string& css_class = "");
std::string section(const std::string& heading, const std::string& body_html);
/// Closed on screen until its heading is clicked; printed in full.
std::string folded_section(const std::string& heading, const std::string& body_html);
std::string subsection(const std::string& heading, const std::string& body_html);
std::string figure(const std::string& content_html, const std::string& caption);

using Row = std::vector<std::string>;
/// Alignment of all columns but the first: figures to the right, words to the left.
enum class Columns { kFigures, kWords };
/// `head` may be empty; row number `marked` is highlighted, -1 for none.
std::string table(const Row& head, const std::vector<Row>& rows, Columns columns = Columns::kFigures, int marked = -1);

struct Picture {
  std::string caption, alt, data_uri;
};
/// A grid that is `columns` pictures wide.
std::string picture_grid(const std::vector<Picture>& pictures, std::size_t columns);

/// The image as JPEG in a data URI. @throws IoError if it cannot be encoded
std::string data_uri(const Image8& rgb);

}  // namespace b3dgs::html
