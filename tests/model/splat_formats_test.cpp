#include "model/formats/splat_formats.h"

#include <gtest/gtest.h>

#include "core/check.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

SplatCloud two_gaussians() {
  SplatCloud cloud;
  cloud.means = {0, 1, 2, -3, 4, 5};
  cloud.log_scales = {-3, -4, -5, -3, -3, -3};
  cloud.quats = {1, 0, 0, 0, 0.5f, 0.5f, 0.5f, 0.5f};
  cloud.logit_opacities = {2, -2};
  cloud.sh0 = {0.1f, 0.2f, 0.3f, -0.1f, -0.2f, -0.3f};
  return cloud;
}

// Formats may be lossy, so only positions are compared, with a tolerance.
TEST(SplatFormats, EachReadsWhatItWrites) {
  const test::TempDir folder;
  const SplatCloud cloud = two_gaussians();
  for (const char* name : {"a.ply", "A.SPZ"}) {
    write_splats(folder / name, cloud);
    EXPECT_TRUE(holds_splats(folder / name)) << name;
    const SplatCloud back = read_splats(folder / name);
    ASSERT_EQ(back.size(), 2) << name;
    for (std::size_t i = 0; i < 6; ++i) EXPECT_NEAR(back.means[i], cloud.means[i], 1e-2) << name;
    EXPECT_EQ(back.shN.size(), 6u * static_cast<std::size_t>(sh_coefficient_count(back.sh_degree) - 1)) << name;
    const std::string whole = test::read_bytes(folder / name);
    test::write_bytes(folder / name, whole.substr(0, whole.size() - 1));
    EXPECT_TRUE(test::fails_with<InputError>({(folder / name).string()}, [&] { read_splats(folder / name); })) << name;
  }
}

TEST(SplatFormats, AreFoundByExtension) {
  EXPECT_EQ(splat_format("folder/A.PLY"), SplatFormat::kPly);
  EXPECT_EQ(splat_format("a.spz"), SplatFormat::kSpz);
  EXPECT_EQ(splat_format("ply"), std::nullopt);
  EXPECT_EQ(splat_format("a.ply.zip"), std::nullopt);
}

TEST(SplatFormats, OtherExtensionsAreReadAsPlyAndNotWritten) {
  const test::TempDir folder;
  EXPECT_TRUE(test::fails_with<InputError>({"a.xyz", ".ply or .spz"},
                                           [&] { write_splats(folder / "a.xyz", two_gaussians()); }));
  write_splat_ply(folder / "a.xyz", two_gaussians());
  EXPECT_EQ(read_splats(folder / "a.xyz").means, two_gaussians().means);
  EXPECT_TRUE(holds_splats(folder / "a.xyz"));
  write_point_ply(folder / "points.ply", {{1, 2, 3}, {4, 5, 6}});
  EXPECT_FALSE(holds_splats(folder / "points.ply"));
}

}  // namespace
}  // namespace b3dgs
