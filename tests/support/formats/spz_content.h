// Makes SPZ files byte by byte, independent of the writer.
#pragma once

#include <zlib.h>
#include <zstd.h>

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

#include "core/check.h"

namespace b3dgs::test {

inline std::string spz_header(std::uint8_t version, std::uint32_t count, std::uint8_t sh_degree,
                              std::uint8_t fractional_bits = 12, std::uint8_t flags = 0) {
  std::string bytes = "NGSP";
  bytes += {static_cast<char>(version), 0, 0, 0};
  for (int i = 0; i < 4; ++i) bytes += static_cast<char>(count >> (8 * i));
  bytes += {static_cast<char>(sh_degree), static_cast<char>(fractional_bits), static_cast<char>(flags), 0};
  return bytes;
}

/// Returns the content before compression. All bytes after the header are 0x21.
inline std::string spz_content(std::uint8_t version, std::uint32_t count, std::uint8_t sh_degree) {
  const std::size_t n_sh = static_cast<std::size_t>(sh_degree + 1) * (sh_degree + 1u) - 1;
  const std::size_t bytes_each = (version == 1 ? 6 : 9) + 7 + (version < 3 ? 3 : 4) + 3 * n_sh;
  return spz_header(version, count, sh_degree) + std::string(count * bytes_each, '\x21');
}

inline std::string gzip(std::string_view bytes) {
  z_stream stream{};
  B3DGS_CHECK(deflateInit2(&stream, 6, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY) == Z_OK, "zlib cannot start");
  std::string result(deflateBound(&stream, bytes.size()), '\0');
  stream.next_in = reinterpret_cast<unsigned char*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<unsigned char*>(result.data());
  stream.avail_out = static_cast<uInt>(result.size());
  B3DGS_CHECK(deflate(&stream, Z_FINISH) == Z_STREAM_END, "zlib has not finished");
  result.resize(stream.total_out);
  deflateEnd(&stream);
  return result;
}

/// Returns a file of version 4 with the arrays of `content`, which is that of a file of version 3.
inline std::string spz4_file(std::string_view content, std::string_view extensions = {}) {
  const auto degree = static_cast<unsigned>(content[12]);
  std::uint32_t count = 0;
  std::memcpy(&count, content.data() + 8, sizeof count);
  const auto little_endian = [](std::uint64_t value, int bytes) {
    std::string text;
    for (int i = 0; i < bytes; ++i) text += static_cast<char>(value >> (8 * i));
    return text;
  };
  std::string table, streams;
  std::size_t at = 16;
  for (const std::size_t each : {9u, 1u, 3u, 3u, 4u, 3 * ((degree + 1) * (degree + 1) - 1)}) {
    const std::size_t size = each * count;
    if (each == 0) continue;  // as other programs do without SH
    std::string stream(ZSTD_compressBound(size), '\0');
    stream.resize(ZSTD_compress(stream.data(), stream.size(), content.data() + at, size, 1));
    table += little_endian(stream.size(), 8) + little_endian(size, 8);
    streams += stream;
    at += size;
  }
  std::string file(content.substr(0, 16));
  file[4] = 4;
  file[15] = static_cast<char>(table.size() / 16);
  if (!extensions.empty()) file[14] = static_cast<char>(file[14] | 2);
  file += little_endian(32 + extensions.size(), 4) + std::string(12, '\0');
  return file.append(extensions) + table + streams;
}

}  // namespace b3dgs::test
