// A gzip stream inside a file: decompressed and compressed piece by piece, so that memory does not depend on its size.
#pragma once

#include <cstddef>
#include <memory>
#include <string_view>
#include <vector>

#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"

struct z_stream_s;  // zlib.h

namespace b3dgs {

class GzipReader {
 public:
  /// Decompresses the rest of `file`, which has to outlive the reader.
  explicit GzipReader(FileReader& file);
  ~GzipReader();
  GzipReader(const GzipReader&) = delete;
  GzipReader& operator=(const GzipReader&) = delete;

  /// Whether the stream's compressed bytes begin with `start`, of at most 16 bytes.
  bool starts_with(std::string_view start);

  /// The next `bytes` of the content. @throws InputError if the stream is damaged or ends before
  void read_bytes(void* to, std::size_t bytes);

  /// Reads the rest. @throws InputError if that is more than `most_unread` bytes of content, bytes of the file follow,
  /// or the checksum is wrong
  void expect_end(std::size_t most_unread = 0);

 private:
  /// 1 to `bytes` bytes, or 0 at the end of the stream.
  std::size_t read_some(void* to, std::size_t bytes);
  /// Loads the next compressed bytes; false at the end of the file.
  bool fill();

  FileReader& file_;
  std::unique_ptr<z_stream_s> stream_;
  std::vector<unsigned char> compressed_;
  bool has_ended_ = false;
};

class GzipWriter {
 public:
  /// Appends a gzip stream to `file`, which has to outlive the writer.
  explicit GzipWriter(AtomicFile& file);
  ~GzipWriter();
  GzipWriter(const GzipWriter&) = delete;
  GzipWriter& operator=(const GzipWriter&) = delete;

  /// At most 4 GiB. `is_last`: ends the stream. @throws IoError
  void write(const void* data, std::size_t bytes, bool is_last = false);

 private:
  AtomicFile& file_;
  std::unique_ptr<z_stream_s> stream_;
  std::vector<unsigned char> compressed_;
};

}  // namespace b3dgs
