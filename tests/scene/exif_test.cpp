#include "scene/images/image.h"

#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "scene/photograph.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using Bytes = std::vector<std::uint8_t>;
using test::jpeg_with_orientation;

TEST(Exif, OrientationIsReadInBothByteOrders) {
  for (const bool is_little : {false, true}) {
    for (int orientation = 1; orientation <= 8; ++orientation) {
      EXPECT_EQ(exif_orientation(jpeg_with_orientation(12, 8, orientation, is_little)), orientation);
    }
    EXPECT_EQ(exif_orientation(jpeg_with_orientation(12, 8, 9, is_little)), 1) << "not a value of EXIF";
  }
  EXPECT_EQ(exif_orientation({}), 1);
}

TEST(Exif, AFileThatIsCutAnywhereIsUpright) {
  const Bytes jpeg = jpeg_with_orientation(12, 8, 6, true);
  std::size_t first = 0;
  for (std::size_t length = 0; length <= jpeg.size(); ++length) {
    const int orientation = exif_orientation(Bytes(jpeg.begin(), jpeg.begin() + static_cast<std::ptrdiff_t>(length)));
    if (orientation == 6 && first == 0) first = length;
    EXPECT_EQ(orientation, first == 0 ? 1 : 6) << length;
  }
  EXPECT_GT(first, 30u);
}

TEST(Exif, ATurnedFileLooksAsViewersShowTheOriginal) {
  for (const bool is_little : {false, true}) {
    for (int orientation = 1; orientation <= 8; ++orientation) {
      const Bytes jpeg = jpeg_with_orientation(48, 32, orientation, is_little);
      const cv::Mat expected = cv::imdecode(jpeg, cv::IMREAD_COLOR);  // turned by OpenCV
      const auto turned = turned_upright(jpeg);
      ASSERT_TRUE(turned);
      EXPECT_EQ(exif_orientation(*turned), 1);
      const cv::Mat found = cv::imdecode(*turned, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
      ASSERT_EQ(found.size(), expected.size()) << orientation;
      EXPECT_LT(cv::norm(found, expected, cv::NORM_L1) / static_cast<double>(found.total()), 6) << orientation;
    }
  }
}

TEST(Exif, AFileIsTurnedIfOtherMetadataComeFirst) {
  const std::string xmp = "http://ns.adobe.com/xap/1.0/";
  Bytes jpeg = jpeg_with_orientation(48, 32, 6, false);
  Bytes segment{0xff, 0xe1, 0, static_cast<std::uint8_t>(2 + xmp.size() + 1)};
  segment.insert(segment.end(), xmp.c_str(), xmp.c_str() + xmp.size() + 1);
  jpeg.insert(jpeg.begin() + 2, segment.begin(), segment.end());
  const auto turned = turned_upright(jpeg);
  ASSERT_TRUE(turned);
  EXPECT_EQ(exif_orientation(*turned), 1);
  EXPECT_EQ(cv::imdecode(*turned, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION).size(), cv::Size(32, 48));
}

TEST(Exif, ATurnedFileKeepsTheOtherTagsAndTheColourProfile) {
  const auto turned = turned_upright(jpeg_with_orientation(48, 32, 6, false));
  ASSERT_TRUE(turned);
  const std::string text(turned->begin(), turned->end());
  EXPECT_NE(text.find("TestCam"), std::string::npos);
  EXPECT_NE(text.find("ICC_PROFILE"), std::string::npos);
}

TEST(Exif, DamagedFilesAreNotTurned) {
  Bytes jpeg = jpeg_with_orientation(48, 32, 6, false);
  EXPECT_FALSE(turned_upright(Bytes(jpeg.begin(), jpeg.begin() + 150)));
  EXPECT_FALSE(turned_upright({}));
}

TEST(Exif, OrientationIsReadFromOtherFormats) {
  const test::TempDir folder;
  const Bytes jpeg = jpeg_with_orientation(12, 8, 6, true);
  const std::string text(jpeg.begin(), jpeg.end());
  const std::string tiff = text.substr(text.find("II*"), 64);  // EXIF has the form of a TIFF
  const std::string png_size = std::string("\0\0\0\0", 4), png_name = "\x89PNG\r\n\x1a\n";
  const std::string png = png_name + png_size + "tEXt" + "crc." + std::string("\0\0\0\x40", 4) + "eXIf" + tiff + "crc.";
  const std::string webp = std::string("RIFF\0\0\0\0WEBPVP8 \x03\0\0\0abc\0EXIF\x40\0\0\0", 32) + tiff;
  for (const std::string& bytes : {tiff, png, webp}) {
    test::write_bytes(folder / "a", bytes);
    EXPECT_EQ(read_orientation(folder / "a"), 6);
    EXPECT_EQ(read_exif_orientation(folder / "a"), 1) << "only JPEG files are turned on disk";
    for (std::size_t length = 0; length < bytes.size(); ++length) {
      const int orientation =
          exif_orientation(Bytes(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length)));
      EXPECT_TRUE(orientation == 1 || orientation == 6);
    }
  }
  EXPECT_FALSE(turned_upright(Bytes(webp.begin(), webp.end())));
}

TEST(Exif, AFileIsReadFromItsBeginning) {
  const test::TempDir folder;
  const Bytes jpeg = jpeg_with_orientation(48, 32, 8, false);
  test::write_bytes(folder / "a.jpg", std::string(jpeg.begin(), jpeg.end()));
  EXPECT_EQ(read_exif_orientation(folder / "a.jpg"), 8);
  EXPECT_EQ(read_exif_orientation(folder / "none.jpg"), 1);
}

}  // namespace
}  // namespace b3dgs
