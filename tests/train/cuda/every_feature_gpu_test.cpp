// Runs the tests of every_feature_test.cpp on a GPU.
#include "support/train/every_feature.h"

#include <gtest/gtest.h>

#include "support/gpu_test.h"
#include "support/same.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

using test::train;
using test::Trained;

class EveryFeatureOnGpu : public testing::TestWithParam<test::FeatureRow> {};

TEST_P(EveryFeatureOnGpu, RepeatsAndResumesExactlyIfDeterministic) {
  B3DGS_NEEDS_GPU();
  const test::TempDir temp;
  const Scene scene = test::FeatureScene(temp / "depths").scene;
  TrainConfig config = test::every_feature(GetParam(), temp / "depths");
  config.device = "cuda";
  config.deterministic = true;
  const Trained whole = test::expect_exact_resume_from_checkpoints(config, scene, temp.path());
  const Trained again = train(config, scene, temp / "again");
  EXPECT_TRUE(test::same(again.ply, whole.ply));
  EXPECT_TRUE(test::same(again.checkpoint, whole.checkpoint));
}

INSTANTIATE_TEST_SUITE_P(Rows, EveryFeatureOnGpu, testing::ValuesIn(test::kFeatureRows),
                         [](const auto& info) { return info.param.name(); });

}  // namespace
}  // namespace b3dgs
