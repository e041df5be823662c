// A gzip stream that is a whole file. Its content is decompressed and compressed piece by piece, so that memory does
// not depend on what the content claims to be.
#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include "core/files/atomic_file.h"
#include "core/files/file_reader.h"

struct z_stream_s;  // zlib.h

namespace b3dgs {

class GzipReader {
 public:
  /// Reads the compressed bytes of the rest of `file`.
  explicit GzipReader(FileReader& file);
  ~GzipReader();
  GzipReader(const GzipReader&) = delete;
  GzipReader& operator=(const GzipReader&) = delete;

  const std::string& compressed() const { return compressed_; }

  /// The next `bytes` of the content. @throws InputError if the stream is damaged or ends before
  void read_bytes(void* to, std::size_t bytes);

  /// Reads the rest. @throws InputError if that is more than `most_unread` bytes of content, other bytes follow, or the
  /// checksum is wrong
  void expect_end(std::size_t most_unread = 0);

 private:
  /// Returns how many bytes there were, less than `bytes` only at the end of the stream.
  std::size_t read_some(void* to, std::size_t bytes);

  std::string name_, compressed_;
  std::size_t n_taken_ = 0;  // bytes of compressed_ that zlib has been given
  std::unique_ptr<z_stream_s> stream_;
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
};

}  // namespace b3dgs
