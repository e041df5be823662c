// What is learned of the appearance of each photograph (--exposure, --bilateral_grid); part of the training state.
#pragma once

#include <torch/types.h>

#include <cstdint>
#include <vector>

namespace b3dgs {

/// Undefined tensors: nothing is learned.
struct AppearanceState {
  // By training view; one of the two is defined.
  torch::Tensor exposures;               // [V, 3, 4], transforms: colour' = transform (r, g, b, 1)
  torch::Tensor grids;                   // [V, 8, 16, 16, 12]: bilateral_grid_args.h
  torch::Tensor m, v;                    // Adam moments, shape of the parameters
  std::int64_t steps = 0;                // of Adam
  std::vector<std::int64_t> last_steps;  // of grids: the step that each view's grid and moments show

  bool is_defined() const { return m.defined(); }
};

/// Calls visit(name, tensor) for each tensor that is defined, in file order.
template <class State, class Visit>
void visit_appearance(State& state, Visit&& visit) {
  if (state.exposures.defined()) visit("exposures", state.exposures);
  if (state.grids.defined()) visit("grids", state.grids);
  if (state.m.defined()) visit("m", state.m);
  if (state.v.defined()) visit("v", state.v);
}

}  // namespace b3dgs
