// A program for train_ranks_tests that runs on several ranks: train_rank RANKS SCENARIO. The results that ranks compute
// together must have the same bytes as those that each of them computes alone on whole tensors, which are the same on
// all ranks.
#include <torch/types.h>

#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "config/train_config.h"
#include "core/check.h"
#include "dist/communicator.h"
#include "multi/render_plan.h"
#include "multi/rows.h"
#include "multi/splat_exchange.h"
#include "support/rank_program.h"
#include "train/density/density_strategy.h"
#include "train/density/strategies/strategies.h"

namespace b3dgs {
namespace {

using test::expect;
using test::same_bytes;
using Counts = std::vector<std::int64_t>;

constexpr std::int64_t kSmallPiece = 2048;  // bytes; small enough that most tensors here take several pieces

void expect_same(const torch::Tensor& found, const torch::Tensor& expected, const std::string& what) {
  expect(found.defined() && found.sizes() == expected.sizes() && found.scalar_type() == expected.scalar_type(),
         what + ": shape or type");
  expect(found.is_contiguous(), what + ": not contiguous");
  expect(same_bytes(found, expected.contiguous()), what + ": bytes");
}

template <class Failure = LogicError, class Body>
void expect_failure(const std::string& part, Body&& body) {
  try {
    body();
  } catch (const Failure& error) {
    expect(std::string(error.what()).find(part) != std::string::npos, "\"" + part + "\" in: " + error.what());
    return;
  }
  expect(false, "no failure: " + part);
}

/// Returns random bits, including those that are NaN as floats.
torch::Tensor random_words(torch::IntArrayRef sizes) {
  return torch::randint(-(std::int64_t{1} << 31), std::int64_t{1} << 31, sizes, torch::kInt64).to(torch::kInt32);
}

// --- Rows ---

/// Returns the rows of a rank, assigned one by one.
Counts assign_rows(int rank, int size, std::int64_t n_rows) {
  Counts rows;
  for (std::int64_t row = 0; row < n_rows; ++row) {
    if (row / RowOwners::kBlock % size == rank) rows.push_back(row);
  }
  return rows;
}

RowOwners round_robin(const Communicator& ranks, std::int64_t n_rows) {
  return RowOwners::round_robin(ranks.rank(), ranks.size(), n_rows, torch::kCPU);
}

/// Returns owners as after many edits, where any row may belong to any rank.
RowOwners random_owners(const Communicator& ranks, std::int64_t n_rows) {
  return round_robin(ranks, 5000).after(torch::randint(5000, {n_rows}, torch::kInt64));
}

/// Returns the rows of the model that this rank owns, found one by one.
torch::Tensor rows_of(const RowOwners& owners) {
  Counts rows;
  for (std::int64_t row = 0; row < owners.n_rows(); ++row) {
    if (owners.size() == 1 || owners.owners()[row].item<std::int16_t>() == owners.rank()) rows.push_back(row);
  }
  return torch::tensor(rows, torch::kInt64);
}

void check_owners(const RowOwners& owners, std::int64_t n_rows) {
  const torch::Tensor rows = rows_of(owners);
  expect(owners.n_rows() == n_rows && owners.n_own() == rows.size(0), "numbers of rows");
  if (owners.size() > 1) expect_same(owners.own().to(torch::kInt64), rows, "own rows of the model");
  for (std::int64_t i = 0; i < rows.size(0); i += 97) {
    expect(owners.row_of_model(i) == rows[i].item<std::int64_t>(), "row of the model");
  }
  const torch::Tensor some = torch::randint(1 << 20, {50}, torch::kInt64);
  if (rows.size(0) == 0) return;
  const torch::Tensor places = some.remainder(rows.size(0));
  const torch::Tensor asked = owners.size() == 1 ? places : rows.index_select(0, places);
  expect_same(owners.own_rows_of(asked), places, "places of rows");
}

void check_round_robin(const Communicator& ranks, std::int64_t n_rows) {
  for (int r = 0; r < ranks.size(); ++r) {
    const RowOwners even = RowOwners::round_robin(r, ranks.size(), n_rows, torch::kCPU);
    check_owners(even, n_rows);
    expect_same(rows_of(even), torch::tensor(assign_rows(r, ranks.size(), n_rows), torch::kInt64),
                "rows assigned round-robin");
  }
}

void check_gathering(Communicator& ranks) {
  for (const std::int64_t n : {0, 1, 1023, 1024, 1025, 5000}) {
    check_round_robin(ranks, n);
    const torch::Tensor wide = random_words({n, 6});
    const std::vector<torch::Tensor> tensors{wide.view(torch::kFloat32).view({n, 2, 3}),
                                             wide.select(1, 0).contiguous(),
                                             wide.view(torch::kInt64),
                                             wide.select(1, 1).to(torch::kUInt8),
                                             wide.select(1, 2) > 0,
                                             torch::empty({n, 0, 3}),
                                             wide.to(torch::kFloat64),
                                             wide.t().contiguous().t().select(1, 2)};
    for (const RowOwners& owners : {round_robin(ranks, n), random_owners(ranks, n)}) {
      check_owners(owners, n);
      for (const torch::Tensor& whole : tensors) {
        const torch::Tensor own = own_rows(whole, owners);
        expect_same(own, whole.index_select(0, rows_of(owners)), "own rows");
        expect(n == 0 || whole.numel() == 0 || own.data_ptr() != whole.data_ptr(), "own rows are a copy");
        for (const std::int64_t piece_bytes : {kExchangePieceBytes, kSmallPiece}) {
          expect_same(gather_rows(ranks, own, owners, piece_bytes), whole, "gathered rows");
          const torch::Tensor first = gather_rows_on_first(ranks, own, owners, piece_bytes);
          if (ranks.is_first()) {
            expect_same(first, whole, "rows gathered on rank 0");
          } else {
            expect(!first.defined(), "rows gathered elsewhere");
          }
        }
      }
    }
  }
}

// --- Row edits ---

struct Model {
  GaussianTensors gaussians;
  AdamState adam;
  DensityStatistics statistics;

  std::vector<torch::Tensor*> all() {
    std::vector<torch::Tensor*> tensors;
    for (GaussianTensors* group : {&gaussians, &adam.m, &adam.v}) {
      for (torch::Tensor* tensor : group->all()) tensors.push_back(tensor);
    }
    for (torch::Tensor* column : statistics.all()) tensors.push_back(column);
    return tensors;
  }
};

GaussianTensors random_gaussians(std::int64_t n, std::int64_t n_coefficients) {
  return {torch::randn({n, 3}), torch::randn({n, 3}),    torch::randn({n, 4}),
          torch::randn({n}),    torch::randn({n, 1, 3}), torch::randn({n, n_coefficients, 3})};
}

Model random_model(std::int64_t n, std::int64_t n_coefficients, int n_columns) {
  Model model{random_gaussians(n, n_coefficients),
              {random_gaussians(n, n_coefficients), random_gaussians(n, n_coefficients), 7, torch::rand({n, 4})},
              {torch::rand({n}), random_words({n}), random_words({n}), {}}};
  model.gaussians.filters = torch::rand({n});
  for (int i = 0; i < n_columns; ++i) model.statistics.extra.push_back({"column", torch::rand({n})});
  return model;
}

Model own_part(const Model& whole, const RowOwners& owners) {
  Model own = whole;
  for (torch::Tensor* tensor : own.all()) *tensor = own_rows(*tensor, owners);
  return own;
}

/// Returns an edit that keeps each row with probability `keeps`, and adds n_new copies.
RowEdit random_edit(std::int64_t n, double keeps, std::int64_t n_new, bool has_opacities) {
  const torch::Tensor kept = (torch::rand({n}) < keeps).nonzero().flatten();
  RowEdit edit;
  edit.sources = n == 0 ? kept : torch::cat({kept, torch::randint(n, {n_new}, torch::kInt64)});
  edit.n_kept = kept.size(0);
  n_new = edit.sources.size(0) - edit.n_kept;
  edit.new_means = torch::randn({n_new, 3});
  edit.new_log_scales = torch::randn({n_new, 3});
  if (has_opacities) edit.new_logit_opacities = torch::randn({n_new});
  return edit;
}

void check_edit(Communicator& ranks, const Model& before, const RowEdit& edit) {
  const std::int64_t n = before.gaussians.size();
  for (const RowOwners& owners : {round_robin(ranks, n), random_owners(ranks, n)}) {
    Model sharded = own_part(before, owners), whole = own_part(before, RowOwners::round_robin(0, 1, n, torch::kCPU));
    apply_row_edit(edit, whole.gaussians, whole.adam, whole.statistics);
    const auto [after, own_edit] = own_part(edit, owners);
    apply_row_edit(own_edit, sharded.gaussians, sharded.adam, sharded.statistics);
    check_owners(after, edit.sources.size(0));
    const torch::Tensor sources = edit.sources.index_select(0, rows_of(after));
    if (ranks.size() > 1) {
      expect((owners.owners().index_select(0, sources) == ranks.rank()).all().item<bool>(), "rows stay on their rank");
    }
    const std::vector<torch::Tensor*> found = sharded.all(), expected = whole.all();
    expect(found.size() == expected.size(), "tensors after the edit");
    for (std::size_t i = 0; i < found.size(); ++i) {
      expect_same(*found[i], own_rows(*expected[i], after),
                  "tensor " + std::to_string(i) + " of " + std::to_string(n) + " rows after an edit to " +
                      std::to_string(edit.sources.size(0)));
    }
    expect(!sharded.gaussians.filters.defined(), "filters after the edit");
  }
}

void check_edits(Communicator& ranks) {
  for (const std::int64_t n : {0, 5, 1024, 5000, 9000}) {
    for (const std::int64_t n_coefficients : {0, 3}) {
      const Model before = random_model(n, n_coefficients, n_coefficients == 0 ? 0 : 4);
      check_edit(ranks, before, random_edit(n, 0.8, n / 3, false));
      check_edit(ranks, before, random_edit(n, 0.3, 2 * n, true));
      check_edit(ranks, before, random_edit(n, 0.9, n / 20, true));
      check_edit(ranks, before, random_edit(n, 1.1, 0, false));    // changes nothing
      check_edit(ranks, before, random_edit(n, -1, 2500, false));  // only new rows
      check_edit(ranks, before, random_edit(n, -1, 0, true));      // removes all
    }
  }
}

// --- Splats ---

struct WholeView {
  torch::Tensor rows;  // [M] int64 rows of the model, ascending
  ViewSplats splats;   // with Splat::gaussian = row of the model
};

torch::Tensor as_floats(const torch::Tensor& words) {
  return words.view(torch::kFloat32);
}

WholeView random_view(std::int64_t n_global, double part) {
  WholeView view;
  view.rows = (torch::rand({n_global}) < part).nonzero().flatten();
  const std::int64_t n = view.rows.size(0);
  torch::Tensor words = random_words({n, 12});
  words.select(1, 7).copy_(view.rows);
  view.splats = {as_floats(words), as_floats(random_words({n, 2})), random_words({n})};
  return view;
}

/// Returns the indices in view.rows of the rows of a rank.
torch::Tensor places_of(const WholeView& view, const RowOwners& owners, int rank) {
  if (owners.size() == 1) return torch::arange(view.rows.size(0));
  return (owners.owners().index_select(0, view.rows) == rank).nonzero().flatten();
}

ViewSplats own_splats(const WholeView& view, const RowOwners& owners) {
  const torch::Tensor places = places_of(view, owners, owners.rank());
  ViewSplats own{view.splats.splats.index_select(0, places), view.splats.extents.index_select(0, places),
                 view.splats.radii.index_select(0, places)};
  own.splats.view(torch::kInt32).select(1, 7).copy_(owners.own_rows_of(view.rows.index_select(0, places)));
  return own;
}

void check_step(Communicator& ranks, std::int64_t n_global, const std::vector<int>& renderers) {
  const int n_views = static_cast<int>(renderers.size());
  const auto is_rendered_here = [&](int v) { return renderers[static_cast<std::size_t>(v)] == ranks.rank(); };
  const RowOwners owners = random_owners(ranks, n_global);
  std::vector<WholeView> views;
  for (int v = 0; v < n_views; ++v) views.push_back(random_view(n_global, v == 1 ? 0 : 0.2 * v + 0.1));
  std::vector<Counts> counts(static_cast<std::size_t>(ranks.size()));
  for (int r = 0; r < ranks.size(); ++r) {
    for (const WholeView& view : views) {
      counts[static_cast<std::size_t>(r)].push_back(places_of(view, owners, r).size(0));
    }
  }
  std::vector<ViewSplats> own;
  for (const WholeView& view : views) own.push_back(own_splats(view, owners));

  SplatExchange exchange(ranks);
  for (int step = 0; step < 2; ++step) {
    exchange.pack(own, renderers, owners.own());
    const std::vector<ViewSplats> splats = exchange.to_renderers(counts);
    std::size_t i = 0;
    for (int v = 0; v < n_views; ++v) {
      if (!is_rendered_here(v)) continue;
      const ViewSplats& expected = views[static_cast<std::size_t>(v)].splats;
      expect(i < splats.size(), "views rendered here");
      expect_same(splats[i].splats, expected.splats, "splats at the renderer");
      expect_same(splats[i].extents, expected.extents, "extents at the renderer");
      expect_same(splats[i].radii, expected.radii, "radii at the renderer");
      ++i;
    }
    expect(splats.size() == i, "views rendered here");

    for (const auto& [n_columns, type] : {std::pair{std::int64_t{12}, torch::kFloat32}, {5, torch::kInt32}}) {
      std::vector<torch::Tensor> sums, from_here;
      for (const WholeView& view : views) {
        sums.push_back(random_words({view.rows.size(0), n_columns}).view(type));
      }
      for (int v = 0; v < n_views; ++v) {
        if (is_rendered_here(v)) from_here.push_back(sums[static_cast<std::size_t>(v)]);
      }
      const std::vector<torch::Tensor> received = exchange.to_owners(from_here, n_columns, type);
      expect(received.size() == views.size(), "views at the owner");
      for (std::size_t v = 0; v < views.size(); ++v) {
        expect_same(received[v], sums[v].index_select(0, places_of(views[v], owners, ranks.rank())),
                    "sums at the owner");
      }
      const std::vector<torch::Tensor> returned = exchange.columns_to_renderers(received);
      expect(returned.size() == from_here.size(), "views at the renderer");
      for (std::size_t v = 0; v < returned.size(); ++v) expect_same(returned[v], from_here[v], "sums at the renderer");
    }
  }
}

void check_splats(Communicator& ranks) {
  for (const std::int64_t n_global : {0, 700, 9000}) {
    for (std::size_t n_views = 1; n_views <= 5; ++n_views) {
      const std::vector<int> in_turn = RenderPlan(ranks.size()).renderers(std::vector<std::int32_t>(n_views));
      check_step(ranks, n_global, in_turn);
      check_step(ranks, n_global, {in_turn.rbegin(), in_turn.rend()});
      check_step(ranks, n_global, std::vector<int>(n_views, ranks.size() - 1));  // all rendered by one rank
    }
  }
}

// --- Noise ---

void check_noise(Communicator& ranks) {
  constexpr std::int64_t kRows = 5000;
  const RowOwners owners = random_owners(ranks, kRows);
  GaussianTensors before = random_gaussians(kRows, 0);
  before.logit_opacities.sub_(5);  // nearly transparent, which gets noise
  const auto copy = [&](const RowOwners& of) {
    GaussianTensors gaussians = before;
    for (torch::Tensor* tensor : gaussians.all()) *tensor = own_rows(*tensor, of);
    return gaussians;
  };
  const auto check = [&](const std::string& what, auto&& add_noise) {
    GaussianTensors whole = copy(RowOwners::round_robin(0, 1, kRows, torch::kCPU)), own = copy(owners),
                    as_if_whole = copy(owners);
    add_noise(whole, torch::Tensor());
    add_noise(own, owners.own());
    add_noise(as_if_whole, torch::Tensor());
    expect_same(own.means, own_rows(whole.means, owners), "noise of " + what);
    expect(!torch::equal(whole.means, before.means), "no noise of " + what);
    expect(torch::equal(own.means, as_if_whole.means) == (ranks.size() == 1),
           "noise of " + what + " depends on the row of the model");
  };
  check("add_mean_noise()", [](GaussianTensors& gaussians, const torch::Tensor& of) {
    add_mean_noise(gaussians, /*rate=*/400, /*seed=*/3, /*iteration=*/77, of);
  });
  TrainConfig config;
  config.strategy = Strategy::kMcmc;
  const std::unique_ptr<DensityStrategy> strategy = make_density_strategy(config, /*extent=*/2);
  check("mcmc", [&](GaussianTensors& gaussians, const torch::Tensor& of) { strategy->after_step(77, gaussians, of); });
}

// --- Arguments that do not fit ---

void check_misfits(Communicator& ranks) {
  constexpr std::int64_t kRows = 5000;
  const RowOwners owners = round_robin(ranks, kRows), others = round_robin(ranks, 2 * kRows);
  const torch::Tensor own = own_rows(torch::arange(kRows, torch::kInt32), owners);
  expect_failure("rows of 10000", [&] { gather_rows(ranks, own, others); });
  expect_failure("rows of 10000", [&] { gather_rows_on_first(ranks, own, others); });

  const WholeView view = random_view(kRows, 0.5);
  std::vector<Counts> counts;
  for (int r = 0; r < ranks.size(); ++r) counts.push_back({places_of(view, owners, r).size(0)});
  SplatExchange exchange(ranks);
  exchange.pack({own_splats(view, owners)}, {0}, owners.own());
  const std::vector<ViewSplats> rendered = exchange.to_renderers(counts);
  expect_failure("views of the step", [&] {
    exchange.to_owners(std::vector<torch::Tensor>(rendered.size() + 1, torch::empty({0, 2})), 2, torch::kFloat32);
  });
}

void run_scenario(const std::string& scenario, Communicator& ranks) {
  if (scenario == "gathering") return check_gathering(ranks);
  if (scenario == "edits") return check_edits(ranks);
  if (scenario == "splats") return check_splats(ranks);
  if (scenario == "noise") return check_noise(ranks);
  if (scenario == "misfits") return check_misfits(ranks);
  throw LogicError("unknown scenario " + scenario);
}

}  // namespace
}  // namespace b3dgs

int main(int argc, char** argv) {
  return b3dgs::test::run_scenarios(argc, argv, b3dgs::run_scenario);
}
