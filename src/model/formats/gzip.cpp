#include "model/formats/gzip.h"

#include <zlib.h>

#include <algorithm>
#include <cstring>
#include <new>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr std::size_t kBlockBytes = 1 << 16;
constexpr int kGzipWindow = 15 + 16;  // zlib's way to ask for a gzip header and checksum

}  // namespace

GzipReader::GzipReader(FileReader& file)
    : file_(file), stream_(std::make_unique<z_stream_s>()), compressed_(kBlockBytes) {
  B3DGS_CHECK(inflateInit2(stream_.get(), kGzipWindow) == Z_OK, "zlib cannot start");
}

GzipReader::~GzipReader() {
  inflateEnd(stream_.get());
}

bool GzipReader::fill() {
  const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(kBlockBytes, file_.remaining()));
  file_.read_bytes(compressed_.data(), n);
  stream_->next_in = compressed_.data();
  stream_->avail_in = static_cast<uInt>(n);
  return n > 0;
}

bool GzipReader::starts_with(std::string_view start) {
  if (stream_->avail_in == 0) fill();
  return stream_->avail_in >= start.size() && std::memcmp(stream_->next_in, start.data(), start.size()) == 0;
}

std::size_t GzipReader::read_some(void* to, std::size_t bytes) {
  const std::size_t wanted = std::min(bytes, kBlockBytes);
  stream_->next_out = static_cast<unsigned char*>(to);
  stream_->avail_out = static_cast<uInt>(wanted);
  while (!has_ended_ && stream_->avail_out == wanted) {
    if (stream_->avail_in == 0 && !fill()) {
      input_error(file_.name(), ": the compressed data end early; the file is truncated: copy or export it again");
    }
    const int result = inflate(stream_.get(), Z_NO_FLUSH);
    has_ended_ = result == Z_STREAM_END;
    if (result == Z_MEM_ERROR) throw std::bad_alloc();
    if (!has_ended_ && result != Z_OK && result != Z_BUF_ERROR) {
      input_error(file_.name(), ": the compressed data are damaged (",
                  stream_->msg != nullptr ? stream_->msg : "unknown reason", "); copy or export the file again");
    }
  }
  return wanted - stream_->avail_out;
}

void GzipReader::read_bytes(void* to, std::size_t bytes) {
  auto* next = static_cast<unsigned char*>(to);
  while (bytes > 0) {
    const std::size_t n = read_some(next, bytes);
    if (n == 0) {
      input_error(file_.name(), ": the compressed content ends ", bytes,
                  " or more bytes early; the file is damaged: export it again");
    }
    next += n;
    bytes -= n;
  }
}

void GzipReader::expect_end(std::size_t most_unread) {
  std::vector<unsigned char> unread(most_unread + 1);
  std::size_t n_unread = 0;
  for (std::size_t n = 1; n > 0 && n_unread < unread.size(); n_unread += n) {
    n = read_some(unread.data() + n_unread, unread.size() - n_unread);
  }
  if (n_unread > most_unread) {
    input_error(file_.name(),
                ": expected the end of the compressed content, found more; the file is damaged or of a "
                "later version");
  }
  if (stream_->avail_in > 0) {
    input_error(file_.name(), ": expected the end of the file after the compressed data, found more bytes");
  }
  file_.expect_end();
}

GzipWriter::GzipWriter(AtomicFile& file)
    : file_(file), stream_(std::make_unique<z_stream_s>()), compressed_(kBlockBytes) {
  constexpr int kMemoryLevel = 8;  // zlib's default
  B3DGS_CHECK(deflateInit2(stream_.get(), Z_DEFAULT_COMPRESSION, Z_DEFLATED, kGzipWindow, kMemoryLevel,
                           Z_DEFAULT_STRATEGY) == Z_OK,
              "zlib cannot start");
}

GzipWriter::~GzipWriter() {
  deflateEnd(stream_.get());
}

void GzipWriter::write(const void* data, std::size_t bytes, bool is_last) {
  stream_->next_in = const_cast<unsigned char*>(static_cast<const unsigned char*>(data));  // zlib does not write to it
  stream_->avail_in = static_cast<uInt>(bytes);
  int result = Z_OK;
  do {
    stream_->next_out = compressed_.data();
    stream_->avail_out = static_cast<uInt>(kBlockBytes);
    result = deflate(stream_.get(), is_last ? Z_FINISH : Z_NO_FLUSH);
    B3DGS_CHECK(result != Z_STREAM_ERROR, "zlib: inconsistent state");
    file_.write(compressed_.data(), kBlockBytes - stream_->avail_out);
  } while (stream_->avail_out == 0 || (is_last && result != Z_STREAM_END));
}

}  // namespace b3dgs
