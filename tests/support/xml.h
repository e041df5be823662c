// Checks XML with expat.
#pragma once

#include <expat.h>

#include <string>

namespace b3dgs::test {

/// Empty if `text` is well-formed XML, else the line and the reason. The document type may be HTML.
inline std::string xml_fault(const std::string& text) {
  const XML_Parser parser = XML_ParserCreate("UTF-8");
  std::string fault;
  if (XML_Parse(parser, text.data(), static_cast<int>(text.size()), /*isFinal=*/1) != XML_STATUS_OK) {
    const auto line = XML_GetCurrentLineNumber(parser);
    fault = "line " + std::to_string(line) + ": " + XML_ErrorString(XML_GetErrorCode(parser));
  }
  XML_ParserFree(parser);
  return fault;
}

}  // namespace b3dgs::test
