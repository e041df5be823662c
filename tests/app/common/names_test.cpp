// Photographs with names that are not UTF-8. The program's results are the same as with plain names.
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <regex>

#include "scene/colmap/colmap.h"
#include "support/files.h"
#include "support/run_program.h"
#include "support/temp_dir.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using test::read_bytes;
using test::run_b3dgs;

/// Returns "0000" and a digit, or instead of the digit a byte that is not UTF-8. Both sort alike.
std::string photograph(std::size_t i, bool is_plain) {
  const int first = is_plain || i == 0 ? '0' : 0xe8;
  return std::string("0000") + static_cast<char>(first + static_cast<int>(i)) + ".png";
}

class NamesThatAreNotUtf8 : public ::testing::Test {
 protected:
  /// Makes a scene of nine views and trains on it. All names but the first have a byte that is not UTF-8.
  void train(const std::string& name, bool is_plain) const {
    const Outcome made = run_b3dgs({"synth", "orbit", path(name), "--points", "300", "--views", "9", "--width", "64",
                                    "--height", "48", "--exposure_jitter", "0.3", "--quiet"});
    ASSERT_EQ(made.exit_code, 0) << made.err;
    ColmapModel model = read_colmap_model(folder_ / name / "sparse/0");
    for (std::size_t i = 0; i < model.images.size(); ++i) {
      const fs::path images = folder_ / name / "images";
      const std::string from = model.images[i].name, to = photograph(i, is_plain);
      ASSERT_EQ(from, photograph(i, true));
      fs::rename(images / from, images / to);
      model.images[i].name = to;
    }
    write_colmap_model(folder_ / name / "sparse/0", model, ColmapFormat::kBinary);
    const Outcome trained =
        run_b3dgs({"train", path(name), "-m", path(name + "_model"), "--eval", "--iterations", "20", "--exposure",
                   "--pose_opt", "--checkpoint_iterations", "10", "--device", "cpu", "--quiet"});
    ASSERT_EQ(trained.exit_code, 0) << trained.err;
  }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  /// Returns the output of eval, with plain names, or its warnings and errors if there are any.
  std::string evaluate(const std::string& name, const std::string& split) const {
    const Outcome outcome = run_b3dgs({"eval", path(name + "_model"), "--split", split, "--device", "cpu", "--quiet"});
    if (outcome.exit_code != 0 || !outcome.err.empty()) return name + ": " + outcome.err;
    std::string text = outcome.out;
    for (char& c : text) {
      if (static_cast<unsigned char>(c) >= 0xe8) c = static_cast<char>('0' + static_cast<unsigned char>(c) - 0xe8);
    }
    return text.substr(text.find('\n'));  // without the folder
  }

  test::TempDir folder_;
};

TEST_F(NamesThatAreNotUtf8, GiveTheResultsOfPlainNames) {
  ASSERT_NO_FATAL_FAILURE(train("plain", true));
  ASSERT_NO_FATAL_FAILURE(train("bytes", false));
  const fs::path ply = "point_cloud/iteration_20/point_cloud.ply";
  EXPECT_EQ(read_bytes(folder_ / "plain_model" / ply), read_bytes(folder_ / "bytes_model" / ply));
  for (const std::string split : {"train", "test", "all"}) {
    const std::regex name("0000.\\.png");  // the table has ? for a byte that is not UTF-8
    const std::string plain = std::regex_replace(evaluate("plain", split), name, "NAME");
    EXPECT_NE(plain.find("mean of"), std::string::npos) << plain;
    EXPECT_EQ(std::regex_replace(evaluate("bytes", split), name, "NAME"), plain);
  }
  const auto results = [&](const char* name, const char* file) {
    return nlohmann::json::parse(read_bytes(folder_ / name / file))["ours_20"];
  };
  const auto plain = results("plain_model", "results.json"), bytes = results("bytes_model", "results.json");
  EXPECT_EQ(plain["views"], 2);
  for (const char* const key : {"views", "PSNR", "SSIM"}) EXPECT_EQ(plain[key], bytes[key]) << key;
  EXPECT_EQ(results("bytes_model", "per_view.json")["PSNR"].size(), 2u);
}

TEST_F(NamesThatAreNotUtf8, AreResumed) {
  ASSERT_NO_FATAL_FAILURE(train("bytes", false));
  const Outcome resumed = run_b3dgs({"train", "--resume", path("bytes_model/checkpoints/iteration_10.b3dgs"), "-m",
                                     path("resumed"), "--device", "cpu", "--quiet"});
  EXPECT_EQ(resumed.exit_code, 0) << resumed.err;
  EXPECT_EQ(resumed.err, "");
  const fs::path ply = "point_cloud/iteration_20/point_cloud.ply";
  EXPECT_EQ(read_bytes(folder_ / "resumed" / ply), read_bytes(folder_ / "bytes_model" / ply));
}

}  // namespace
}  // namespace b3dgs
