#include "model/photographs.h"

#include <zlib.h>

#include <fstream>
#include <system_error>

namespace b3dgs {

using Json = nlohmann::ordered_json;

Json photograph_fingerprint(const std::string& path) {
  constexpr std::size_t kRead = std::size_t{64} << 10;
  std::ifstream file(path, std::ios::binary);
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(path, error);
  if (path.empty() || !file || error) return nullptr;
  std::string start(kRead, '\0');
  file.read(start.data(), static_cast<std::streamsize>(start.size()));
  const auto n = static_cast<std::size_t>(file.gcount());
  return {{"bytes", bytes}, {"crc32", ::crc32_z(0, reinterpret_cast<const Bytef*>(start.data()), n)}};
}

Json photograph_fingerprints(const Scene& scene) {
  Json fingerprints = Json::object();
  for (const std::vector<View>* views : {&scene.train, &scene.test}) {
    for (const View& view : *views) fingerprints[view.name] = photograph_fingerprint(view.file);
  }
  return fingerprints;
}

std::vector<std::string> changed_views(const std::filesystem::path& file, const std::vector<View>& views) {
  std::ifstream text(file);
  const Json saved = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  std::vector<std::string> names;
  if (!saved.is_object()) return names;
  for (const View& view : views) {
    const Json before = saved.value(view.name, Json());
    if (!before.is_null() && before != photograph_fingerprint(view.file)) names.push_back(view.name);
  }
  return names;
}

}  // namespace b3dgs
