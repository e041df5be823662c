#include "train/checkpoint/checkpoint.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "config/train_options.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "support/approx.h"
#include "support/expect_error.h"
#include "support/files.h"
#include "support/same.h"
#include "support/temp_dir.h"
#include "support/train/tiny_scene.h"
#include "support/train/write_checkpoint.h"
#include "train/gaussians/gaussian_model.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

Scene small_scene() {
  test::TinySceneOptions options;
  options.n_gaussians = 6;
  options.n_views = 4;
  options.width = 16;
  options.height = 12;
  return test::make_tiny_scene(options);
}

TrainState make_state(const Scene& scene) {
  torch::manual_seed(5);
  TrainState state;
  state.iteration = 42;
  state.sh_degree = 1;
  state.gaussians = to_tensors(splats_from_points(scene.points, 1), 1, torch::kCPU);
  state.adam = make_adam_state(state.gaussians);
  for (GaussianTensors* moments : {&state.adam.m, &state.adam.v}) {
    for (torch::Tensor* moment : moments->all()) *moment = torch::randn_like(*moment);
  }
  for (torch::Tensor* moment : state.adam.v.all()) moment->abs_();
  state.adam.steps = 41;
  state.statistics = make_density_statistics(state.gaussians.size(), torch::kCPU);
  state.statistics.view_count += 7;
  state.view_order.n_refills = 3;
  state.view_order.remaining = {2, 0};
  state.loss_average = 0.1 + 0.2;  // needs all digits of a double
  state.elapsed_s = 12.1 + 0.2;
  state.kernel_selection = {{"kernel", "dynamic"}};
  return state;
}

TrainConfig make_config() {
  TrainConfig config;
  config.sh_degree = 1;
  config.opacity_lr = 0.033;
  return config;
}

class CheckpointFiles : public testing::Test {
 protected:
  void SetUp() override { write_checkpoint(path, make_config(), make_state(scene), scene); }

  test::TempDir folder;
  const fs::path path = folder / "a.b3dgs";
  const Scene scene = small_scene();
};

TEST_F(CheckpointFiles, ReadBackEveryBit) {
  const Checkpoint read = read_checkpoint(path, scene, torch::kCPU);
  const TrainState expected = make_state(scene);
  EXPECT_EQ(read.state.iteration, 42);
  EXPECT_EQ(read.state.sh_degree, 1);
  EXPECT_EQ(read.state.adam.steps, 41);
  EXPECT_EQ(read.state.view_order.n_refills, 3u);
  EXPECT_EQ(read.state.view_order.remaining, (std::vector<std::int32_t>{2, 0}));
  EXPECT_EQ(read.state.loss_average, 0.1 + 0.2);
  EXPECT_EQ(read.state.elapsed_s, 12.1 + 0.2);
  EXPECT_EQ(read.state.kernel_selection, expected.kernel_selection);
  EXPECT_TRUE(config_differences(make_config(), read.config).empty());
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_TRUE(test::same(*read.state.gaussians.all()[i], *expected.gaussians.all()[i]));
    EXPECT_TRUE(test::same(*read.state.adam.m.all()[i], *expected.adam.m.all()[i]));
    EXPECT_TRUE(test::same(*read.state.adam.v.all()[i], *expected.adam.v.all()[i]));
  }
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_TRUE(test::same(*read.state.statistics.all()[i], *expected.statistics.all()[i]));
  }
}

TEST_F(CheckpointFiles, CutShortAnywhereAreRefused) {
  const std::string whole = test::read_bytes(path);
  const fs::path damaged = folder / "damaged.b3dgs";
  test::write_bytes(damaged, whole);
  for (std::size_t length = whole.size(); length-- > 0;) {
    fs::resize_file(damaged, length);
    ASSERT_TRUE(test::fails_with<InputError>({damaged.string()}, [&] { verify_checkpoint_file(damaged); })) << length;
    ASSERT_TRUE(test::fails_with<InputError>({damaged.string()}, [&] { read_checkpoint(damaged, scene, torch::kCPU); }))
        << length;
  }
  test::write_bytes(damaged, whole + '\0');
  EXPECT_TRUE(test::fails_with<InputError>({"bytes after the header"}, [&] { verify_checkpoint_file(damaged); }));
}

TEST_F(CheckpointFiles, WithAnyByteFlippedAreRefused) {
  const std::string whole = test::read_bytes(path);
  const fs::path damaged = folder / "damaged.b3dgs";
  for (std::size_t i = 0; i < whole.size(); i += i < 64 ? 1 : 61) {
    for (const int bit : {0, 6}) {
      std::string flipped = whole;
      flipped[i] = static_cast<char>(flipped[i] ^ (1 << bit));
      test::write_bytes(damaged, flipped);
      EXPECT_TRUE(test::fails_with<InputError>({damaged.string()}, [&] { verify_checkpoint_file(damaged); })) << i;
      EXPECT_TRUE(test::fails_with<InputError>({damaged.string()}, [&] { read_checkpoint_file(damaged); })) << i;
    }
  }
}

TEST_F(CheckpointFiles, SayWhyTheyAreRefused) {
  const std::string whole = test::read_bytes(path);
  const fs::path damaged = folder / "damaged.b3dgs";
  const auto reason = [&](const std::string& bytes, const std::string& part) {
    test::write_bytes(damaged, bytes);
    return test::fails_with<InputError>({part}, [&] { read_checkpoint_file(damaged); });
  };
  EXPECT_TRUE(reason("ply\nformat ascii 1.0\n", "not a b3dgs checkpoint"));
  std::string newer = whole;
  newer[8] = 9;
  EXPECT_TRUE(reason(newer, "version 9"));
  std::string flipped = whole;
  flipped.back() = static_cast<char>(flipped.back() ^ 1);
  EXPECT_TRUE(reason(flipped, "statistics.max_radii"));
  std::string enormous = whole;
  enormous[16 + 7] = 0x7f;  // a header of 2^62 bytes
  EXPECT_TRUE(reason(enormous, "truncated"));
  EXPECT_TRUE(test::fails_with<InputError>({"missing.b3dgs", "No such file"},
                                           [&] { read_checkpoint_file(folder / "missing.b3dgs"); }));
}

TEST_F(CheckpointFiles, OfAnotherSceneAreRefused) {
  const auto refused = [&](const Scene& other, const std::string& part) {
    return test::fails_with<InputError>({path.string(), part}, [&] { read_checkpoint(path, other, torch::kCPU); });
  };
  Scene other = scene;
  const std::string name = other.train.back().name;
  other.train.pop_back();
  EXPECT_TRUE(
      refused(other, "but the scene has " + std::to_string(other.train.size()) + "; 1 is missing (" + name + ")"));
  other.train.push_back(other.train[0]);
  other.train.back().name = "a.png";
  other.train.push_back(other.train[0]);
  other.train.back().name = "b.png";
  EXPECT_TRUE(refused(other, "; 1 is missing (" + name + "); 2 are new (a.png, ...); resume with"));
  other = scene;
  const std::string second = other.train[1].name;
  other.train[1].name = "other.png";
  EXPECT_TRUE(refused(
      other, "trained on other views of the scene; 1 is missing (" + second + "); 1 is new (other.png); resume with"));
  other = scene;
  other.test.push_back(other.train[1]);
  other.train.erase(other.train.begin() + 1);
  EXPECT_TRUE(refused(other, "; 1 is held out for testing now (" + second + "); resume with"));
  other = scene;
  other.train[0].camera.width *= 2;
  EXPECT_TRUE(refused(other, "training view 0"));
  other = scene;
  other.extent *= 2;
  EXPECT_TRUE(refused(other, "extent"));
}

TEST_F(CheckpointFiles, WithTensorsThatDoNotFitAreRefused) {
  const auto refused = [&](const CheckpointFile& file, const std::string& part) {
    const fs::path other = folder / "other.b3dgs";
    write_checkpoint_file(other, file);
    return test::fails_with<InputError>({other.string(), part}, [&] { read_checkpoint(other, scene, torch::kCPU); });
  };
  const CheckpointFile good = read_checkpoint_file(path);
  CheckpointFile file = good;
  file.tensors[2].second = torch::zeros({5, 4});
  EXPECT_TRUE(refused(file, "gaussians.quats"));
  file = good;
  file.tensors.pop_back();
  EXPECT_TRUE(refused(file, "statistics.max_radii is missing"));
  file = good;
  file.tensors.emplace_back("more", torch::zeros({1}));
  EXPECT_TRUE(refused(file, "more"));
  const auto n_views = static_cast<std::int64_t>(scene.train.size());
  file = good;
  file.tensors.emplace_back("poses.steps", torch::zeros({n_views}, torch::kInt32));
  EXPECT_TRUE(refused(file, "unknown tensor poses.steps")) << "without the poses";
  file = good;
  file.tensors.emplace_back("appearance.m", torch::zeros({n_views, 3, 4}));
  EXPECT_TRUE(refused(file, "unknown tensor appearance.m")) << "without the exposures";
  file = good;
  file.header.erase("iteration");
  EXPECT_TRUE(refused(file, "iteration"));
  file = good;
  file.header["view_order"]["remaining"] = {0, 99};
  EXPECT_TRUE(refused(file, "view 99"));
}

/// Tests checkpoints that are refused after a change of their contents.
class ChangedCheckpoints : public CheckpointFiles {
 protected:
  template <class Change>
  testing::AssertionResult refused(const std::string& part, Change&& change) {
    CheckpointFile file = read_checkpoint_file(path);
    for (auto& [name, tensor] : file.tensors) tensor = tensor.clone();
    change(file);
    const fs::path other = folder / "other.b3dgs";
    write_checkpoint_file(other, file);
    return test::fails_with<InputError>({other.string(), part}, [&] { read_checkpoint(other, scene, torch::kCPU); });
  }
  testing::AssertionResult refuses_value(const char* key, const nlohmann::ordered_json& value) {
    return refused(key, [&](CheckpointFile& file) { file.header[key] = value; });
  }
  testing::AssertionResult refuses_tensor_value(const std::string& name, double value) {
    return refused(name, [&](CheckpointFile& file) {
      for (auto& [own, tensor] : file.tensors) {
        if (own == name) tensor.view({-1})[3] = value;
      }
    });
  }
};

TEST_F(ChangedCheckpoints, WithNumbersOutOfTheirRangeAreRefused) {
  EXPECT_TRUE(refuses_value("iteration", -7));
  EXPECT_TRUE(refuses_value("iteration", 4294967297));
  EXPECT_TRUE(refuses_value("iteration", 1.5));
  EXPECT_TRUE(refuses_value("sh_degree", 9));
  EXPECT_TRUE(refuses_value("sh_degree", 2)) << "the config's is 1";
  EXPECT_TRUE(refuses_value("sh_degree", -1));
  EXPECT_TRUE(refuses_value("adam_steps", -1));
  EXPECT_TRUE(refuses_value("adam_steps", 43)) << "more than iterations";
  EXPECT_TRUE(refused("gaussians.means", [](CheckpointFile& file) { file.header["n_gaussians"] = 7; }));
  EXPECT_TRUE(refuses_value("n_gaussians", 0));
  EXPECT_TRUE(refuses_value("loss_average", nullptr));
  EXPECT_TRUE(refuses_value("elapsed_s", -1));
  EXPECT_TRUE(refuses_value("kernel_selection", "none"));
  EXPECT_TRUE(refuses_value("scene", {1, 2}));
}

TEST_F(ChangedCheckpoints, WithAnInvalidViewOrderAreRefused) {
  const auto refuses_views = [&](const nlohmann::ordered_json& views, const std::string& part) {
    return refused(part, [&](CheckpointFile& file) { file.header["view_order"]["remaining"] = views; });
  };
  EXPECT_TRUE(refuses_views({2, 0, 2}, "view 2"));
  EXPECT_TRUE(refuses_views({-1}, "-1"));
  EXPECT_TRUE(refuses_views({4294967296}, "4294967296"));
  EXPECT_TRUE(refused("n_refills", [](CheckpointFile& file) { file.header["view_order"]["n_refills"] = -1; }));
}

TEST_F(ChangedCheckpoints, WithNegativeSumsAreRefused) {
  EXPECT_TRUE(refuses_tensor_value("adam_v.log_scales", -1)) << "a sum of squares";
  EXPECT_TRUE(refuses_tensor_value("statistics.grad_norm_sum", -1));
  EXPECT_TRUE(refuses_tensor_value("statistics.view_count", -1));
}

// Training removes such Gaussians once they are visible. The checkpoint may be older.
TEST_F(ChangedCheckpoints, WithAGaussianThatIsNotFiniteAreRead) {
  CheckpointFile file = read_checkpoint_file(path);
  for (auto& [name, tensor] : file.tensors) {
    tensor = tensor.clone();
    if (name == "gaussians.means" || name == "adam_v.means") tensor.view({-1})[3] = NAN;
  }
  write_checkpoint_file(folder / "other.b3dgs", file);
  const Checkpoint read = read_checkpoint(folder / "other.b3dgs", scene, torch::kCPU);
  EXPECT_TRUE(std::isnan(read.state.gaussians.means.view({-1})[3].item<float>()));
}

TEST_F(ChangedCheckpoints, NestedTooDeeplyAreRefused) {
  EXPECT_TRUE(refused("unexpected checkpoint header", [](CheckpointFile& file) {
    nlohmann::ordered_json deep = nlohmann::ordered_json::array();
    for (int i = 0; i < 1000; ++i) deep = nlohmann::ordered_json::array({std::move(deep)});
    file.header["kernel_selection"] = {{"forward", std::move(deep)}};
  }));
}

TEST_F(CheckpointFiles, HaveAHeaderThatCanBeReadAlone) {
  const auto header = read_checkpoint_header(path);
  EXPECT_EQ(header["iteration"], 42);
  EXPECT_EQ(header["n_gaussians"], 6);
  EXPECT_EQ(header["config"]["opacity_lr"], 0.033);
  EXPECT_EQ(header["tensors"].size(), 21u);
}

TEST(NewestCheckpoint, FallsBackToTheOneBeforeADamagedOne) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  const Scene scene = small_scene();
  EXPECT_TRUE(newest_valid_checkpoint(folder, {}).empty());
  for (const int iteration : {90, 100, 1000})
    write_checkpoint(folder.checkpoint(iteration), make_config(), make_state(scene), scene);
  EXPECT_EQ(newest_valid_checkpoint(folder, {}), folder.checkpoint(1000)) << "by number, not by name";
  fs::resize_file(folder.checkpoint(1000), fs::file_size(folder.checkpoint(1000)) - 100);
  std::vector<std::string> messages;
  EXPECT_EQ(newest_valid_checkpoint(folder, [&](const std::string& m) { messages.push_back(m); }),
            folder.checkpoint(100));
  ASSERT_EQ(messages.size(), 1u);
  EXPECT_NE(messages[0].find("iteration_1000.b3dgs: truncated"), std::string::npos) << messages[0];
}

TEST(OldCheckpoints, AreRemovedExceptTheNewestOfTheSameTraining) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  const Scene scene = small_scene();
  const OwnFiles own_files(folder.root());
  const auto write = [&](int iteration, const std::string& training_id) {
    TrainState state = make_state(scene);
    state.training_id = training_id;
    write_checkpoint(folder.checkpoint(iteration), make_config(), state, scene);
  };
  for (const int iteration : {10, 20, 30, 40, 60}) write(iteration, "ours");
  write(15, "");  // has no training ID
  write(25, "theirs");
  test::write_bytes(folder.checkpoint(5), "damaged");
  test::write_bytes(temp / "checkpoints/notes.txt", "");
  fs::copy_file(folder.checkpoint(10), folder.checkpoint(12));  // a copy made by the user
  remove_superseded_checkpoints(folder, "ours", 40, 2);
  EXPECT_EQ(folder.checkpoint_iterations(), (std::vector<int>{5, 12, 25, 30, 40, 60}));
  EXPECT_TRUE(fs::exists(temp / "checkpoints/notes.txt"));
}

TEST(OldCheckpoints, ThatWereRequestedAreKept) {
  const test::TempDir temp;
  const ModelFolder folder(temp.path());
  const Scene scene = small_scene();
  const OwnFiles own_files(folder.root());
  TrainConfig config = make_config();
  const auto write = [&](int iteration, int step_iterations) {
    TrainState state = make_state(scene);
    state.iteration = iteration;
    state.step_iterations = step_iterations;
    state.training_id = "ours";
    write_checkpoint(folder.checkpoint(iteration), config, state, scene);
  };
  config.checkpoint_iterations = {10, 18, 25, 50};
  for (const int iteration : {10, 15}) write(iteration, 1);
  write(20, 4);                             // 17 to 20
  write(28, 3);                             // 26 to 28
  config.checkpoint_iterations = {40, 50};  // resumed with other iterations
  for (const int iteration : {30, 40, 45, 50}) write(iteration, 1);
  remove_superseded_checkpoints(folder, "ours", 50, 2);
  EXPECT_EQ(folder.checkpoint_iterations(), (std::vector<int>{10, 20, 30, 40, 45, 50}));
}

TEST_F(CheckpointFiles, AreReadForASceneWithADifferentlyRoundedExtent) {
  Scene other = scene;
  other.extent *= 1 + 1e-9;
  EXPECT_EQ(read_checkpoint(path, other, torch::kCPU).state.iteration, 42);
  other.extent = scene.extent * (1 + 1e-5);
  EXPECT_TRUE(test::fails_with<InputError>({"extent"}, [&] { read_checkpoint(path, other, torch::kCPU); }));
}

TEST_F(CheckpointFiles, TellWhichPhotographsHaveChanged) {
  Scene with_files = scene;
  for (std::size_t i = 0; i < with_files.train.size(); ++i) {
    with_files.train[i].file = (folder / ("photo" + std::to_string(i))).string();
    test::write_bytes(with_files.train[i].file, std::string(100, static_cast<char>('a' + i)));
  }
  write_checkpoint(path, make_config(), make_state(scene), with_files);
  const nlohmann::ordered_json header = read_checkpoint_header(path);
  const auto changed = [&] { return scene_changes(header, scene_fingerprint(with_files)); };
  EXPECT_TRUE(changed().empty());
  test::write_bytes(with_files.train[1].file, std::string(100, 'x'));  // the same size
  ASSERT_EQ(changed().size(), 1u);
  EXPECT_NE(changed()[0].find(" photographs have changed"), std::string::npos) << changed()[0];
  EXPECT_NE(changed()[0].find(with_files.train[1].name), std::string::npos) << changed()[0];
  test::write_bytes(with_files.train[0].file, "short");
  fs::remove(with_files.train[2].file);
  ASSERT_EQ(changed().size(), 1u);
  EXPECT_NE(changed()[0].find("3 of "), std::string::npos) << changed()[0];
  EXPECT_EQ(read_checkpoint(path, with_files, torch::kCPU).state.iteration, 42)
      << "changed photographs are no reason to refuse";

  nlohmann::ordered_json early = header;
  early["scene"].erase("photographs");
  EXPECT_TRUE(scene_changes(early, scene_fingerprint(with_files)).empty());
}

TEST_F(CheckpointFiles, NoticeAnEditThatKeepsTheSizeOfAPhotograph) {
  // Without compression, a retouched pixel changes bytes in the middle of the file. With compression, it changes all
  // following bytes.
  for (const auto& [name, at] : {std::pair{"photo.bmp", 150000}, {"photo.TIF", 150000}, {"photo.jpg", 299999}}) {
    Scene with_file = scene;
    with_file.train[0].file = (folder / name).string();
    std::string bytes(300000, 'a');
    test::write_bytes(with_file.train[0].file, bytes);
    const nlohmann::ordered_json header{{"scene", scene_fingerprint(with_file)}};
    EXPECT_TRUE(scene_changes(header, scene_fingerprint(with_file)).empty()) << name;
    bytes[static_cast<std::size_t>(at)] = 'b';
    test::write_bytes(with_file.train[0].file, bytes);
    EXPECT_EQ(scene_changes(header, scene_fingerprint(with_file)).size(), 1u) << name;

    nlohmann::ordered_json early = header;  // has only the checksum of the first 64 KiB
    early["scene"]["photographs"][0].erase("rest_crc32");
    EXPECT_TRUE(scene_changes(early, scene_fingerprint(with_file)).empty()) << name;
    bytes[0] = 'b';
    test::write_bytes(with_file.train[0].file, bytes);
    EXPECT_EQ(scene_changes(early, scene_fingerprint(with_file)).size(), 1u) << name;
  }
}

TEST_F(CheckpointFiles, AreRefusedIfPosesOrIntrinsicsHaveChanged) {
  write_checkpoint(path, make_config(), make_state(scene), scene);
  const auto turn = [](Camera& camera) {
    auto quaternion = quaternion_from_rotation(camera.cam_from_world.rotation);
    quaternion[1] += 1e-3;
    camera.cam_from_world.rotation = rotation_from_quaternion(quaternion);
  };
  const std::function<void(Camera&)> changes[]{turn, [](Camera& camera) { camera.fx *= 1.001; },
                                               [](Camera& camera) { camera.cy += 0.5; }};
  for (const auto& change : changes) {
    Scene other = scene;  // of the same extent
    change(other.train[1].camera);
    EXPECT_TRUE(test::fails_with<InputError>({"poses or intrinsics of 1 of", scene.train[1].name, "train anew"},
                                             [&] { read_checkpoint(path, other, torch::kCPU); }));
  }
  Scene rounded = scene;
  for (View& view : rounded.train) view.camera.fx *= 1 + 1e-15;
  EXPECT_EQ(read_checkpoint(path, rounded, torch::kCPU).state.iteration, 42);
}

TEST_F(CheckpointFiles, TellWhetherThePointsHaveChanged) {
  nlohmann::ordered_json header{{"scene", scene_fingerprint(scene)}};
  EXPECT_TRUE(scene_changes(header, scene_fingerprint(scene)).empty());
  Scene other = scene;
  other.points.positions[5] += 1;
  EXPECT_FALSE(scene_changes(header, scene_fingerprint(other)).empty());
  header["scene"].erase("points_crc32");
  EXPECT_TRUE(scene_changes(header, scene_fingerprint(other)).empty()) << "what is not known has not changed";
}

TEST_F(CheckpointFiles, TellWhichMasksHaveChanged) {
  Scene masked = scene;
  masked.train[0].mask_file = (folder / "mask").string();
  test::write_bytes(masked.train[0].mask_file, "mask");
  write_checkpoint(path, make_config(), make_state(scene), masked);
  const nlohmann::ordered_json header = read_checkpoint_header(path);
  EXPECT_TRUE(scene_changes(header, scene_fingerprint(masked)).empty());
  const std::vector<std::string> changes = scene_changes(header, scene_fingerprint(scene));
  ASSERT_EQ(changes.size(), 1u);
  EXPECT_NE(changes[0].find("masks of 1 of"), std::string::npos) << changes[0];
  EXPECT_NE(changes[0].find(scene.train[0].name), std::string::npos) << changes[0];

  nlohmann::ordered_json early = header;
  early["scene"].erase("masks");
  EXPECT_TRUE(scene_changes(early, scene_fingerprint(masked)).empty()) << "what is not known has not changed";
}

TEST(CheckpointFileWriter, AcceptsTensorsInPiecesOfAnySize) {
  const test::TempDir temp;
  CheckpointFile content;
  content.header["iteration"] = 3;
  content.tensors = {{"a", torch::arange(7, torch::kFloat32)},
                     {"empty", torch::zeros({0, 3})},
                     {"b", torch::arange(6, torch::kInt32).view({2, 3})}};
  write_checkpoint_file(temp / "whole", content);
  std::string bytes;
  std::vector<TensorEntry> entries;
  for (const auto& [name, tensor] : content.tensors) {
    bytes.append(static_cast<const char*>(tensor.data_ptr()), tensor.nbytes());
    entries.push_back({name, tensor.scalar_type(), tensor.sizes().vec()});
  }
  for (const std::size_t piece : {std::size_t{1}, std::size_t{5}, bytes.size()}) {
    CheckpointFileWriter file(temp / "pieces", content.header, entries);
    for (std::size_t at = 0; at < bytes.size(); at += piece)
      file.append(bytes.data() + at, std::min(piece, bytes.size() - at));
    file.finish();
    file.commit();
    EXPECT_TRUE(test::same(test::read_bytes(temp / "pieces"), test::read_bytes(temp / "whole"))) << piece;
  }
  const CheckpointFile read = read_checkpoint_file(temp / "whole");
  EXPECT_EQ(read.header["iteration"], 3);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_TRUE(test::same(read.tensors[i].second, content.tensors[i].second));

  CheckpointFileWriter file(temp / "short", content.header, entries);
  file.append(bytes.data(), bytes.size() - 1);
  EXPECT_THROW(file.finish(), LogicError);
  EXPECT_THROW(file.append(bytes.data(), 2), LogicError);
}

}  // namespace
}  // namespace b3dgs
