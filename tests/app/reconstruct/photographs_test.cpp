#include "app/reconstruct/photographs.h"

#include <gtest/gtest.h>

#include <fstream>

#include "app/reconstruct/fake_programs.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "scene/images/image.h"
#include "scene/photograph.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/same.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;
using test::write_bytes;
using test::write_photographs;
using Names = std::vector<std::string>;

Names names_of(const PhotographList& list) {
  Names names;
  for (const Photograph& photograph : list.photographs) names.push_back(photograph.name);
  return names;
}

void ignore(std::size_t /*done*/) {}

TEST(Photographs, AreListedWithSubFoldersAndWithoutHiddenOnes) {
  const TempDir folder;
  for (const char* name : {"b.JPG", "a.png", "left/c.tiff", ".hidden.jpg", ".cache/x.jpg", "__MACOSX/y.jpg",
                           "notes.txt", "scene/images/z.jpg"}) {
    write_bytes(folder / name, "x");
  }
  const PhotographList list = list_photographs(folder.path(), {folder / "scene", folder / "none"});
  EXPECT_EQ(names_of(list), (Names{"a.png", "b.JPG", "left/c.tiff"}));
  EXPECT_EQ(list.photographs[0].bytes, 1u);
}

// Copies in a scene below the photographs are ignored, but those beside them are listed.
TEST(Photographs, ThatTheProgramHasWrittenAreNotListed) {
  const TempDir folder;
  for (const char* name : {"a.jpg", "b.jpg", "scene/images/a.jpg", "scene/images/c.jpg"}) {
    write_bytes(folder / name, "x");
  }
  OwnFiles(folder / "scene").add(folder / "scene/images/a.jpg");
  EXPECT_EQ(names_of(list_photographs(folder.path(), {})), (Names{"a.jpg", "b.jpg", "scene/images/c.jpg"}));
}

TEST(Photographs, LinksToFoldersAreFollowedUnlessTheyLeadBack) {
  const TempDir folder, elsewhere;
  for (const char* name : {"a.jpg", "left/b.jpg"}) write_bytes(folder / name, "x");
  write_bytes(elsewhere / "c.jpg", "x");
  fs::create_directory_symlink("..", folder / "left/up");
  fs::create_directory_symlink(".", folder / "self");
  fs::create_directory_symlink(elsewhere.path(), folder / "other");
  EXPECT_EQ(names_of(list_photographs(folder.path(), {})), (Names{"a.jpg", "left/b.jpg", "other/c.jpg"}));

  const TempDir pair;  // each links to the other
  for (const char* name : {"x/a.jpg", "y/b.jpg"}) write_bytes(pair / name, "x");
  fs::create_directory_symlink("../y", pair / "x/other");
  fs::create_directory_symlink("../x", pair / "y/other");
  EXPECT_EQ(names_of(list_photographs(pair.path(), {})),
            (Names{"x/a.jpg", "x/other/b.jpg", "y/b.jpg", "y/other/a.jpg"}));
}

TEST(Photographs, RawFilesWithoutAJpegBesideThemAreNamed) {
  const TempDir folder;
  for (const char* name : {"a.jpg", "a.CR2", "b.jpg", "c.HEIC", "left/b.dng"}) write_bytes(folder / name, "x");
  EXPECT_EQ(list_photographs(folder.path(), {}).unreadable, (Names{"c.HEIC", "left/b.dng"}));
}

TEST(Photographs, NamesThatColmapCannotReadAreRefused) {
  for (const char* name : {"a\nb.png", "left\x1b/a.png", " a.png"}) {
    const TempDir folder;
    write_photographs(folder.path(), 3);
    write_bytes(folder / name, "x");
    EXPECT_TRUE(fails_with<InputError>({"rename this file or folder"}, [&] { list_photographs(folder.path(), {}); }))
        << name;
  }
}

TEST(Photographs, NoneOneAndRawOnesAreToldApart) {
  const TempDir folder;
  const auto list = [&] { list_photographs(folder.path(), {}); };
  EXPECT_TRUE(fails_with<InputError>({folder.path().string(), "no photographs", ".jpg", "20 or more"}, list));
  write_bytes(folder / "a.jpg", "x");
  EXPECT_TRUE(fails_with<InputError>({"only one photograph"}, list));
  write_bytes(folder / "b.HEIC", "x");
  EXPECT_TRUE(fails_with<InputError>({"only one photograph", "found 1 raw or HEIC files: convert them to JPEG"}, list));
  EXPECT_TRUE(fails_with<InputError>({"cannot be read"}, [&] { list_photographs(folder / "none", {}); }));
}

TEST(Photographs, DamagedOnesAreNamed) {
  const TempDir folder;
  write_photographs(folder.path(), 3);
  const std::string whole = read_bytes(folder / "b.png");
  write_bytes(folder / "b.png", whole.substr(0, whole.size() - 5));
  write_bytes(folder / "d.jpg", "not an image");
  write_bytes(folder / "e.jpg", "");
  const CheckedPhotographs checked =
      check_photographs(folder.path(), {"a.png", "b.png", "c.png", "d.jpg", "e.jpg", "f.jpg"}, ignore);
  EXPECT_EQ(checked.names, (Names{"a.png", "c.png"}));
  ASSERT_EQ(checked.sizes.size(), 2u);
  EXPECT_EQ(checked.sizes[1].width, 8);
  ASSERT_EQ(checked.damaged.size(), 4u);
  EXPECT_NE(checked.damaged[0].find("b.png"), std::string::npos);
  EXPECT_NE(checked.damaged[3].find("f.jpg"), std::string::npos);
}

class PlacedPhotographs : public testing::Test {
 protected:
  std::size_t place() const { return place_photographs(from_, to_, list_photographs(from_, {}).photographs, ignore); }
  std::string in_the_way() const { return find_in_the_way(from_, to_, list_photographs(from_, {}).photographs); }
  TempDir folder_;
  fs::path from_ = folder_ / "photos", to_ = folder_ / "scene/images";
};

TEST_F(PlacedPhotographs, AreCopiesThatShareNothingWithTheOriginals) {
  write_photographs(from_, 2);
  write_photographs(from_ / "left", 1);
  const std::string before = read_bytes(from_ / "left/a.png");
  EXPECT_EQ(place(), 0u);
  EXPECT_FALSE(fs::equivalent(from_ / "left/a.png", to_ / "left/a.png"));
  EXPECT_EQ(fs::last_write_time(to_ / "a.png"), fs::last_write_time(from_ / "a.png"));
  std::fstream(to_ / "left/a.png", std::ios::in | std::ios::out | std::ios::binary) << "edited in place";
  EXPECT_TRUE(test::same(read_bytes(from_ / "left/a.png"), before));
}

TEST_F(PlacedPhotographs, AreKeptTheNextTimeAndOthersAreInTheWay) {
  write_photographs(from_, 3);
  place();
  EXPECT_EQ(in_the_way(), "");
  const fs::file_time_type placed = fs::last_write_time(to_ / "b.png");
  fs::remove(to_ / "a.png");
  place();
  EXPECT_EQ(fs::last_write_time(to_ / "b.png"), placed);
  write_bytes(from_ / "b.png", "another one");
  EXPECT_EQ(in_the_way(), "b.png");
  fs::remove(to_ / "b.png");
  write_bytes(from_ / "left/x.png", "x");
  write_bytes(to_ / "left", "a file where a folder is needed");
  EXPECT_EQ(in_the_way(), "left/x.png");
}

TEST_F(PlacedPhotographs, FollowRelativeLinks) {
  write_photographs(folder_ / "raw", 2);
  fs::create_directories(from_);
  for (const char* name : {"a.png", "b.png"}) fs::create_symlink(fs::path("../raw") / name, from_ / name);
  place();
  EXPECT_FALSE(fs::is_symlink(to_ / "a.png"));
  EXPECT_TRUE(test::same(read_bytes(to_ / "a.png"), read_bytes(folder_ / "raw/a.png")));
}

TEST_F(PlacedPhotographs, AreTurnedUpright) {
  write_photographs(from_, 1);
  const OwnFiles own(folder_ / "scene");
  fs::create_directories(folder_ / "scene");
  const std::vector<std::uint8_t> jpeg = test::jpeg_with_orientation(48, 32, 6, true);
  const std::string original(jpeg.begin(), jpeg.end());
  write_bytes(from_ / "lying.jpg", original);
  EXPECT_EQ(count_turned(from_, list_photographs(from_, {}).photographs), 1u);
  EXPECT_EQ(place(), 1u);
  EXPECT_EQ(read_image_size(to_ / "lying.jpg"), (ImageSize{32, 48}));
  EXPECT_EQ(read_exif_orientation(to_ / "lying.jpg"), 1);
  EXPECT_TRUE(test::same(read_bytes(from_ / "lying.jpg"), original));
  EXPECT_EQ(in_the_way(), "") << "the turned copy is the photograph";
  EXPECT_EQ(place(), 0u);
  // A damaged photograph is copied, and the check detects it afterwards.
  write_bytes(from_ / "cut.jpg", original.substr(0, 150));
  EXPECT_EQ(place(), 0u);
  EXPECT_TRUE(test::same(read_bytes(to_ / "cut.jpg"), original.substr(0, 150)));
}

TEST(Photographs, OfOneSizeShareACamera) {
  CheckedPhotographs photographs;
  photographs.names = {"a", "b", "c"};
  photographs.sizes = {{8, 6}, {6, 8}, {8, 6}};
  const std::vector<CameraGroup> groups = group_by_camera(photographs, "size");
  ASSERT_EQ(groups.size(), 2u);
  EXPECT_EQ(groups[0].names, Names{"b"});
  EXPECT_EQ(groups[1].names, (Names{"a", "c"}));
  EXPECT_TRUE(groups[1].is_single_camera);
  for (const char* per : {"folder", "photo"}) {
    ASSERT_EQ(group_by_camera(photographs, per).size(), 1u);
    EXPECT_FALSE(group_by_camera(photographs, per)[0].is_single_camera);
  }
  for (int i = 0; i < 9; ++i) {
    photographs.names.push_back(std::to_string(i));
    photographs.sizes.push_back({100 + i, 6});
  }
  EXPECT_EQ(group_by_camera(photographs, "size").size(), 1u) << "many sizes: a camera for each";
}

}  // namespace
}  // namespace b3dgs
