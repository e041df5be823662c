// b3dgs bench exchange: times what several processes exchange, with the functions that training uses (src/dist).
#include <torch/cuda.h>
#include <torch/types.h>

#include <algorithm>
#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include "app/bench/bench_report.h"
#include "app/ranks/rank_setup.h"
#include "app/status/status_line.h"
#include "app/tools/commands.h"
#include "core/check.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "dist/communicator.h"
#include "dist/launch/start_ranks.h"

namespace b3dgs {
namespace {

using Counts = std::vector<std::int64_t>;

struct ExchangeConfig {
  int ranks = 0;
  std::string device = "auto";
  std::vector<double> mib{1, 4, 16, 64};
  int repeat = 9;
  std::string json;
};

template <class Visitor>
void visit_fields(ExchangeConfig& c, Visitor&& field) {
  field(Option{"ranks"}, c.ranks, InRange{0, kMaxStartedRanks},
        "processes to start on this machine (0 = those that torchrun, mpirun or srun started)");
  field(Option{"device"}, c.device, OneOf{{"auto", "cpu", "cuda"}},
        "cuda: GPUs, shared if there are fewer than ranks; auto: the CPU in that case");
  field(Option{"mib"}, c.mib, InRange{0.001, 4096},
        "MiB that each rank sends to each other rank; a line for each value");
  field(Option{"repeat"}, c.repeat, InRange{1, 10000}, "timed repetitions after one that is checked");
  field(Option{"json"}, c.json, Any{}, "also write all numbers to this file");
}

constexpr std::int64_t kRowBytes = 64;  // 16 floats, about a splat

void wait_for(const torch::Device& device) {
  if (device.is_cuda()) torch::cuda::synchronize(device.index());
}

/// Rows of floats that depend on where they come from and go to.
torch::Tensor make_rows(int from, int to, std::int64_t n, const torch::Device& device) {
  const auto options = torch::TensorOptions().dtype(torch::kInt32).device(device);
  const torch::Tensor values = torch::arange(n * (kRowBytes / 4), options) + (from * 1024 + to) * 8191;
  return values.view({n, kRowBytes / 4});
}

struct Operation {
  const char* name;
  std::function<torch::Tensor()> run;
  torch::Tensor expected;
};

Operation make_all_to_all(Communicator& ranks, std::int64_t n, const torch::Device& device) {
  Counts counts;  // sent to each rank, and received from it
  std::vector<torch::Tensor> sent, expected;
  for (int other = 0; other < ranks.size(); ++other) {
    if (other == ranks.rank()) {
      counts.push_back(0);
      continue;
    }
    counts.push_back(n);
    sent.push_back(make_rows(ranks.rank(), other, n, device));
    expected.push_back(make_rows(other, ranks.rank(), n, device));
  }
  const torch::Tensor rows = torch::cat(sent);
  return {"all-to-all", [&ranks, rows, counts] { return ranks.all_to_all_rows(rows, counts, counts); },
          torch::cat(expected)};
}

Operation make_all_gather(Communicator& ranks, std::int64_t n, const torch::Device& device) {
  std::vector<torch::Tensor> expected;
  expected.reserve(static_cast<std::size_t>(ranks.size()));
  for (int rank = 0; rank < ranks.size(); ++rank) expected.push_back(make_rows(rank, 0, n, device));
  const torch::Tensor rows = expected[static_cast<std::size_t>(ranks.rank())].clone();
  return {"all-gather", [&ranks, rows] { return ranks.all_gather_rows(rows); }, torch::cat(expected)};
}

/// Times of the slowest rank, from a common start until the results are there. The first run is not timed.
Timing time_on_all(Communicator& ranks, const torch::Device& device, int repeat, const std::function<void()>& run) {
  std::vector<double> ms;
  for (int i = 0; i <= repeat; ++i) {
    wait_for(device);
    ranks.barrier("start");
    const double start_s = steady_seconds();
    run();
    wait_for(device);
    const double own_ms = 1000 * (steady_seconds() - start_s);
    const std::vector<double> all_ms = ranks.exchange_record("time", own_ms);
    if (i > 0) ms.push_back(*std::max_element(all_ms.begin(), all_ms.end()));
  }
  return summarize(ms);
}

void time_exchanges(Communicator& ranks, const ExchangeConfig& config, const RankPlace& place,
                    const torch::Device& device) {
  BenchFile file(ranks.is_first() ? config.json : "");
  nlohmann::ordered_json rows;
  if (ranks.is_first()) {
    std::printf("%d ranks, %s, %s; results checked\n", ranks.size(), describe_transport(ranks).c_str(),
                place.launcher.c_str());
    std::printf("%-12s %10s %10s %23s %12s\n", "exchange", "MiB", "median ms", "min .. max", "GB/s a rank");
    file.set("ranks", ranks.size());
    file.set("device", ranks.device().is_cuda() ? "cuda" : "cpu");
    file.set("transport", name_of(ranks.transport()));
  }
  // `mib`: what a rank sends to each other; `received`: bytes that each rank receives from others, 0 for a record
  const auto add = [&](const char* name, double mib, std::int64_t received, const Timing& timing) {
    if (!ranks.is_first()) return;
    const bool is_record = received == 0;
    const std::string size = is_record ? "-" : print_to_string("%g", mib);
    const std::string rate =
        is_record ? "-" : print_to_string("%.2f", 1e-6 * static_cast<double>(received) / timing.median_ms);
    std::printf("%-12s %10s %10.3f %10.3f .. %9.3f %12s\n", name, size.c_str(), timing.median_ms, timing.min_ms,
                timing.max_ms, rate.c_str());
    rows.push_back(to_json(timing, {{"exchange", name}, {"mib", mib}, {"received_bytes", received}}));
    file.set("rows", rows);
  };
  add("record", 0, 0,
      time_on_all(ranks, torch::kCPU, config.repeat, [&] { ranks.exchange_record("record", std::int64_t{1}); }));
  for (const auto make : {make_all_to_all, make_all_gather}) {
    for (const double mib : config.mib) {
      const auto n = std::max<std::int64_t>(1, static_cast<std::int64_t>(mib * (1 << 20) / kRowBytes));
      const Operation operation = make(ranks, n, device);
      const bool is_right = operation.run().equal(operation.expected);
      if (!is_right) throw LogicError(std::string(operation.name) + ": wrong bytes received");
      const Timing timing = time_on_all(ranks, device, config.repeat, [&] { operation.run(); });
      add(operation.name, mib, (ranks.size() - 1) * n * kRowBytes, timing);
    }
  }
}

}  // namespace

int run_bench_exchange(const std::vector<std::string>& words) {
  ExchangeConfig config;
  CommandLine line("bench exchange",
                   "Time what several processes exchange, on one machine (--ranks) or started by torchrun, mpirun or "
                   "srun: a small record on the host, an all-to-all, and an all-gather. Times are those of the slowest "
                   "rank.",
                   "b3dgs bench exchange --ranks 2");
  line.add(config, "Benchmark");
  if (!line.parse(words)) return 0;
  if (config.mib.empty()) input_error("--mib needs at least one value");
  if (config.device == "auto" && config.ranks > count_gpus()) config.device = "cpu";
  RankOptions options;
  options.ranks = config.ranks;
  const RankPlan plan = plan_ranks(options, config.device);
  if (plan.n_to_start > 0) {
    std::vector<std::string> all{"bench", "exchange"};
    all.insert(all.end(), words.begin(), words.end());
    return start_ranks(plan.n_to_start, all);
  }
  if (plan.place.size == 1) input_error("bench exchange needs at least two ranks: add --ranks 2");

  const JoinedRank joined = join_ranks(plan);
  run_as_rank(*joined.ranks, [&] { time_exchanges(*joined.ranks, config, plan.place, joined.device); });
  return 0;
}

}  // namespace b3dgs
