// A program of several ranks for dist_tests: dist_rank RANKS SCENARIO. Without the environment of a launcher, it starts
// its own ranks. Prints faults to standard error and fails, or prints "ok RANK" to standard output.
#include <torch/types.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numeric>
#include <string>
#include <thread>
#include <vector>

#include "core/check.h"
#include "dist/communicator.h"
#include "dist/control/socket.h"
#include "dist/launch/start_ranks.h"
#include "support/rank_program.h"

namespace b3dgs {
namespace {

using test::expect;
using test::same_bytes;
using Counts = std::vector<std::int64_t>;

std::int64_t total(const Counts& counts) {
  return std::accumulate(counts.begin(), counts.end(), std::int64_t{0});
}

/// Returns bytes that identify their origin: row i that rank `from` sends to rank `to`. Every bit pattern occurs, also
/// those that are NaN as floats.
torch::Tensor make_rows(int from, int to, std::int64_t n, std::int64_t bytes) {
  torch::Tensor rows = torch::empty({n, bytes}, torch::kUInt8);
  std::uint32_t state = static_cast<std::uint32_t>(from * 1000 + to + 1);
  for (std::int64_t i = 0; i < rows.numel(); ++i) {
    state = state * 1664525u + 1013904223u;
    rows.data_ptr<std::uint8_t>()[i] = static_cast<std::uint8_t>(state >> 24);
  }
  return rows;
}

/// Returns rows of `type` with the bytes of make_rows(), 12 bytes per row.
torch::Tensor typed(const torch::Tensor& bytes, torch::ScalarType type) {
  const auto size = static_cast<std::int64_t>(torch::elementSize(type));
  torch::Tensor rows = torch::empty({bytes.size(0), 2, bytes.size(1) / size / 2}, type);
  if (rows.numel() > 0) std::memcpy(rows.data_ptr(), bytes.data_ptr(), static_cast<std::size_t>(bytes.numel()));
  return rows;
}

/// Checks an exchange in which count_of(from, to) rows go from each rank to each.
template <class CountOf>
void check_all_to_all(Communicator& ranks, const char* name, CountOf&& count_of) {
  for (const torch::ScalarType type : {torch::kFloat32, torch::kUInt8, torch::kInt32, torch::kInt64, torch::kBool}) {
    constexpr std::int64_t kBytes = 48;
    Counts send, receive;
    std::vector<torch::Tensor> sent, expected;
    for (int other = 0; other < ranks.size(); ++other) {
      send.push_back(count_of(ranks.rank(), other));
      receive.push_back(count_of(other, ranks.rank()));
      sent.push_back(make_rows(ranks.rank(), other, send.back(), kBytes));
      expected.push_back(make_rows(other, ranks.rank(), receive.back(), kBytes));
    }
    const torch::Tensor rows = typed(torch::cat(sent), type).to(ranks.device());
    const torch::Tensor received = ranks.all_to_all_rows(rows, send, receive).cpu();
    expect(received.scalar_type() == type && received.size(0) == total(receive), std::string(name) + ": shape");
    expect(same_bytes(received, torch::cat(expected)), std::string(name) + ": bytes");
  }
}

/// Checks the gathering of n + rank * n_more rows from each rank.
void check_all_gather(Communicator& ranks, std::int64_t n, std::int64_t n_more) {
  Counts counts;
  std::vector<torch::Tensor> expected;
  for (int rank = 0; rank < ranks.size(); ++rank) {
    counts.push_back(n + rank * n_more);
    expected.push_back(make_rows(rank, 7, counts.back(), 24));
  }
  const torch::Tensor own = typed(expected[static_cast<std::size_t>(ranks.rank())], torch::kFloat32);
  const torch::Tensor all = ranks.all_gather_rows(own.to(ranks.device()), counts).cpu();
  expect(all.size(0) == total(counts) && all.size(1) == 2, "gathered: shape");
  expect(same_bytes(all, torch::cat(expected)), "gathered: bytes");
}

void check_collectives(Communicator& ranks) {
  const int size = ranks.size(), rank = ranks.rank();
  const torch::Device& device = ranks.device();
  check_all_to_all(ranks, "uneven", [](int from, int to) { return 3 * from + 5 * to + 1; });
  check_all_to_all(ranks, "nothing at all", [](int, int) { return 0; });
  check_all_to_all(ranks, "only to the last rank", [&](int, int to) { return to == size - 1 ? 11 : 0; });
  check_all_to_all(ranks, "only from rank 0", [](int from, int) { return from == 0 ? 11 : 0; });
  check_all_to_all(ranks, "nothing to itself", [](int from, int to) { return from == to ? 0 : 4; });
  check_all_to_all(ranks, "many", [](int from, int to) { return 20000 + 1000 * from + to; });
  check_all_to_all(ranks, "in several messages", [](int from, int to) { return from < to ? 200000 : 0; });
  const auto ints = torch::TensorOptions(torch::kInt32).device(device);
  const torch::Tensor shifted = torch::arange(1 + 3 * ranks.size(), ints).narrow(0, 1, 3 * ranks.size());
  const torch::Tensor pairs = torch::stack({shifted, shifted}, 1).view({-1}).narrow(0, 1, 2 * ranks.size());
  const Counts ones(static_cast<std::size_t>(size), 1);  // rows of 8 bytes that begin at byte 4: not an int64
  expect(ranks.all_to_all_rows(pairs.view({size, 2}), ones, ones)
             .equal(pairs.view({size, 2}).narrow(0, rank, 1).expand({size, 2})),
         "rows at an odd address");
  const torch::Tensor odd = make_rows(0, 0, size, 7).to(device);  // rows of 7 bytes
  expect(ranks.all_to_all_rows(odd, ones, ones).equal(odd.narrow(0, rank, 1).expand({size, 7})), "rows of odd size");
  for (const std::int64_t n : {0, 1, 1000}) {
    for (const std::int64_t n_more : {0, 3}) check_all_gather(ranks, n, n_more);
  }

  expect(ranks.max("max", -rank) == 0, "maximum on the host");
  const std::vector<std::string> texts = ranks.exchange("texts", std::string(static_cast<std::size_t>(rank), 'x'));
  for (int r = 0; r < size; ++r) {
    expect(texts[static_cast<std::size_t>(r)] == std::string(static_cast<std::size_t>(r), 'x'), "texts");
  }
  for (int i = 0; i < 200; ++i) {
    const std::vector<int> records = ranks.exchange_record("many", i * 10 + rank);
    for (int r = 0; r < size; ++r) expect(records[static_cast<std::size_t>(r)] == i * 10 + r, "many small records");
  }
  ranks.barrier("end");
}

/// The operation in which ranks other than the failing one wait for it.
void wait_in(const std::string& operation, Communicator& ranks) {
  const auto n = static_cast<std::size_t>(ranks.size());
  if (operation == "exchange") {
    ranks.barrier("wait");
  } else if (operation == "tensors") {
    ranks.all_to_all_rows(torch::zeros({ranks.size(), 3}), Counts(n, 1), Counts(n, 1));
  } else {
    std::this_thread::sleep_for(std::chrono::hours(1));  // "elsewhere": not in a function of Communicator
  }
}

void run_scenario(const std::string& scenario, Communicator& ranks) {
  const std::size_t colon = scenario.find(':');
  const std::string what = scenario.substr(0, colon),
                    operation = colon == std::string::npos ? "" : scenario.substr(colon + 1);
  const bool is_failing = ranks.rank() == (what == "kill0" ? 0 : ranks.size() - 1);
  if (what == "collectives") {
    check_collectives(ranks);
  } else if (what == "kill" || what == "kill0") {
    ranks.barrier("start");
    if (is_failing) raise(SIGKILL);
    wait_in(operation, ranks);
  } else if (what == "throw") {
    ranks.barrier("start");
    if (is_failing) throw InputError("the disk is full\nand more");
    wait_in(operation, ranks);
  } else if (what == "silent") {
    ranks.barrier("start");
    if (is_failing) raise(SIGSTOP);
    wait_in(operation, ranks);
  } else if (what == "exit") {
    ranks.barrier("start");
    if (is_failing) std::_Exit(3);
    raise(SIGPIPE);  // as if writing to a connection that the other rank has closed
    wait_in(operation, ranks);
  } else if (what == "wait") {  // waits for a signal, and leaves files in the folder that `operation` names
    static volatile std::sig_atomic_t got = 0;
    std::signal(SIGTERM, [](int signal) { got = signal; });
    const std::string name = operation + "/" + std::to_string(ranks.rank());
    std::ofstream(name + ".ready").put('1');
    while (got == 0) usleep(10000);
    std::ofstream(name + ".stopped").put('1');
    ranks.barrier("all have stopped");
    throw test::Exit{128 + got};
  } else {
    throw LogicError("unknown scenario " + scenario);
  }
}

void read_limit(const char* name, std::chrono::milliseconds& limit) {
  if (const char* const value = std::getenv(name)) limit = std::chrono::milliseconds(std::atoi(value));
}

/// Starts ranks with the environment of torchrun, whose agent listens at MASTER_PORT.
int start_as_torchrun(int size) {
  const Socket agent = listen_at("127.0.0.1", 0);
  std::error_code error;
  const std::string program = std::filesystem::read_symlink("/proc/self/exe", error).string();
  StartOptions start;
  start.program = "/usr/bin/env";
  return start_ranks(size,
                     {"-u", "B3DGS_JOB", "-u", "B3DGS_LISTENING_SOCKET", "TORCHELASTIC_RUN_ID=test",
                      "TORCHELASTIC_RESTART_COUNT=2", "TORCHELASTIC_USE_AGENT_STORE=True",
                      "MASTER_PORT=" + std::to_string(port_of(agent)), program, std::to_string(size), "collectives"},
                     start);
}

int run(int size, const std::string& scenario) {
  if (scenario == "agent" && std::getenv("RANK") == nullptr) return start_as_torchrun(size);
  if (scenario == "wrong size" && std::getenv("RANK") != nullptr && std::atoi(std::getenv("RANK")) == size - 1) {
    setenv("WORLD_SIZE", std::to_string(size + 1).c_str(), 1);
  }
  if (scenario == "missing" && std::getenv("RANK") != nullptr && std::atoi(std::getenv("RANK")) == size - 1) return 0;
  test::RankProgram program;
  program.size = size;
  program.arguments = {std::to_string(size), scenario};
  program.body = [&](Communicator& ranks) { run_scenario(scenario, ranks); };
  read_limit("TEST_GRACE_MS", program.start.grace);
  read_limit("TEST_JOIN_MS", program.limits.join);
  read_limit("TEST_SILENCE_MS", program.limits.silence);
  read_limit("TEST_STUCK_MS", program.limits.stuck);
  return test::run_rank_program(program);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  return b3dgs::test::report_errors([&] { return b3dgs::run(std::atoi(argv[1]), argv[2]); });
}
