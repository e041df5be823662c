#include "scene/images/tiff.h"

#include <tiffio.h>

#include <algorithm>
#include <cstring>
#include <limits>
#include <memory>

namespace b3dgs {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr std::uint32_t kMaxSide = std::uint32_t{1} << 20;  // px

/// A file in memory, for libtiff's callbacks.
struct Memory {
  const Bytes& bytes;
  toff_t at = 0;
};

tmsize_t read_memory(thandle_t handle, void* to, tmsize_t count) {
  auto& memory = *static_cast<Memory*>(handle);
  const toff_t size = memory.bytes.size(), left = size - std::min(memory.at, size);
  const toff_t n = std::min(left, static_cast<toff_t>(std::max<tmsize_t>(count, 0)));
  if (n > 0) std::memcpy(to, memory.bytes.data() + memory.at, n);
  memory.at += n;
  return static_cast<tmsize_t>(n);
}

tmsize_t write_memory(thandle_t, void*, tmsize_t) {
  return 0;
}

toff_t seek_memory(thandle_t handle, toff_t offset, int origin) {
  auto& memory = *static_cast<Memory*>(handle);
  const toff_t start = origin == SEEK_CUR ? memory.at : origin == SEEK_END ? memory.bytes.size() : 0;
  return memory.at = start + offset;
}

int close_memory(thandle_t) {
  return 0;
}

toff_t size_of_memory(thandle_t handle) {
  return static_cast<Memory*>(handle)->bytes.size();
}

using Tiff = std::unique_ptr<TIFF, decltype(&TIFFClose)>;

Tiff open_tiff(Memory& memory) {
  static const bool is_quiet = [] {  // otherwise libtiff writes to stderr; results report errors
    TIFFSetWarningHandler(nullptr);
    TIFFSetErrorHandler(nullptr);
    return true;
  }();
  static_cast<void>(is_quiet);
  return {TIFFClientOpen("", "rm", &memory, read_memory, write_memory, seek_memory, close_memory, size_of_memory,
                         nullptr, nullptr),
          &TIFFClose};
}

struct Layout {
  ImageSize size;
  int bits = 0, n_samples = 0, n_colors = 0, alpha = 0;  // `alpha`: index of the sample
  bool is_premultiplied = false, is_separate = false, is_inverted = false;
  bool may_be_straight = false;  // even if `is_premultiplied`

  int type() const { return CV_MAKETYPE(bits == 8 ? CV_8U : CV_16U, n_samples); }
};

/// Returns nothing unless the samples are grey or RGB, with alpha.
std::optional<Layout> layout_of(TIFF* tiff) {
  std::uint32_t width = 0, height = 0;
  std::uint16_t bits = 0, n_samples = 0, format = 0, planes = 0, photometric = 0, n_extra = 0;
  std::uint16_t* extra = nullptr;
  if (TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width) == 0 || TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height) == 0 ||
      TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &photometric) == 0) {
    return std::nullopt;
  }
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &n_samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &format);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &planes);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_EXTRASAMPLES, &n_extra, &extra);
  const bool is_rgb = photometric == PHOTOMETRIC_RGB;
  const bool is_grey = photometric == PHOTOMETRIC_MINISBLACK || photometric == PHOTOMETRIC_MINISWHITE;
  Layout layout;
  layout.bits = bits;
  layout.n_samples = n_samples;
  layout.n_colors = is_rgb ? 3 : 1;
  layout.is_separate = planes == PLANARCONFIG_SEPARATE;
  layout.is_inverted = photometric == PHOTOMETRIC_MINISWHITE;
  constexpr int kMaxSamples = 8;
  if (!(is_rgb || is_grey) || !(bits == 8 || bits == 16) || format != SAMPLEFORMAT_UINT || n_extra == 0 ||
      n_samples != layout.n_colors + n_extra || n_samples > kMaxSamples || width < 1 || height < 1 ||
      width > kMaxSide || height > kMaxSide) {
    return std::nullopt;
  }
  layout.size = {static_cast<int>(width), static_cast<int>(height)};
  const std::uint16_t* const end = extra + n_extra;
  const std::uint16_t* alpha = std::find_if(extra, extra + n_extra, [](std::uint16_t kind) {
    return kind == EXTRASAMPLE_ASSOCALPHA || kind == EXTRASAMPLE_UNASSALPHA;
  });
  // Older programs write premultiplied alpha as unspecified. OpenCV writes straight alpha without its kind, which
  // libtiff also reports as unspecified.
  if (alpha == end && is_rgb) alpha = std::find(extra, extra + n_extra, EXTRASAMPLE_UNSPECIFIED);
  if (alpha == end) return std::nullopt;
  layout.alpha = layout.n_colors + static_cast<int>(alpha - extra);
  layout.is_premultiplied = *alpha != EXTRASAMPLE_UNASSALPHA;
  layout.may_be_straight = *alpha == EXTRASAMPLE_UNSPECIFIED;
  return layout;
}

/// Reads the samples into `image`, which has one channel for each. Returns false if the file is damaged.
bool read_samples(TIFF* tiff, const Layout& layout, cv::Mat& image) {
  const auto [width, height] = layout.size;
  const int n_planes = layout.is_separate ? layout.n_samples : 1, n_each = layout.is_separate ? 1 : layout.n_samples;
  const std::size_t sample_bytes = layout.bits / 8, pixel_bytes = n_each * sample_bytes;
  // Stores a part of a row of one plane, starting at column x.
  const auto store = [&](const std::uint8_t* from, int plane, int y, int x, int n) {
    std::uint8_t* to = image.ptr(y) + (static_cast<std::size_t>(x) * layout.n_samples + plane) * sample_bytes;
    for (int i = 0; i < n; ++i, from += pixel_bytes, to += layout.n_samples * sample_bytes) {
      std::memcpy(to, from, pixel_bytes);
    }
  };
  Bytes buffer;
  if (TIFFIsTiled(tiff) == 0) {
    const tmsize_t row_bytes = TIFFScanlineSize(tiff);
    if (row_bytes < static_cast<tmsize_t>(width * pixel_bytes)) return false;
    buffer.resize(static_cast<std::size_t>(row_bytes));
    for (int plane = 0; plane < n_planes; ++plane) {
      for (int y = 0; y < height; ++y) {
        if (TIFFReadScanline(tiff, buffer.data(), y, static_cast<std::uint16_t>(plane)) < 0) return false;
        store(buffer.data(), plane, y, 0, width);
      }
    }
    return true;
  }
  std::uint32_t tile_width = 0, tile_height = 0;
  TIFFGetField(tiff, TIFFTAG_TILEWIDTH, &tile_width);
  TIFFGetField(tiff, TIFFTAG_TILELENGTH, &tile_height);
  const tmsize_t row_bytes = TIFFTileRowSize(tiff), tile_bytes = TIFFTileSize(tiff);
  const bool is_plausible = tile_width > 0 && tile_height > 0 && tile_width <= kMaxSide && tile_height <= kMaxSide &&
                            row_bytes >= static_cast<tmsize_t>(tile_width * pixel_bytes) &&
                            tile_bytes >= row_bytes * static_cast<tmsize_t>(tile_height) &&
                            tile_bytes <= tmsize_t{kMaxSide} * 1024;
  if (!is_plausible) return false;
  buffer.resize(static_cast<std::size_t>(tile_bytes));
  for (int plane = 0; plane < n_planes; ++plane) {
    for (int top = 0; top < height; top += static_cast<int>(tile_height)) {
      for (int left = 0; left < width; left += static_cast<int>(tile_width)) {
        if (TIFFReadTile(tiff, buffer.data(), left, top, 0, static_cast<std::uint16_t>(plane)) < 0) return false;
        const int bottom = std::min(height, top + static_cast<int>(tile_height));
        const int n = std::min(width - left, static_cast<int>(tile_width));
        for (int y = top; y < bottom; ++y) store(buffer.data() + (y - top) * row_bytes, plane, y, left, n);
      }
    }
  }
  return true;
}

/// Returns whether a colour exceeds its alpha, which premultiplied colours never do.
template <class Value>
bool is_straight(const cv::Mat& samples, const Layout& layout) {
  for (int y = 0; y < samples.rows; ++y) {
    const Value* from = samples.ptr<Value>(y);
    for (int x = 0; x < samples.cols; ++x, from += layout.n_samples) {
      if (*std::max_element(from, from + layout.n_colors) > from[layout.alpha]) return true;
    }
  }
  return false;
}

template <class Value>
cv::Mat to_bgra(const cv::Mat& samples, Layout layout) {
  constexpr std::uint32_t kMax = std::numeric_limits<Value>::max();
  if (layout.may_be_straight && is_straight<Value>(samples, layout)) layout.is_premultiplied = false;
  cv::Mat image(samples.rows, samples.cols, CV_MAKETYPE(cv::DataType<Value>::depth, 4));
  for (int y = 0; y < image.rows; ++y) {
    const Value* from = samples.ptr<Value>(y);
    Value* to = image.ptr<Value>(y);
    for (int x = 0; x < image.cols; ++x, from += layout.n_samples, to += 4) {
      const std::uint32_t alpha = from[layout.alpha];
      for (int c = 0; c < 3; ++c) {
        std::uint32_t value = from[layout.n_colors == 3 ? 2 - c : 0];
        if (layout.is_inverted) value = kMax - value;
        if (layout.is_premultiplied) value = alpha == 0 ? 0 : std::min(kMax, (value * kMax + alpha / 2) / alpha);
        to[c] = static_cast<Value>(value);
      }
      to[3] = static_cast<Value>(alpha);
    }
  }
  return image;
}

}  // namespace

bool is_tiff(const Bytes& bytes) {
  constexpr std::uint8_t kClassic = 42, kBig = 43;
  if (bytes.size() < 8 || bytes[0] != bytes[1] || (bytes[0] != 'I' && bytes[0] != 'M')) return false;
  const std::uint8_t low = bytes[bytes[0] == 'I' ? 2 : 3], high = bytes[bytes[0] == 'I' ? 3 : 2];
  return high == 0 && (low == kClassic || low == kBig);
}

std::optional<TiffSize> tiff_size(const Bytes& bytes) {
  if (!is_tiff(bytes)) return std::nullopt;
  Memory memory{bytes};
  const Tiff tiff = open_tiff(memory);
  std::uint32_t width = 0, height = 0;
  if (!tiff || TIFFGetField(tiff.get(), TIFFTAG_IMAGEWIDTH, &width) == 0 ||
      TIFFGetField(tiff.get(), TIFFTAG_IMAGELENGTH, &height) == 0) {
    return std::nullopt;
  }
  std::uint32_t part_width = width, part_height = height;
  if (TIFFIsTiled(tiff.get()) != 0) {
    TIFFGetField(tiff.get(), TIFFTAG_TILEWIDTH, &part_width);
    TIFFGetField(tiff.get(), TIFFTAG_TILELENGTH, &part_height);
  } else {
    constexpr auto kAllRows = std::numeric_limits<std::uint32_t>::max();
    TIFFGetFieldDefaulted(tiff.get(), TIFFTAG_ROWSPERSTRIP, &part_height);
    if (part_height == kAllRows) part_height = height;
  }
  constexpr std::uint32_t kMost = std::numeric_limits<int>::max();
  if (std::max({width, height, part_width, part_height}) > kMost) return std::nullopt;
  return TiffSize{{static_cast<int>(width), static_cast<int>(height)},
                  {static_cast<int>(part_width), static_cast<int>(part_height)}};
}

std::optional<cv::Mat> decode_tiff_with_alpha(const Bytes& bytes) {
  if (!is_tiff(bytes)) return std::nullopt;
  Memory memory{bytes};
  const Tiff tiff = open_tiff(memory);
  if (!tiff) return std::nullopt;
  const std::optional<Layout> layout = layout_of(tiff.get());
  if (!layout) return std::nullopt;
  cv::Mat samples(layout->size.height, layout->size.width, layout->type());
  if (!read_samples(tiff.get(), *layout, samples)) return cv::Mat();
  return layout->bits == 8 ? to_bgra<std::uint8_t>(samples, *layout) : to_bgra<std::uint16_t>(samples, *layout);
}

}  // namespace b3dgs
