#include "core/options/config_file.h"

#include <algorithm>
#include <fstream>
#include <iterator>

#include "core/json_text.h"

namespace b3dgs {

nlohmann::ordered_json read_json_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  file.peek();  // fails for a folder, which can be opened
  if (file.bad() || !file.is_open())
    input_error("cannot open config file: ", path, " (expected a JSON file with option names as keys)");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  nlohmann::ordered_json json = parse_json(text, /*ignore_comments=*/true);
  if (!json.is_discarded()) return json;
  try {
    json = nlohmann::ordered_json::parse(text, nullptr, true, /*ignore_comments=*/true);  // for its error message
  } catch (const nlohmann::json::exception& error) {
    std::string reason = error.what();
    std::replace(reason.begin(), reason.end(), '\n', ' ');
    reason.erase(0, reason.rfind("[json.exception", 0) == 0 ? reason.find("] ") + 2 : 0);  // the library's number
    input_error("not valid JSON: ", path, " (expected option names as keys; ", reason, ")");
  }
  input_error("JSON nested too deeply: ", path, " (at most ", kMaxJsonDepth, " levels)");
}

}  // namespace b3dgs
