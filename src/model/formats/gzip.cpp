#include "model/formats/gzip.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <new>
#include <vector>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr int kGzipWindow = 15 + 16;  // zlib's way to ask for a gzip header and checksum

}  // namespace

GzipReader::GzipReader(FileReader& file)
    : name_(file.name()), compressed_(file.remaining(), '\0'), stream_(std::make_unique<z_stream_s>()) {
  file.read_bytes(compressed_.data(), compressed_.size());
  B3DGS_CHECK(inflateInit2(stream_.get(), kGzipWindow) == Z_OK, "zlib cannot start");
}

GzipReader::~GzipReader() {
  inflateEnd(stream_.get());
}

std::size_t GzipReader::read_some(void* to, std::size_t bytes) {
  constexpr std::size_t kMostAtOnce = 1 << 30;  // zlib's counters have 32 bits
  std::size_t n = 0;
  while (n < bytes && !has_ended_) {
    if (stream_->avail_in == 0) {
      const std::size_t more = std::min(kMostAtOnce, compressed_.size() - n_taken_);
      if (more == 0) {
        input_error(name_, ": the compressed data end early; the file is truncated: copy or export it again");
      }
      stream_->next_in = reinterpret_cast<unsigned char*>(compressed_.data() + n_taken_);
      stream_->avail_in = static_cast<uInt>(more);
      n_taken_ += more;
    }
    const std::size_t wanted = std::min(kMostAtOnce, bytes - n);
    stream_->next_out = static_cast<unsigned char*>(to) + n;
    stream_->avail_out = static_cast<uInt>(wanted);
    const int result = inflate(stream_.get(), Z_NO_FLUSH);
    n += wanted - stream_->avail_out;
    has_ended_ = result == Z_STREAM_END;
    if (result == Z_MEM_ERROR) throw std::bad_alloc();
    if (!has_ended_ && result != Z_OK && result != Z_BUF_ERROR) {
      input_error(name_, ": the compressed data are damaged (",
                  stream_->msg != nullptr ? stream_->msg : "unknown reason", "); copy or export the file again");
    }
  }
  return n;
}

void GzipReader::read_bytes(void* to, std::size_t bytes) {
  const std::size_t n = read_some(to, bytes);
  if (n == bytes) return;
  input_error(name_, ": the compressed content ends ", bytes - n,
              " or more bytes early; the file is damaged: export it again");
}

void GzipReader::expect_end(std::size_t most_unread) {
  std::vector<unsigned char> unread(most_unread + 1);
  if (read_some(unread.data(), unread.size()) > most_unread) {
    input_error(name_,
                ": expected the end of the compressed content, found more; the file is damaged or of a "
                "later version");
  }
  if (stream_->avail_in > 0 || n_taken_ < compressed_.size()) {
    input_error(name_, ": expected the end of the file after the compressed data, found more bytes");
  }
}

GzipWriter::GzipWriter(AtomicFile& file) : file_(file), stream_(std::make_unique<z_stream_s>()) {
  constexpr int kMemoryLevel = 8;  // zlib's default
  B3DGS_CHECK(deflateInit2(stream_.get(), Z_DEFAULT_COMPRESSION, Z_DEFLATED, kGzipWindow, kMemoryLevel,
                           Z_DEFAULT_STRATEGY) == Z_OK,
              "zlib cannot start");
}

GzipWriter::~GzipWriter() {
  deflateEnd(stream_.get());
}

void GzipWriter::write(const void* data, std::size_t bytes, bool is_last) {
  std::array<unsigned char, 1 << 16> compressed;
  stream_->next_in = const_cast<unsigned char*>(static_cast<const unsigned char*>(data));  // zlib does not write to it
  stream_->avail_in = static_cast<uInt>(bytes);
  int result = Z_OK;
  do {
    stream_->next_out = compressed.data();
    stream_->avail_out = static_cast<uInt>(compressed.size());
    result = deflate(stream_.get(), is_last ? Z_FINISH : Z_NO_FLUSH);
    B3DGS_CHECK(result != Z_STREAM_ERROR, "zlib: inconsistent state");
    file_.write(compressed.data(), compressed.size() - stream_->avail_out);
  } while (stream_->avail_out == 0 || (is_last && result != Z_STREAM_END));
}

}  // namespace b3dgs
