// Tests how a process determines its rank, with valid and invalid environments of three launchers.
#include <gtest/gtest.h>

#include <map>
#include <string>

#include "core/check.h"
#include "dist/launch/start_ranks.h"
#include "support/expect_error.h"

namespace b3dgs {
namespace {

using Values = std::map<std::string, std::string>;

Environment environment(const Values& values) {
  return [&values](const char* name) -> const char* {
    const auto found = values.find(name);
    return found == values.end() ? nullptr : found->second.c_str();
  };
}

std::optional<RankPlace> read(const Values& values) {
  return read_rank_place(environment(values));
}

testing::AssertionResult is_refused(const Values& values, std::initializer_list<std::string> parts) {
  return test::fails_with<InputError>(parts, [&] { read(values); });
}

Values with(Values values, const Values& changes) {
  for (const auto& [name, value] : changes) values[name] = value;
  return values;
}

const Values kTorchrun{{"RANK", "5"},
                       {"WORLD_SIZE", "8"},
                       {"LOCAL_RANK", "1"},
                       {"MASTER_ADDR", "node0"},
                       {"MASTER_PORT", "29511"},
                       {"TORCHELASTIC_RUN_ID", "42"},
                       {"TORCHELASTIC_RESTART_COUNT", "3"},
                       {"TORCHELASTIC_USE_AGENT_STORE", "True"}};
const Values kMpirun{{"OMPI_COMM_WORLD_RANK", "2"},
                     {"OMPI_COMM_WORLD_SIZE", "4"},
                     {"OMPI_COMM_WORLD_LOCAL_RANK", "2"},
                     {"OMPI_COMM_WORLD_LOCAL_SIZE", "4"},
                     {"PMIX_NAMESPACE", "prterun-1"}};
const Values kSrun{{"SLURM_PROCID", "3"},  {"SLURM_STEP_ID", "0"},  {"SLURM_NTASKS", "4"},
                   {"SLURM_LOCALID", "1"}, {"SLURM_JOB_ID", "777"}, {"SLURM_STEP_NUM_NODES", "2"},
                   {"MASTER_ADDR", "n1"}};
const Values kByHand{
    {"RANK", "1"}, {"WORLD_SIZE", "2"}, {"LOCAL_RANK", "1"}, {"MASTER_ADDR", "10.0.0.1"}, {"MASTER_PORT", "1234"}};

TEST(RankPlace, WithoutLauncher) {
  EXPECT_FALSE(read({}));
  EXPECT_FALSE(read({{"RANK", ""}, {"MASTER_ADDR", "10.0.0.1"}}));
}

TEST(RankPlace, OfTorchrun) {
  const RankPlace place = *read(kTorchrun);
  EXPECT_EQ(place.launcher, "torchrun");
  EXPECT_EQ(place.rank, 5);
  EXPECT_EQ(place.size, 8);
  EXPECT_EQ(place.local_rank, 1);
  EXPECT_EQ(place.address, "node0");
  EXPECT_EQ(place.port, 20586) << "at MASTER_PORT, torchrun's agent listens";
  EXPECT_EQ(place.job, "42/29511");
  EXPECT_EQ(read(with(kTorchrun, {{"TORCHELASTIC_USE_AGENT_STORE", "False"}}))->port, 29511);
}

TEST(RankPlace, EachJobHasAPortOfItsOwn) {
  const auto port_of = [](const Values& values, const Values& changes) { return read(with(values, changes))->port; };
  const Values other_rank{{"RANK", "1"}, {"LOCAL_RANK", "0"}, {"TORCHELASTIC_RESTART_COUNT", "0"}};
  EXPECT_EQ(port_of(kTorchrun, other_rank), port_of(kTorchrun, {})) << "agents may count restarts differently";
  EXPECT_NE(port_of(kTorchrun, {{"MASTER_PORT", "29512"}}), port_of(kTorchrun, {}));
  EXPECT_EQ(port_of(kSrun, {{"SLURM_PROCID", "2"}}), port_of(kSrun, {}));
  EXPECT_NE(port_of(kSrun, {{"SLURM_STEP_ID", "1"}}), port_of(kSrun, {})) << "another step of the allocation";
  EXPECT_NE(port_of(kMpirun, {{"PMIX_NAMESPACE", "prterun-2"}}), port_of(kMpirun, {}));
  EXPECT_EQ(port_of(kMpirun, {{"PMIX_NAMESPACE", ""}}), 29500);
  for (const Values& launcher : {kSrun, kMpirun}) {
    EXPECT_EQ(port_of(launcher, {{"MASTER_PORT", "3000"}}), 3000);
    EXPECT_GE(port_of(launcher, {}), 20000);
    EXPECT_LT(port_of(launcher, {}), 29000);
  }
}

TEST(RankPlace, OfMpirun) {
  const RankPlace place = *read(kMpirun);
  EXPECT_EQ(place.launcher, "mpirun");
  EXPECT_EQ(place.rank, 2);
  EXPECT_EQ(place.size, 4);
  EXPECT_EQ(place.local_rank, 2);
  EXPECT_EQ(place.address, "127.0.0.1");
  EXPECT_EQ(place.job, "prterun-1");
  const Values several = with(kMpirun, {{"OMPI_COMM_WORLD_LOCAL_SIZE", "3"}});
  EXPECT_TRUE(is_refused(several, {"MASTER_ADDR is not set", "mpirun", "several machines"}));
  EXPECT_EQ(read(with(several, {{"MASTER_ADDR", "n1"}, {"MASTER_PORT", "3000"}}))->address, "n1");
}

TEST(RankPlace, OfSrun) {
  const RankPlace place = *read(kSrun);
  EXPECT_EQ(place.launcher, "srun");
  EXPECT_EQ(place.rank, 3);
  EXPECT_EQ(place.size, 4);
  EXPECT_EQ(place.local_rank, 1);
  EXPECT_EQ(place.address, "n1");
  EXPECT_EQ(place.job, "777.0");
  EXPECT_TRUE(is_refused(with(kSrun, {{"MASTER_ADDR", ""}}), {"MASTER_ADDR is not set", "srun"}));
  EXPECT_EQ(read(with(kSrun, {{"SLURM_STEP_NUM_TASKS", "16"}}))->size, 16) << "a step may have fewer or more tasks";
}

TEST(RankPlace, ABatchScriptOfSlurmIsNoRank) {
  Values script = kSrun;
  script.erase("SLURM_STEP_ID");
  EXPECT_FALSE(read(script));
}

TEST(RankPlace, SetByHand) {
  const RankPlace place = *read(kByHand);
  EXPECT_EQ(place.rank, 1);
  EXPECT_EQ(place.address, "10.0.0.1");
  EXPECT_EQ(place.port, 1234);
  EXPECT_EQ(place.job, "");
}

TEST(RankPlace, NamesWhatIsMissing) {
  for (const char* const name : {"RANK", "WORLD_SIZE", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT"}) {
    Values values = kByHand;
    values.erase(name);
    EXPECT_TRUE(is_refused(values, {std::string(name) + " is not set"}));
  }
  Values values = kMpirun;
  values.erase("OMPI_COMM_WORLD_SIZE");
  EXPECT_TRUE(is_refused(values, {"OMPI_COMM_WORLD_SIZE is not set", "mpirun"}));
}

TEST(RankPlace, NamesWhatIsMalformed) {
  EXPECT_TRUE(is_refused(with(kByHand, {{"WORLD_SIZE", "two"}}), {"WORLD_SIZE", "whole number", "\"two\""}));
  EXPECT_TRUE(is_refused(with(kByHand, {{"WORLD_SIZE", "0"}}), {"WORLD_SIZE", "from 1", "\"0\""}));
  EXPECT_TRUE(is_refused(with(kByHand, {{"RANK", "1 "}}), {"RANK", "\"1 \""}));
  EXPECT_TRUE(is_refused(with(kByHand, {{"RANK", "-1"}}), {"RANK", "\"-1\""}));
  EXPECT_TRUE(is_refused(with(kByHand, {{"MASTER_PORT", "99999"}}), {"MASTER_PORT", "65535"}));
  EXPECT_TRUE(is_refused(with(kByHand, {{"MASTER_PORT", "1\n2"}}), {"MASTER_PORT", "1?2"}));
}

TEST(RankPlace, NamesContradictions) {
  EXPECT_TRUE(is_refused(with(kByHand, {{"RANK", "2"}}), {"RANK=2", "WORLD_SIZE=2"}));
  EXPECT_TRUE(is_refused(with(kByHand, {{"LOCAL_RANK", "2"}}), {"LOCAL_RANK=2", "RANK=1"}));
  EXPECT_TRUE(is_refused(with(kMpirun, kByHand), {"RANK=1 of WORLD_SIZE=2", "OMPI_COMM_WORLD_RANK=2"}));
}

TEST(RankPlace, OfTheInnermostLauncher) {
  EXPECT_EQ(read(with(kSrun, kTorchrun))->rank, 5) << "srun started torchrun";
  EXPECT_EQ(read(with(kMpirun, kTorchrun))->rank, 5) << "mpirun started torchrun";
  const Values own = with(kByHand, {{"B3DGS_JOB", "ab"}, {"B3DGS_LISTENING_SOCKET", "5"}});
  const RankPlace place = *read(with(kMpirun, own));
  EXPECT_EQ(place.rank, 1);
  EXPECT_EQ(place.job, "ab");
  EXPECT_EQ(place.listening_socket, 5);
}

TEST(RankPlace, RequestedNumber) {
  EXPECT_EQ(choose_rank_place(0, environment({}))->size, 1);
  EXPECT_EQ(choose_rank_place(1, environment({}))->size, 1);
  EXPECT_FALSE(choose_rank_place(2, environment({}))) << "the program starts them";
  EXPECT_EQ(choose_rank_place(0, environment(kMpirun))->rank, 2);
  EXPECT_EQ(choose_rank_place(4, environment(kMpirun))->rank, 2);
  EXPECT_TRUE(test::fails_with<InputError>({"2 ranks requested", "mpirun started 4"},
                                           [] { choose_rank_place(2, environment(kMpirun)); }));
}

}  // namespace
}  // namespace b3dgs
