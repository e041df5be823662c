#include "train/ranks/rank_load.h"

#include <algorithm>
#include <numeric>

#include "core/check.h"
#include "core/print.h"
#include "core/text.h"

namespace b3dgs {
namespace {

double mean_of(const std::vector<double>& values) {
  return values.empty() ? 0 : std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

double most_of(const std::vector<std::int64_t>& values) {
  return static_cast<double>(*std::max_element(values.begin(), values.end()));
}

/// {"project": [0.1, 0.12], ...}: a value for each rank.
template <std::size_t kCount>
nlohmann::ordered_json phases_json(const std::array<const char*, kCount>& names,
                                   const std::array<std::vector<double>, kCount>& ms) {
  nlohmann::ordered_json json = nlohmann::ordered_json::object();
  for (std::size_t i = 0; i < kCount; ++i) json[names[i]] = ms[i];
  return json;
}

/// "project 0.11, record 0.02": means over the ranks.
template <std::size_t kCount>
std::string phases_text(const std::array<const char*, kCount>& names, const std::array<std::vector<double>, kCount>& ms,
                        const char* format) {
  std::string text;
  for (std::size_t i = 0; i < kCount; ++i) {
    if (mean_of(ms[i]) > 0) text += (text.empty() ? "" : ", ") + print_to_string(format, names[i], mean_of(ms[i]));
  }
  return text;
}

}  // namespace

double RankFigures::wait_share() const {
  return step_ms > 0 ? mean_of(wait_ms) / step_ms : 0;
}

double RankFigures::exchange_share() const {
  return step_ms > 0 ? mean_of(exchange_ms) / step_ms : 0;
}

double RankFigures::bytes_per_step() const {
  return std::accumulate(sent_bytes.begin(), sent_bytes.end(), 0.0);
}

nlohmann::ordered_json to_json(const RankFigures& figures) {
  nlohmann::ordered_json json{{"steps", figures.n_steps},         {"entries", figures.entries},
                              {"busiest", figures.busiest},       {"busiest_equal", figures.busiest_equal},
                              {"sent_bytes", figures.sent_bytes}, {"received_bytes", figures.received_bytes}};
  if (!figures.exchange_ms.empty()) {
    json["exchange_ms"] = figures.exchange_ms;
    json["wait_ms"] = figures.wait_ms;
    json["step_ms"] = figures.step_ms;
    json["phases_ms"] = phases_json(kStepPhaseNames, figures.phase_ms);
  }
  if (figures.n_rounds > 0) {
    json["rounds"] = figures.n_rounds;
    json["round_ms"] = figures.round_ms;
    json["round_phases_ms"] = phases_json(kRoundPhaseNames, figures.round_phase_ms);
  }
  return json;
}

std::string describe(const RankFigures& figures) {
  std::string text =
      print_to_string("busiest %.2f x the mean (%.2f x in equal parts)", figures.busiest, figures.busiest_equal);
  if (!figures.exchange_ms.empty()) text += print_to_string(", waits %.0f %%", 100 * figures.wait_share());
  return text + ", exchanged " + format_bytes(static_cast<std::int64_t>(figures.bytes_per_step())) + " per step";
}

std::string describe_steps(const RankFigures& figures) {
  if (figures.exchange_ms.empty()) return "";
  return print_to_string("%.2f ms: ", figures.step_ms) + phases_text(kStepPhaseNames, figures.phase_ms, "%s %.2f");
}

std::string describe_rounds(const RankFigures& figures) {
  if (figures.n_rounds == 0) return "";
  return phases_text(kRoundPhaseNames, figures.round_phase_ms, "%s %.1f") + " ms each";
}

void RankLoad::add_step(const std::vector<std::int64_t>& entries, const std::vector<std::int64_t>& equal_entries) {
  B3DGS_CHECK(entries.size() == since_.entries.size() && equal_entries.size() == entries.size(), "work of ",
              entries.size(), " ranks of ", since_.entries.size());
  for (Sums* sums : {&since_, &whole_}) {
    ++sums->n_steps;
    for (std::size_t r = 0; r < entries.size(); ++r) {
      sums->entries[r] += static_cast<double>(entries[r]);
      sums->mean += static_cast<double>(entries[r]) / static_cast<double>(entries.size());
    }
    sums->most += most_of(entries);
    sums->most_equal += most_of(equal_entries);
  }
}

RankFigures RankLoad::figures(const Sums& sums) const {
  RankFigures figures;
  figures.n_steps = sums.n_steps;
  const auto n_steps = static_cast<double>(sums.n_steps);
  for (const double entries : sums.entries) figures.entries.push_back(entries / n_steps);
  if (sums.mean > 0) {
    figures.busiest = sums.most / sums.mean;
    figures.busiest_equal = sums.most_equal / sums.mean;
  }
  if (totals_.empty()) return figures;
  add_rounds(sums, figures);
  for (std::size_t r = 0; r < totals_.size(); ++r) {
    const RankTotals &now = totals_[r], &from = sums.from[r];
    figures.sent_bytes.push_back(static_cast<double>(now.sent_bytes - from.sent_bytes) / n_steps);
    figures.received_bytes.push_back(static_cast<double>(now.received_bytes - from.received_bytes) / n_steps);
    if (now.n_timed <= from.n_timed) continue;
    const auto n_timed = static_cast<double>(now.n_timed - from.n_timed);
    figures.exchange_ms.push_back((now.exchange_ms - from.exchange_ms) / n_timed);
    figures.step_ms = std::max(figures.step_ms, (now.step_ms - from.step_ms) / n_timed);
    for (std::size_t i = 0; i < now.phase_ms.size(); ++i) {
      figures.phase_ms[i].push_back((now.phase_ms[i] - from.phase_ms[i]) / n_timed);
    }
  }
  if (figures.exchange_ms.size() < totals_.size()) {
    figures.exchange_ms.clear();
    for (std::vector<double>& ms : figures.phase_ms) ms.clear();
    return figures;
  }
  const double least = *std::min_element(figures.exchange_ms.begin(), figures.exchange_ms.end());
  for (const double ms : figures.exchange_ms) figures.wait_ms.push_back(ms - least);
  return figures;
}

void RankLoad::add_rounds(const Sums& sums, RankFigures& figures) const {
  // Ranks take part in the same rounds, but the times of the last one may not be known on all of them yet.
  for (std::size_t r = 0; r < totals_.size(); ++r) {
    const std::int64_t n = totals_[r].n_rounds - sums.from[r].n_rounds;
    if (n == 0) {
      figures.n_rounds = 0;
      return;
    }
    figures.n_rounds = r == 0 ? n : std::min(figures.n_rounds, n);
  }
  for (std::size_t r = 0; r < totals_.size(); ++r) {
    const RankTotals &now = totals_[r], &from = sums.from[r];
    const auto n = static_cast<double>(now.n_rounds - from.n_rounds);
    figures.round_ms.push_back((now.round_ms - from.round_ms) / n);
    for (std::size_t i = 0; i < now.round_phase_ms.size(); ++i) {
      figures.round_phase_ms[i].push_back((now.round_phase_ms[i] - from.round_phase_ms[i]) / n);
    }
  }
}

std::optional<RankFigures> RankLoad::take() {
  if (since_.n_steps == 0) return std::nullopt;
  RankFigures taken = figures(since_);
  since_ = Sums(since_.entries.size());
  if (!totals_.empty()) since_.from = totals_;
  return taken;
}

std::optional<RankFigures> RankLoad::whole() const {
  if (whole_.n_steps == 0) return std::nullopt;
  return figures(whole_);
}

std::optional<std::string> RankLoad::advise(std::int64_t n_timed, const char* unit) {
  if (has_advised_ || totals_.empty() || totals_[0].n_timed < n_timed) return std::nullopt;
  has_advised_ = true;
  const std::optional<RankFigures> all = whole();
  if (!all || all->exchange_ms.empty()) return std::nullopt;
  // One process does the work of all ranks, one after the other, and exchanges nothing.
  double alone_ms = 0;
  for (const double ms : all->exchange_ms) alone_ms += std::max(0.0, all->step_ms - ms);
  if (alone_ms > kWorthwhile * all->step_ms) return std::nullopt;
  return print_to_string("exchange takes %.0f %% of a step; one %s would be about as fast (see docs/distributed.md)",
                         100 * all->exchange_share(), unit);
}

}  // namespace b3dgs
