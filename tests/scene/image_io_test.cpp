#include "scene/images/image.h"

#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <random>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/formats/tiff_bytes.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;
using test::tiff_of;
using test::TiffOptions;
using test::write_bytes;

Image8 noise(int width, int height, int channels) {
  Image8 image(width, height, channels);
  std::mt19937 random(5);
  for (std::uint8_t& value : image.pixels) value = static_cast<std::uint8_t>(random() % 256);
  return image;
}

std::string big_endian(std::uint32_t value) {
  return {static_cast<char>(value >> 24), static_cast<char>(value >> 16), static_cast<char>(value >> 8),
          static_cast<char>(value)};
}

// Returns a PNG chunk with its checksum (CRC-32, bit by bit).
std::string png_chunk(const std::string& type, const std::string& data) {
  std::uint32_t crc = 0xffffffffu;
  for (const char c : type + data) {
    crc ^= static_cast<std::uint8_t>(c);
    for (int bit = 0; bit < 8; ++bit) crc = crc & 1 ? crc >> 1 ^ 0xedb88320u : crc >> 1;
  }
  return big_endian(static_cast<std::uint32_t>(data.size())) + type + data + big_endian(~crc);
}

// Returns an uncompressed PNG of one row with the given colour type and bytes.
std::string one_row_png(int width, int bits, int color_type, const std::string& row) {
  const std::string raw = std::string(1, '\0') + row;  // filter 0
  std::uint32_t a = 1, b = 0;
  for (const char c : raw) {
    a = (a + static_cast<std::uint8_t>(c)) % 65521;
    b = (b + a) % 65521;
  }
  const auto length = static_cast<std::uint16_t>(raw.size());
  const std::string deflated = std::string("\x78\x01\x01", 3) + static_cast<char>(length & 255) +
                               static_cast<char>(length >> 8) + static_cast<char>(~length & 255) +
                               static_cast<char>(static_cast<std::uint16_t>(~length) >> 8) + raw +
                               big_endian(b << 16 | a);
  const std::string header = big_endian(static_cast<std::uint32_t>(width)) + big_endian(1) + static_cast<char>(bits) +
                             static_cast<char>(color_type) + std::string(3, '\0');
  return "\x89PNG\r\n\x1a\n" + png_chunk("IHDR", header) + png_chunk("IDAT", deflated) + png_chunk("IEND", "");
}

std::string jpeg_of(const Image8& image) {
  TempDir folder;
  write_image(folder / "a.jpg", image);
  return read_bytes(folder / "a.jpg");
}

std::string with_segment(const std::string& jpeg, char marker, const std::string& data) {
  const std::size_t length = data.size() + 2;
  return jpeg.substr(0, 2) + '\xff' + marker + static_cast<char>(length >> 8) + static_cast<char>(length & 255) + data +
         jpeg.substr(2);
}

// Adds EXIF data that asks viewers to rotate the image by 90 degrees.
std::string with_orientation(const std::string& jpeg) {
  const std::string tiff = std::string("II*\0\x08\0\0\0", 8) + std::string("\x01\0", 2) +
                           std::string("\x12\x01\x03\0\x01\0\0\0\x06\0\0\0", 12) + std::string(4, '\0');
  return with_segment(jpeg, '\xe1', std::string("Exif\0\0", 6) + tiff);
}

class ImageFile : public testing::Test {
 protected:
  fs::path store(const std::string& name, const std::string& bytes) {
    write_bytes(folder_ / name, bytes);
    return folder_ / name;
  }
  TempDir folder_;
};

TEST_F(ImageFile, PngIsLossless) {
  const Image8 image = noise(7, 5, 3);
  write_image(folder_ / "sub" / "a.png", image);
  const Image8 back = read_image(folder_ / "sub" / "a.png", false);
  EXPECT_EQ(back.width, 7);
  EXPECT_EQ(back.height, 5);
  EXPECT_EQ(back.channels, 3);
  EXPECT_EQ(back.pixels, image.pixels);
}

TEST_F(ImageFile, JpegChannelsAreNotSwapped) {
  Image8 image(16, 16, 3);
  for (std::size_t i = 0; i < image.pixels.size(); i += 3) image.pixels[i] = 250;
  write_image(folder_ / "a.JPEG", image);
  const Image8 back = read_image(folder_ / "a.JPEG", false);
  EXPECT_NEAR(back.pixels[0], 250, 3);
  EXPECT_NEAR(back.pixels[2], 0, 3);
}

TEST_F(ImageFile, GreyIsCopiedToAllChannels) {
  Image8 grey(2, 1, 1);
  grey.pixels = {10, 200};
  write_image(folder_ / "a.png", grey);
  EXPECT_EQ(read_image(folder_ / "a.png", false).pixels, (std::vector<std::uint8_t>{10, 10, 10, 200, 200, 200}));
}

TEST_F(ImageFile, SixteenBitsAreRoundedToEight) {
  // 128 / 257 = 0.498 -> 0, 129 / 257 = 0.502 -> 1, 65535 / 257 = 255.
  const auto png = store("a.png", one_row_png(3, 16, 0, std::string("\x00\x80\x00\x81\xff\xff", 6)));
  EXPECT_EQ(read_image(png, false).pixels, (std::vector<std::uint8_t>{0, 0, 0, 1, 1, 1, 255, 255, 255}));
  const auto rgb = store("b.png", one_row_png(1, 16, 2, std::string("\x10\x10\x20\x20\x30\x30", 6)));
  EXPECT_EQ(read_image(rgb, false).pixels, (std::vector<std::uint8_t>{16, 32, 48}));
}

TEST_F(ImageFile, AlphaIsCompositedOnTheBackground) {
  const auto png =
      store("a.png", one_row_png(3, 8, 6, std::string("\x64\xc8\x0a\xff\x64\xc8\x0a\x00\x64\xc8\x0a\x80", 12)));
  // Opaque; transparent; 128 / 255 of (100, 200, 10), the rest is background.
  EXPECT_EQ(read_image(png, false).pixels, (std::vector<std::uint8_t>{100, 200, 10, 0, 0, 0, 50, 100, 5}));
  EXPECT_EQ(read_image(png, true).pixels, (std::vector<std::uint8_t>{100, 200, 10, 255, 255, 255, 177, 227, 132}));
}

TEST_F(ImageFile, GreyWithAlphaIsCompositedToo) {
  const auto png = store("a.png", one_row_png(2, 8, 4, std::string("\x64\xff\x64\x00", 4)));
  EXPECT_EQ(read_image(png, true).pixels, (std::vector<std::uint8_t>{100, 100, 100, 255, 255, 255}));
  const auto deep = store("b.png", one_row_png(1, 16, 4, std::string("\x64\x64\x80\x80", 4)));
  EXPECT_EQ(read_image(deep, false).pixels, (std::vector<std::uint8_t>{50, 50, 50}));
}

TEST_F(ImageFile, AlphaOfATiffIsThatOfTheSamePng) {
  // Opaque, half transparent, hardly visible and transparent.
  const std::string rgba("\x64\xc8\x0a\xff\x64\xc8\x0a\x80\x64\xc8\x0a\x14\x00\x00\x00\x00", 16);
  const std::string premultiplied("\x64\xc8\x0a\xff\x32\x64\x05\x80\x08\x10\x01\x14\x00\x00\x00\x00", 16);
  const std::string planes("\x64\x64\x64\x00\xc8\xc8\xc8\x00\x0a\x0a\x0a\x00\xff\x80\x14\x00", 16);
  const std::string la("\x64\xff\x64\x80\xc8\x14\x00\x00", 8), grey("\x64\xff\x32\x80\x10\x14\x00\x00", 8);
  const auto deep = [](const std::string& text) {  // v becomes 257 v
    std::string twice;
    for (const char c : text) twice += std::string(2, c);
    return twice;
  };
  const auto png = store("a.png", one_row_png(4, 8, 6, rgba)), grey_png = store("b.png", one_row_png(4, 8, 4, la));
  TiffOptions in_planes, big;
  in_planes.is_separate = true;
  big.is_big = true;
  const auto expect_same = [&](const fs::path& expected, const std::string& tiff, const char* what) {
    const auto path = store("a.tif", tiff);
    for (const bool is_white : {false, true}) {
      EXPECT_EQ(read_image(path, is_white).pixels, read_image(expected, is_white).pixels) << what << " " << is_white;
    }
    ASSERT_TRUE(read_alpha(path)) << what;
    EXPECT_EQ(read_alpha(path)->pixels, (std::vector<std::uint8_t>{255, 128, 20, 0})) << what;
    EXPECT_EQ(read_image_size(path), (ImageSize{4, 1})) << what;
  };
  expect_same(png, tiff_of(4, 1, 8, 4, {2}, rgba), "8 bits, straight");
  expect_same(png, tiff_of(4, 1, 8, 4, {1}, premultiplied), "8 bits, premultiplied");
  expect_same(png, tiff_of(4, 1, 8, 4, {2}, planes, in_planes), "8 bits, straight, in planes");
  expect_same(png, tiff_of(4, 1, 8, 4, {1}, premultiplied, big), "BigTIFF");
  expect_same(png, tiff_of(4, 1, 16, 4, {2}, deep(rgba)), "16 bits, straight");
  expect_same(png, tiff_of(4, 1, 16, 4, {1}, deep(premultiplied)), "16 bits, premultiplied");
  expect_same(grey_png, tiff_of(4, 1, 8, 2, {2}, la), "8 bits, grey, straight");
  expect_same(grey_png, tiff_of(4, 1, 8, 2, {1}, grey), "8 bits, grey, premultiplied");
  expect_same(grey_png, tiff_of(4, 1, 16, 2, {2}, deep(la)), "16 bits, grey, straight");
  expect_same(grey_png, tiff_of(4, 1, 16, 2, {1}, deep(grey)), "16 bits, grey, premultiplied");

  const std::string whole = tiff_of(4, 1, 8, 2, {2}, la);
  for (std::size_t length = 0; length < whole.size(); ++length) {
    const auto path = store("cut.tif", whole.substr(0, length));
    EXPECT_THROW(read_image(path, false), InputError) << length;
  }
}

TEST_F(ImageFile, AlphaOfATiffOfUnknownKindIsStraightIfAColorExceedsIt) {
  using Pixels = std::vector<std::uint8_t>;
  const cv::Mat bgra(1, 1, CV_8UC4, cv::Scalar(50, 100, 200, 128));
  const fs::path path = folder_ / "a.tif";
  ASSERT_TRUE(cv::imwrite(path.string(), bgra));
  EXPECT_EQ(read_image(path, false).pixels, (Pixels{100, 50, 25})) << "as OpenCV writes it";
  cv::Mat deep;
  bgra.convertTo(deep, CV_16U, 257);
  ASSERT_TRUE(cv::imwrite(path.string(), deep));
  EXPECT_EQ(read_image(path, false).pixels, (Pixels{100, 50, 25})) << "16 bits";
  const std::string rgba("\x64\x32\x19\x80\xc8\x64\x32\x80", 8);
  EXPECT_EQ(read_image(store("a.tif", tiff_of(2, 1, 8, 4, {0}, rgba)), false).pixels,
            (Pixels{50, 25, 13, 100, 50, 25}));
  EXPECT_EQ(read_image(store("a.tif", tiff_of(1, 1, 8, 4, {0}, rgba.substr(0, 4))), false).pixels,
            (Pixels{100, 50, 25}))
      << "no color exceeds alpha";
}

TEST_F(ImageFile, AlphaOfATiffIsTheSampleThatIsDeclaredSo) {
  const std::string pixel("\xc8\x64\x32\x09\x80", 5);
  const auto path = store("a.tif", tiff_of(1, 1, 8, 5, {0, 2}, pixel));
  EXPECT_EQ(read_image(path, false).pixels, (std::vector<std::uint8_t>{100, 50, 25}));
}

TEST_F(ImageFile, ExifOrientationIsIgnored) {
  const auto path = store("a.jpg", with_orientation(jpeg_of(noise(32, 16, 3))));
  ASSERT_EQ(cv::imread(path.string(), cv::IMREAD_COLOR).cols, 16) << "OpenCV does not read the EXIF of this test";
  EXPECT_EQ(read_image(path, false).width, 32);
  EXPECT_EQ(read_image(path, false).height, 16);
  EXPECT_EQ(read_image_size(path).width, 32);
  EXPECT_EQ(read_image_size(path).height, 16);
}

TEST_F(ImageFile, ATiffIsNotTurned) {
  for (const bool is_big : {false, true}) {
    TiffOptions options;
    options.is_big = is_big;
    options.orientation = 6;
    const auto path = store("a.tif", tiff_of(4, 2, 8, 3, {}, "abcdefghijklmnopqrstuvwx", options));
    EXPECT_EQ(read_orientation(path), 6);
    EXPECT_EQ(read_image_size(path), (ImageSize{4, 2}));
    const Image8 image = read_image(path, false);
    EXPECT_EQ(std::string(image.pixels.begin(), image.pixels.end()), "abcdefghijklmnopqrstuvwx");
  }
}

TEST_F(ImageFile, JpegTruncatedAnywhereIsRejected) {
  const std::string jpeg = jpeg_of(noise(64, 64, 3));
  for (const double share : {0.02, 0.1, 0.5, 0.9}) {
    const auto path =
        store("cut.jpg", jpeg.substr(0, static_cast<std::size_t>(share * static_cast<double>(jpeg.size()))));
    EXPECT_TRUE(
        fails_with<InputError>({path.string(), "ends before its end marker"}, [&] { read_image(path, false); }));
  }
  const auto last = store("last.jpg", jpeg.substr(0, jpeg.size() - 2));
  EXPECT_TRUE(fails_with<InputError>({last.string()}, [&] { read_image(last, false); }));
}

TEST_F(ImageFile, EndMarkersOfThumbnailsAreIgnored) {
  const std::string jpeg = with_segment(jpeg_of(noise(64, 64, 3)), '\xe1', std::string("thumbnail \xff\xd9 end", 16));
  EXPECT_NO_THROW(read_image(store("whole.jpg", jpeg), false));
  const auto path = store("cut.jpg", jpeg.substr(0, jpeg.size() / 2));
  EXPECT_TRUE(fails_with<InputError>({path.string(), "end marker"}, [&] { read_image(path, false); }));
}

TEST_F(ImageFile, AJpegWhoseTailIsZeroIsRejected) {
  std::string jpeg = jpeg_of(noise(64, 64, 3));
  std::fill(jpeg.begin() + static_cast<std::ptrdiff_t>(jpeg.size() / 2), jpeg.end(),
            '\0');  // as after an interrupted download
  const auto path = store("zero.jpg", jpeg);
  EXPECT_TRUE(fails_with<InputError>({path.string(), "end marker"}, [&] { read_image(path, false); }));
}

TEST_F(ImageFile, TruncatedPngIsRejected) {
  const std::string png = one_row_png(3, 8, 2, "abcdefghi");
  for (std::size_t length = 9; length < png.size(); length += 5) {
    const auto path = store("cut.png", png.substr(0, length));
    EXPECT_TRUE(fails_with<InputError>({path.string(), "IEND"}, [&] { read_image(path, false); })) << length;
  }
}

TEST_F(ImageFile, DamagedPngIsRejected) {
  std::string png = one_row_png(3, 8, 2, "abcdefghi");
  png[50] ^= 1;  // in the pixel data
  const auto path = store("a.png", png);
  EXPECT_TRUE(fails_with<InputError>({path.string(), "cannot be decoded"}, [&] { read_image(path, false); }));
}

TEST_F(ImageFile, OtherContentIsRejected) {
  const auto page = store("a.jpg", "<html>not found</html>");
  EXPECT_TRUE(fails_with<InputError>({page.string(), "cannot be decoded"}, [&] { read_image(page, false); }));
  EXPECT_TRUE(fails_with<InputError>({page.string()}, [&] { read_image_size(page); }));
  const auto empty = store("b.jpg", "");
  EXPECT_TRUE(fails_with<InputError>({empty.string(), "empty"}, [&] { read_image(empty, false); }));
  EXPECT_TRUE(
      fails_with<InputError>({"missing.jpg", "No such file"}, [&] { read_image(folder_ / "missing.jpg", false); }));
  EXPECT_TRUE(fails_with<InputError>({folder_.path().string(), "regular"}, [&] { read_image(folder_.path(), false); }));
}

TEST_F(ImageFile, SizeIsReadFromTheHeader) {
  write_image(folder_ / "a.png", noise(13, 7, 3));
  EXPECT_EQ(read_image_size(folder_ / "a.png").width, 13);
  EXPECT_EQ(read_image_size(folder_ / "a.png").height, 7);
  const std::string jpeg = jpeg_of(noise(33, 17, 3));
  std::string padded = jpeg;  // the size is far back in the file
  for (int i = 0; i < 4; ++i) padded = with_segment(padded, '\xe2', std::string(60000, '\xff'));
  for (const std::string& bytes :
       {jpeg, padded, jpeg.substr(0, jpeg.size() - 20)}) {  // truncated or not: only the header matters
    const auto path = store("b.jpg", bytes);
    EXPECT_EQ(read_image_size(path).width, 33);
    EXPECT_EQ(read_image_size(path).height, 17);
  }
}

std::string png_of_size(std::uint32_t width, std::uint32_t height) {
  const std::string header = big_endian(width) + big_endian(height) + std::string("\x08\x02\0\0\0", 5);
  return "\x89PNG\r\n\x1a\n" + png_chunk("IHDR", header) + png_chunk("IEND", "");
}

TEST_F(ImageFile, SizeIsReadFromTheHeaderOfEveryFormat) {
  const cv::Mat image(7, 13, CV_8UC3, cv::Scalar(1, 2, 3));
  for (const char* name : {"a.bmp", "a.tif", "a.ppm", "a.pgm", "a.pbm", "lossy.webp", "lossless.webp"}) {
    const fs::path path = folder_ / name;
    cv::Mat grey;
    cv::extractChannel(image, grey, 0);
    const bool is_grey = path.extension() == ".pgm" || path.extension() == ".pbm";
    ASSERT_TRUE(
        cv::imwrite(path.string(), is_grey ? grey : image, {cv::IMWRITE_WEBP_QUALITY, name[4] == 'y' ? 90 : 101}));
    const std::string bytes = read_bytes(path);
    EXPECT_EQ(image_size_from_header({bytes.begin(), bytes.end()}), (ImageSize{13, 7})) << name;
    EXPECT_EQ(read_image(path, false).size(), (ImageSize{13, 7})) << name;
  }
}

// None of these files may be decoded, which would take gigabytes.
TEST_F(ImageFile, ASizeThatTheFileDoesNotJustifyIsRejected) {
  const auto little = [](std::uint32_t value, int bytes) {
    const std::string text = big_endian(value);
    return std::string(text.rbegin(), text.rend()).substr(0, static_cast<std::size_t>(bytes));
  };
  constexpr std::uint32_t kSide = 60000, kWebpSide = 16383;
  TiffOptions big, tiled, strip;
  big.is_big = true;
  tiled.tile = 1 << 14;
  strip.rows_per_strip = 1 << 28;
  strip.is_separate = true;  // libtiff divides a single strip
  const std::string side = little(kSide, 4), top_down = little(~kSide + 1, 4), zeros(64, '\0');
  const std::string jpeg_frame =
      std::string("\xff\xd8\xff\xc0\0\x11\x08\xea\x60\xea\x60\3\1\x11\0\2\x11\0\3\x11\0", 21);
  const std::string scan("\xff\xda\0\x0c\3\1\0\2\0\3\0\0?\0abc\xff\xd9", 19);
  const std::string canvas = little(kWebpSide - 1, 3) + little(kWebpSide - 1, 3);
  const std::pair<std::string, std::string> files[] = {
      {png_of_size(kSide, kSide), "60000 x 60000"},
      {jpeg_frame + scan, "60000 x 60000"},
      // A marker without a segment, which must not hide the frame that follows.
      {jpeg_frame.substr(0, 2) + "\xff\x01" + jpeg_frame.substr(2) + scan, "60000 x 60000"},
      {"BM" + zeros.substr(0, 12) + little(40, 4) + side + side + zeros, "60000 x 60000"},
      {"BM" + zeros.substr(0, 12) + little(40, 4) + side + top_down + zeros, "60000 x 60000"},
      {"BM" + zeros.substr(0, 12) + little(12, 4) + side.substr(0, 2) + side.substr(0, 2) + zeros, "60000 x 60000"},
      {"P6 60000\n# 1 x 1\n60000 255\n", "60000 x 60000"},
      {"P4\t60000 60000\n", "60000 x 60000"},
      {"P6 60000# 60000 \n1 255\n", "60000 x 60000"},
      {tiff_of(kSide, kSide, 8, 3, {}, zeros), "60000 x 60000"},
      {tiff_of(kSide, kSide, 8, 4, {1}, zeros), "60000 x 60000"},
      {tiff_of(kSide, kSide, 16, 1, {}, zeros, big), "60000 x 60000"},
      {tiff_of(4, 4, 8, 3, {}, zeros, tiled), "a tile or strip of 16384 x 16384"},
      {tiff_of(4, 4, 8, 4, {1}, zeros, tiled), "a tile or strip of 16384 x 16384"},
      {tiff_of(4, 4, 8, 3, {}, zeros, strip), "a tile or strip of 4 x 268435456"},
      {"RIFF" + zeros.substr(0, 4) + "WEBPVP8X" + little(10, 4) + zeros.substr(0, 4) + canvas, "16383 x 16383"},
      {"RIFF" + zeros.substr(0, 4) + "WEBPVP8 " + zeros.substr(0, 10) + little(kWebpSide, 2) + little(kWebpSide, 2),
       "16383 x 16383"},
      {"RIFF" + zeros.substr(0, 4) + "WEBPVP8L" + zeros.substr(0, 4) + "/" + little(0xfffffff, 4) + zeros,
       "16384 x 16384"},
  };
  for (const auto& [bytes, found] : files) {
    const auto path = store("a", bytes);
    const std::initializer_list<std::string> parts{path.string(), "expected at most 67108864 px in a file of ", found};
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_image(path, false); })) << found;
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_depth_map(path); })) << found;
    if (found[0] == 'a') continue;  // the image itself is small
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_image_size(path); })) << found;
  }
}

TEST_F(ImageFile, TheSizeMayGrowWithTheFile) {
  const auto path = store("a.png", png_of_size(1 << 14, 1 << 14) + std::string(1 << 16, '\0'));
  EXPECT_EQ(read_image_size(path), (ImageSize{1 << 14, 1 << 14}));
  const auto large = store("b.png", png_of_size(1 << 15, (1 << 15) + 1) + std::string(1 << 21, '\0'));
  EXPECT_TRUE(
      fails_with<InputError>({large.string(), "1073741824 px", "32768 x 32769"}, [&] { read_image_size(large); }));
}

TEST_F(ImageFile, FormatsWhoseSizeCannotBeCheckedAreNotDecoded) {
  const auto radiance = store("a.hdr", "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n");
  const auto exr = store("a.exr", std::string("v/1\1\2\0\0\0channels\0chlist\0", 24));
  for (const fs::path& path : {radiance, exr}) {
    const std::initializer_list<std::string> parts{path.string(),
                                                   "expected the header of a JPEG, PNG, BMP, TIFF, WebP"};
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_image(path, false); }));
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_depth_map(path); }));
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_image_size(path); }));
  }
}

TEST_F(ImageFile, MemoryThatIsNotDecodedIntoIsNoImage) {
  const auto page = store("b.png", "<html>not found</html>");
  std::uint8_t rgb[3];
  EXPECT_TRUE(fails_with<InputError>({page.string(), "cannot be decoded"}, [&] {
    read_image_into(page, false, {1, 1}, rgb);
  }));
  // The pixels begin with the decoder's marker value. OpenCV's order is blue, green, red.
  for (const char mark : {'\x5a', '\xa5'}) {
    read_image_into(store("c.png", one_row_png(1, 8, 2, std::string("\x01\x02") + mark)), false, {1, 1}, rgb);
    EXPECT_EQ(rgb[0], 1);
    EXPECT_EQ(rgb[2], static_cast<std::uint8_t>(mark));
  }
}

TEST_F(ImageFile, WritingNeedsAnImageExtension) {
  EXPECT_TRUE(fails_with<InputError>({"a.xyz", ".png"}, [&] { write_image(folder_ / "a.xyz", noise(2, 2, 3)); }));
}

TEST(ResizeImage, HalvingAveragesFourPixels) {
  Image8 image(4, 2, 1);
  image.pixels = {10, 20, 100, 100,  //
                  30, 40, 200, 200};
  EXPECT_EQ(resize_image(image, 2, 1).pixels, (std::vector<std::uint8_t>{25, 150}));
}

TEST(ResizeImage, ThreeToTwoWeighsByArea) {
  Image8 image(3, 1, 1);
  image.pixels = {30, 90, 240};
  // (30 + 90 / 2) / 1.5 and (90 / 2 + 240) / 1.5
  EXPECT_EQ(resize_image(image, 2, 1).pixels, (std::vector<std::uint8_t>{50, 190}));
}

TEST(ResizeImage, EnlargingKeepsConstantsAndSameSizeKeepsAll) {
  Image8 flat(3, 3, 3);
  std::fill(flat.pixels.begin(), flat.pixels.end(), std::uint8_t{77});
  for (const std::uint8_t value : resize_image(flat, 7, 8).pixels) EXPECT_EQ(value, 77);
  const Image8 image = noise(6, 4, 3);
  EXPECT_EQ(resize_image(image, 6, 4).pixels, image.pixels);
}

}  // namespace
}  // namespace b3dgs
