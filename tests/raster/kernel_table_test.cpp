// The tables of kernels: names are unique, lead back to their kernel, and unknown ones are errors.
#include "raster/kernels.h"

#include <gtest/gtest.h>

#include <set>

namespace b3dgs {
namespace {

template <class Rows>
void expect_names_to_lead_back(const Rows& rows) {
  std::set<std::string_view> names;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    SCOPED_TRACE(rows[i].name);
    EXPECT_EQ(static_cast<std::size_t>(rows[i].kernel), i) << "tables are indexed by the enumerator";
    EXPECT_EQ(find_kernel(rows, rows[i].name), rows[i].kernel);
    EXPECT_EQ(kernel_named(rows, rows[i].name), rows[i].kernel);
    EXPECT_TRUE(names.insert(rows[i].name).second) << "the name is used twice";
    EXPECT_FALSE(rows[i].summary.empty());
  }
  EXPECT_FALSE(find_kernel(rows, "no kernel"));
  EXPECT_THROW(kernel_named(rows, "no kernel"), LogicError);
}

TEST(KernelTable, NamesLeadBackToTheirKernel) {
  expect_names_to_lead_back(kForwardKernels);
  expect_names_to_lead_back(kBackwardKernels);
}

}  // namespace
}  // namespace b3dgs
