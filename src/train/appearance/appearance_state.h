// What is learned of the appearance of each photograph (--exposure); part of the training state.
#pragma once

#include <torch/types.h>

#include <cstdint>

namespace b3dgs {

/// Undefined tensors: nothing is learned.
struct AppearanceState {
  torch::Tensor exposures;  // [V, 3, 4] by training view: colour' = exposure (r, g, b, 1)
  torch::Tensor m, v;       // Adam moments, shape of the parameters
  std::int64_t steps = 0;   // of Adam

  bool is_defined() const { return m.defined(); }
};

/// Calls visit(name, tensor) for each tensor that is defined, in file order.
template <class State, class Visit>
void visit_appearance(State& state, Visit&& visit) {
  if (state.exposures.defined()) visit("exposures", state.exposures);
  if (state.m.defined()) visit("m", state.m);
  if (state.v.defined()) visit("v", state.v);
}

}  // namespace b3dgs
