// What compare.json says of a comparison.
#include "compare/compare_summary.h"
#include "compare/compare_verdict.h"

namespace b3dgs {
namespace {

using Json = nlohmann::ordered_json;

Json to_json(const Spread& spread) {
  return {{"mean", spread.mean}, {"min", spread.min}, {"max", spread.max}, {"n", spread.n}};
}

/// The mean's 95 % interval is null with one seed.
Json to_json(const Effect& effect) {
  Json json = to_json(static_cast<const Spread&>(effect));
  json["interval"] = effect.margin ? Json::array({effect.low(), effect.high()}) : Json(nullptr);
  json["finding"] = finding_word(effect);
  return json;
}

Json to_json(double value) {
  return value;
}

template <class Value>
Json to_json(const std::optional<Value>& value) {
  return value ? to_json(*value) : Json(nullptr);
}

Json to_json(const KernelPartSummary& part) {
  return {{"names", part.kernels},
          {"iterations", to_json(part.iterations)},
          {"saved_against_baseline", to_json(part.saved)}};
}

Json to_json(const RunToRunVariation& noise) {
  return {{"overall", to_json(noise.overall)}, {"before", to_json(noise.before)}, {"after", to_json(noise.after)}};
}

Json to_json(const BalancingGain& gain, const std::optional<double>& noise) {
  return {{"name", gain.name},
          {"naive", gain.naive},
          {"unbalanced", gain.unbalanced},
          {"saved_naive_to_unbalanced", to_json(gain.to_unbalanced)},
          {"saved_by_balancing", to_json(gain.balancing)},
          {"saved_whole", to_json(gain.whole)},
          {"machine_spread", to_json(noise)}};
}

Json times_json(const ComparedConfiguration& own) {
  return {{"name", own.name},
          {"differs_in", own.differs_in},
          {"saved_overall", to_json(own.overall)},
          {"saved_before_inflection", to_json(own.before)},
          {"saved_after_inflection", to_json(own.after)},
          {"machine_spread", to_json(own.noise)},
          {"inflection", to_json(own.switch_iteration)}};
}

Json to_json(const FinalResult& own) {
  return {{"name", own.name},
          {"iterations", own.iterations},
          {"complete_seeds", own.n_complete},
          {"seconds", to_json(own.seconds)},
          {"gaussians", to_json(own.count)},
          {"psnr", to_json(own.psnr)},
          {"ssim", to_json(own.ssim)},
          {"psnr_gained", to_json(own.psnr_gained)}};
}

}  // namespace

Json to_json(const ComparisonSummary& summary) {
  Json compared = Json::array();
  for (const ComparedConfiguration& own : summary.compared) {
    Json quality = Json::array(), by_seed = Json::array();
    for (const TimeSaved& saved : own.by_seed) {
      by_seed.push_back({{"until", saved.until}, {"baseline_s", saved.baseline_s}, {"ours_s", saved.ours_s}});
    }
    for (const QualityDifference& difference : own.quality) {
      quality.push_back({{"measure", difference.measure},
                         {"iteration", difference.iteration},
                         {"baseline", to_json(difference.baseline)},
                         {"ours", to_json(difference.ours)},
                         {"difference", difference.gained.mean},
                         {"interval", to_json(difference.gained)["interval"]},
                         {"finding", finding_word(difference.gained)},
                         {"machine_spread", to_json(difference.noise)},
                         {"tolerance", difference.gained.limit},
                         {"equal", difference.gained.finding == Finding::kEqual}});
    }
    compared.push_back(times_json(own));
    compared.back().update({{"balanced_kernels", to_json(own.balanced)},
                            {"other_kernels", to_json(own.others)},
                            {"by_seed", by_seed},
                            {"quality", quality}});
  }
  Json balancing = Json::array(), paper_comparisons = Json::array(), results = Json::array();
  for (const FinalResult& own : summary.results) results.push_back(to_json(own));
  for (const BalancingGain& gain : summary.balancing) balancing.push_back(to_json(gain, summary.noise()));
  for (const ComparedConfiguration& own : summary.paper_comparisons) {
    paper_comparisons.push_back(times_json(own));
    paper_comparisons.back()["baseline"] = own.baseline;
  }
  return {{"verdict", verdict(summary)},
          {"baseline", summary.baseline},
          {"ours", summary.ours},
          {"repetition", summary.repetition},
          {"machine_spread", to_json(summary.noise())},
          {"iterations", summary.iterations},
          {"done", summary.done},
          {"done_by_seed", summary.done_by_seed},
          {"results", results},
          {"balancing", balancing},
          {"beside_paper", paper_comparisons},
          {"compared", compared}};
}

}  // namespace b3dgs
