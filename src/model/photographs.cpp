#include "model/photographs.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <string_view>
#include <system_error>

#include "core/text.h"

namespace b3dgs {

using Json = nlohmann::ordered_json;

namespace {

constexpr std::size_t kPiece = std::size_t{64} << 10;

/// Whether a change of a pixel changes the size of the file or its end: PNG ends with a checksum of its pixels.
bool is_compressed(const std::filesystem::path& path) {
  const std::string extension = lower_case(path.extension().string());
  constexpr std::array<std::string_view, 4> kCompressed{".jpg", ".jpeg", ".png", ".webp"};
  return std::find(kCompressed.begin(), kCompressed.end(), extension) != kCompressed.end();
}

}  // namespace

Json photograph_fingerprint(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(path, error);
  if (path.empty() || !file || error) return nullptr;
  std::string piece(kPiece, '\0');
  const auto add_piece = [&](uLong crc) {
    file.read(piece.data(), static_cast<std::streamsize>(piece.size()));
    return ::crc32_z(crc, reinterpret_cast<const Bytef*>(piece.data()), static_cast<std::size_t>(file.gcount()));
  };
  const uLong start = add_piece(0);
  uLong rest = 0;
  if (bytes > 2 * kPiece && is_compressed(path)) file.seekg(static_cast<std::streamoff>(bytes - kPiece));
  while (file) rest = add_piece(rest);
  return {{"bytes", bytes}, {"crc32", start}, {"rest_crc32", rest}};
}

bool is_same_photograph(const Json& before, const Json& now) {
  if (!before.is_object() || !now.is_object()) return before == now;
  return before.value("bytes", Json()) == now.value("bytes", Json()) &&
         before.value("crc32", Json()) == now.value("crc32", Json()) &&
         (!before.contains("rest_crc32") || before.at("rest_crc32") == now.value("rest_crc32", Json()));
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
    if (!before.is_null() && !is_same_photograph(before, photograph_fingerprint(view.file))) {
      names.push_back(view.name);
    }
  }
  return names;
}

}  // namespace b3dgs
