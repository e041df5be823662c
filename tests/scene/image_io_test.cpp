#include "scene/images/image.h"

#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <random>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;
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

// Returns an uncompressed TIFF. `extra` are the kinds of its last samples (ExtraSamples), 1 premultiplied and 2
// straight alpha. Samples of 16 bits are little-endian. With `is_separate`, the planes of the samples follow each
// other.
std::string tiff_of(int width, int height, int bits, int n_samples, const std::vector<std::uint32_t>& extra,
                    const std::string& samples, bool is_separate = false) {
  const auto number = [](std::uint32_t value, int bytes) {
    std::string text;
    for (int i = 0; i < bytes; ++i) text += static_cast<char>(value >> 8 * i & 0xff);
    return text;
  };
  const auto n = static_cast<std::uint32_t>(n_samples), n_planes = is_separate ? n : 1;
  const auto plane_bytes = static_cast<std::uint32_t>(samples.size()) / n_planes;
  const std::uint32_t n_entries = 10,
                      lists = 8 + 2 + 12 * n_entries + 4;  // position of values that need more than 4 bytes
  std::string entries, values;
  const auto add = [&](std::uint32_t tag, int bytes_each, const std::vector<std::uint32_t>& numbers) {
    std::string list;
    for (const std::uint32_t value : numbers) list += number(value, bytes_each);
    entries +=
        number(tag, 2) + number(bytes_each == 2 ? 3 : 4, 2) + number(static_cast<std::uint32_t>(numbers.size()), 4);
    if (list.size() > 4) {
      entries += number(lists + static_cast<std::uint32_t>(values.size()), 4);
      values += list;
    } else {
      entries += list + std::string(4 - list.size(), '\0');
    }
  };
  const std::uint32_t data = lists + 64;
  std::vector<std::uint32_t> offsets;
  for (std::uint32_t i = 0; i < n_planes; ++i) offsets.push_back(data + i * plane_bytes);
  add(256, 4, {static_cast<std::uint32_t>(width)});
  add(257, 4, {static_cast<std::uint32_t>(height)});
  add(258, 2, std::vector<std::uint32_t>(n, static_cast<std::uint32_t>(bits)));
  add(262, 2, {n >= 3 ? 2u : 1u});  // RGB, or grey with black as 0
  add(273, 4, offsets);
  add(277, 2, {n});
  add(278, 4, {static_cast<std::uint32_t>(height)});  // rows per strip
  add(279, 4, std::vector<std::uint32_t>(n_planes, plane_bytes));
  add(284, 2, {is_separate ? 2u : 1u});
  add(338, 2, extra);
  values.resize(64);
  return std::string("II*\0", 4) + number(8, 4) + number(n_entries, 2) + entries + number(0, 4) + values + samples;
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
  expect_same(png, tiff_of(4, 1, 8, 4, {2}, planes, true), "8 bits, straight, in planes");
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
  std::string tiff = tiff_of(4, 2, 8, 3, {0}, std::string("abcdefghijklmnopqrstuvwx"));
  // The last entry becomes the orientation instead of ExtraSamples.
  const std::size_t last = 8 + 2 + 9 * 12;
  tiff[last] = '\x12';
  tiff[last + 8] = '\6';
  const auto path = store("a.tif", tiff);
  EXPECT_EQ(read_orientation(path), 6);
  EXPECT_EQ(read_image_size(path), (ImageSize{4, 2}));
  const Image8 image = read_image(path, false);
  EXPECT_EQ(std::string(image.pixels.begin(), image.pixels.end()), "abcdefghijklmnopqrstuvwx");
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
  const auto pgm = store("c.pgm", "P5 3 2 255\nabcdef");  // through the decoder
  EXPECT_EQ(read_image_size(pgm).width, 3);
  EXPECT_EQ(read_image_size(pgm).height, 2);
}

TEST_F(ImageFile, MorePixelsThanCanBeDecodedAreRejected) {
  const std::string header = big_endian(1 << 15) + big_endian((1 << 15) + 1) + std::string("\x08\x02\0\0\0", 5);
  const std::string png = "\x89PNG\r\n\x1a\n" + png_chunk("IHDR", header) + png_chunk("IEND", "");
  const auto path = store("a.png", png), large = store("b.png", png + std::string(1 << 21, '\0'));
  for (const auto& [file, most] : {std::pair(path, "268435456 px in a file of 45 bytes"), {large, "1073741824 px"}}) {
    const std::initializer_list<std::string> parts{file.string(), most, "32768 x 32769"};
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_image_size(file); }));
    EXPECT_TRUE(fails_with<InputError>(parts, [&] { read_image(file, false); }));
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
