// How evenly several ranks share the work of training, and what they exchange and wait for.
#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

namespace b3dgs {

/// Parts of a step, in the order of the figures. The device's time, or the host's where the device waits for it.
enum class StepPhase {
  kProject,  // own Gaussians for all views, and what is planned before
  kRecord,   // the exchange on the host
  kSplats,   // exchange: splats to the ranks that draw
  kDraw,     // photograph, forward pass, loss, backward pass to the splats
  kRows,     // exchange: rows of images, with bands
  kSums,     // exchange: sums and scores to the owners
  kLearn,    // statistics and the Adam step of own Gaussians
};
inline constexpr std::array<const char*, 7> kStepPhaseNames{"project", "record", "splats", "draw",
                                                            "rows",    "sums",   "learn"};
inline constexpr bool is_exchange(StepPhase phase) {
  return phase == StepPhase::kRecord || phase == StepPhase::kSplats || phase == StepPhase::kRows ||
         phase == StepPhase::kSums;
}

/// Parts of a round of density control.
enum class RoundPhase {
  kGather,  // exchange: what the round reads of all Gaussians
  kPlan,
  kEdit,  // exchange: rows to their owners
};
inline constexpr std::array<const char*, 3> kRoundPhaseNames{"gather", "plan", "edit"};

/// What one rank has done in this session.
struct RankTotals {
  std::int64_t sent_bytes = 0, received_bytes = 0;  // to and from other ranks: splats, and what is summed for them
  // Of the steps that were timed and that its device has finished:
  std::int64_t n_timed = 0;
  double exchange_ms = 0;  // in exchanges, including the wait for other ranks
  double step_ms = 0;
  std::array<double, kStepPhaseNames.size()> phase_ms{};
  // Of all rounds of density control that its device has finished:
  std::int64_t n_rounds = 0;
  double round_ms = 0;
  std::array<double, kRoundPhaseNames.size()> round_phase_ms{};
};

/// Means per step. Vectors have an element for each rank.
struct RankFigures {
  std::int64_t n_steps = 0;
  std::vector<double> entries;  // list entries up to the last one that each pixel blends, of the views drawn
  std::vector<double> sent_bytes, received_bytes;
  double busiest = 1;        // entries of the rank that has most of them in a step, as a multiple of the ranks' mean
  double busiest_equal = 1;  // the same with equal_drawers(), or in bands of equally many rows
  // Of the steps that were timed; empty if none was:
  std::vector<double> exchange_ms;  // in exchanges, including the wait for other ranks
  std::vector<double> wait_ms;      // what of it is more than on the rank that spends least in exchanges
  std::array<std::vector<double>, kStepPhaseNames.size()> phase_ms;
  double step_ms = 0;  // of the slowest rank
  // Rounds of density control; means per round.
  std::int64_t n_rounds = 0;
  std::vector<double> round_ms;
  std::array<std::vector<double>, kRoundPhaseNames.size()> round_phase_ms;

  /// Mean over the ranks of the part of a step that they wait for each other; 0 if no step was timed.
  double wait_share() const;
  /// Mean over the ranks of the part of a step that they exchange, including waits.
  double exchange_share() const;
  /// Bytes that all ranks send in a step.
  double bytes_per_step() const;
};

nlohmann::ordered_json to_json(const RankFigures& figures);

/// "busiest 1.07 x the mean (1.21 x in equal parts), waits 3 %, exchanged 8.1 MB per step"
std::string describe(const RankFigures& figures);

/// "1.30 ms: project 0.21, record 0.05, splats 0.12, draw 0.55, sums 0.12, learn 0.18", without phases that took no
/// time; means over the ranks. Empty if no step was timed.
std::string describe_steps(const RankFigures& figures);
/// "gather 0.8, plan 0.5, edit 2.1 ms each", likewise. Empty if there was no round.
std::string describe_rounds(const RankFigures& figures);

class RankLoad {
 public:
  explicit RankLoad(int n_ranks) : since_(static_cast<std::size_t>(n_ranks)), whole_(since_) {}

  /// A step's list entries by rank: as it was done, and as equal_drawers() would have it.
  void add_step(const std::vector<std::int64_t>& entries, const std::vector<std::int64_t>& equal_entries);
  /// The ranks' totals at this moment.
  void set_totals(const std::vector<RankTotals>& totals) { totals_ = totals; }

  /// Figures of the steps since the last call; nothing if there were none.
  std::optional<RankFigures> take();
  /// Figures of all steps; nothing if there were none.
  std::optional<RankFigures> whole() const;

  /// Once, if one process would take at most `kWorthwhile` times as long as the ranks: a line for the user. Nothing
  /// before `n_timed` steps have been timed. `unit` is "GPU" or "process".
  std::optional<std::string> advise(std::int64_t n_timed, const char* unit);
  static constexpr double kWorthwhile = 1.25;

 private:
  struct Sums {
    explicit Sums(std::size_t n_ranks) : entries(n_ranks), from(n_ranks) {}
    std::int64_t n_steps = 0;
    std::vector<double> entries;
    double most = 0, most_equal = 0, mean = 0;
    std::vector<RankTotals> from;  // where the steps begin
  };
  RankFigures figures(const Sums& sums) const;
  void add_rounds(const Sums& sums, RankFigures& figures) const;

  Sums since_, whole_;
  std::vector<RankTotals> totals_;
  bool has_advised_ = false;
};

}  // namespace b3dgs
