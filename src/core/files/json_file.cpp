#include "core/files/json_file.h"

#include "core/files/file_reader.h"
#include "core/files/own_files.h"
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

std::filesystem::path file_in(const std::filesystem::path& folder, const std::string& name, const std::string& place) {
  const std::filesystem::path file = folder / name;
  const bool is_plain =
      !name.empty() && name != "." && name != ".." && file.filename() == name && name.find('\0') == std::string::npos;
  if (!is_plain || real_path(file) != real_path(folder) / name) {
    input_error(place, ": expected the name of a file in ", folder.string(), ", found ", json_excerpt(name),
                is_plain ? ", which is a link" : "", "; put a copy of the file there, and its name here");
  }
  return file;
}

}  // namespace b3dgs
