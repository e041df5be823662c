// The data in a report.html.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

namespace b3dgs::test {

inline nlohmann::ordered_json data_of_page(const std::string& page) {
  const std::string begin = "<script type=\"application/json\" id=\"data\">";
  const std::size_t from = page.find(begin) + begin.size();
  return nlohmann::ordered_json::parse(page.substr(from, page.find("</script>", from) - from));
}

}  // namespace b3dgs::test
