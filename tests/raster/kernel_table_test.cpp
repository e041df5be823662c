// Tests the table of kernels: names are unique and map back to their kernel, and unknown names are errors.
#include "raster/kernels.h"

#include <gtest/gtest.h>

#include <set>

namespace b3dgs {
namespace {

TEST(KernelTable, NamesLeadBackToTheirKernel) {
  std::set<std::string_view> names;
  for (std::size_t i = 0; i < kForwardKernels.size(); ++i) {
    const KernelRow& row = kForwardKernels[i];
    SCOPED_TRACE(row.name);
    EXPECT_EQ(static_cast<std::size_t>(row.kernel), i) << "the table is indexed by the enumerator";
    EXPECT_EQ(find_kernel(row.name), row.kernel);
    EXPECT_EQ(kernel_named(row.name), row.kernel);
    EXPECT_TRUE(names.insert(row.name).second) << "the name is used twice";
    EXPECT_FALSE(row.summary.empty());
  }
  EXPECT_FALSE(find_kernel("no kernel"));
  EXPECT_THROW(kernel_named("no kernel"), LogicError);
}

TEST(KernelTable, ThePapersFiveKernelsHaveItsPatches) {
  std::set<std::string_view> paper;
  for (const KernelRow& row : kForwardKernels) {
    if (family_of(row.kernel) == KernelFamily::kPaper) paper.insert(row.name);
  }
  EXPECT_EQ(paper, (std::set<std::string_view>{"naive", "dynamic", "gaussian-wise", "combined", "shared-memory"}));
  EXPECT_EQ(kPaperTile.width, 16);
  EXPECT_EQ(kPaperTile.height, 8);
  EXPECT_EQ(backward_kernel_of(KernelFamily::kPaper), "per-pixel");
  EXPECT_EQ(family_of(kStandardKernel), KernelFamily::kOwn);
}

}  // namespace
}  // namespace b3dgs
