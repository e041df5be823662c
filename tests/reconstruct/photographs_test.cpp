#include "reconstruct/photographs.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include "core/check.h"
#include "reconstruct/fake_programs.h"
#include "support/expect_error.h"
#include "support/files.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::fails_with;
using test::read_bytes;
using test::TempDir;
using test::write_bytes;
using test::write_photographs;
using Names = std::vector<std::string>;

Names names_of(const std::vector<Photograph>& photographs) {
  Names names;
  for (const Photograph& photograph : photographs) names.push_back(photograph.name);
  return names;
}

void ignore(std::size_t /*done*/) {}

TEST(Photographs, AreListedWithSubFoldersAndWithoutHiddenOnes) {
  const TempDir folder;
  for (const char* name : {"b.JPG", "a.png", "left/c.tiff", ".hidden.jpg", ".cache/x.jpg", "__MACOSX/y.jpg",
                           "notes.txt", "scene/images/z.jpg"}) {
    write_bytes(folder / name, "x");
  }
  const std::vector<Photograph> photographs = list_photographs(folder.path(), {folder / "scene", folder / "none"});
  EXPECT_EQ(names_of(photographs), (Names{"a.png", "b.JPG", "left/c.tiff"}));
  EXPECT_EQ(photographs[0].bytes, 1u);
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

TEST(Photographs, AreLinkedAndKeptTheNextTime) {
  const TempDir folder;
  const fs::path from = folder / "photos", to = folder / "scene/images";
  write_photographs(from, 2);
  write_photographs(from / "left", 1);
  const std::vector<Photograph> photographs = list_photographs(from, {});
  place_photographs(from, to, photographs, false, ignore);
  EXPECT_TRUE(fs::equivalent(from / "left/a.png", to / "left/a.png"));
  place_photographs(from, to, photographs, false, ignore);
  fs::remove(from / "a.png");
  write_bytes(from / "a.png", "another one");
  EXPECT_NE(read_bytes(to / "a.png"), "another one");
  EXPECT_TRUE(fails_with<InputError>({"a.png", "another file is there"},
                                     [&] { place_photographs(from, to, list_photographs(from, {}), false, ignore); }));
  place_photographs(from, to, list_photographs(from, {}), true, ignore);
  EXPECT_EQ(read_bytes(to / "a.png"), "another one");
}

TEST(Photographs, OfOneSizeShareACamera) {
  CheckedPhotographs photographs;
  photographs.names = {"a", "b", "c"};
  photographs.sizes = {{8, 6}, {6, 8}, {8, 6}};
  const std::vector<CameraGroup> groups = group_by_camera(photographs, "size");
  ASSERT_EQ(groups.size(), 2u);
  EXPECT_EQ(groups[0].label, "6x8");
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
