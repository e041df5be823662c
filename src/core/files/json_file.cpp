#include "core/files/json_file.h"

#include "core/files/file_reader.h"
#include "core/json_text.h"

namespace b3dgs {

nlohmann::ordered_json read_json(const std::filesystem::path& path, bool ignore_comments) {
  const std::optional<std::string> text = read_file_if_there(path);
  if (!text) return nullptr;
  std::string repeated_key;
  nlohmann::ordered_json json = parse_json(*text, ignore_comments, &repeated_key);
  if (!repeated_key.empty()) {
    input_error(path.string(), ": expected each key once, found ", repeated_key, " twice in one object; remove one");
  }
  return json;
}

}  // namespace b3dgs
