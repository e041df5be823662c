// What happens when a step cannot be done: the state goes back to the end of the iteration before. If it was for a
// Gaussian that cannot be rendered, the step is done again without it; otherwise a checkpoint is written and the
// training ends.
//
// That works since a step changes the Gaussians, their moments and their statistics last, with nothing after the first
// change that can fail: before that, what it needs of memory is there, and its photograph too. Steps that a GPU has put
// off are no part of this: they may be taken at any time (cuda/deferred_harmonics.h).

#include <c10/util/Exception.h>

#include <cstring>
#include <new>

#include "train/density/invalid_gaussians.h"
#include "train/trainer_impl.h"

namespace b3dgs {
namespace {

bool is_out_of_memory(const std::exception& error) {
  return dynamic_cast<const OutOfMemoryError*>(&error) != nullptr ||
         dynamic_cast<const std::bad_alloc*>(&error) != nullptr ||
         dynamic_cast<const c10::OutOfMemoryError*>(&error) != nullptr ||
         std::strstr(error.what(), "allocate memory") != nullptr ||  // LibTorch's on a CPU
         std::strstr(error.what(), "out of memory") != nullptr;
}

std::string first_line(const char* text) {
  return {text, std::strcspn(text, "\n")};  // LibTorch appends a stack trace
}

}  // namespace

void Trainer::Impl::step() {
  check_kernels(state.iteration + 1);
  for (;;) {
    step_start.iteration = state.iteration;
    step_start.sh_degree = state.sh_degree;
    step_start.adam_steps = state.adam.steps;
    step_start.view_order = state.view_order;
    step_start.loss_average.reset();
    try {
      take_step();
      state.is_density_pending = true;
      return;
    } catch (const BadGaussianError& error) {
      roll_back();
      remove_bad_gaussians(error);
    } catch (const LossError&) {
      throw;
    } catch (...) {
      roll_back();
      throw;
    }
  }
}

void Trainer::Impl::roll_back() {
  timer.cancel();
  if (state.adam.steps != step_start.adam_steps) {
    is_whole = false;
    return;
  }
  if (unsettled && unsettled->iteration > step_start.iteration) unsettled.reset();
  state.iteration = step_start.iteration;
  state.sh_degree = step_start.sh_degree;
  state.view_order = step_start.view_order;
  if (step_start.loss_average) state.loss_average = *step_start.loss_average;
}

void Trainer::Impl::remove_bad_gaussians(const BadGaussianError& error) {
  settle_loss();  // if it is not finite, that is the reason
  settle();
  is_whole = false;
  const std::int64_t n =
      b3dgs::remove_bad_gaussians(error.row(), scene.extent, state.gaussians, state.adam, state.statistics);
  is_whole = true;
  state.n_removed += n;
  const std::string reason = first_line(error.what());
  if (log) {
    log->write_event(state.iteration, "gaussians_removed",
                     {{"count", n}, {"total", state.n_removed}, {"reason", reason}});
  }
  if (state.gaussians.size() == 0) {
    throw LossError(detail::concat("after iteration ", state.iteration,
                                   ": no Gaussian is left that can be rendered: ", reason, last_checkpoint()));
  }
  if (state.n_removed < 2 * n_warned_of) return;
  n_warned_of = state.n_removed;
  warn(detail::concat("after iteration ", state.iteration, ": removed ", n, n == 1 ? " Gaussian" : " Gaussians",
                      " that cannot be rendered (", state.n_removed, " so far): ", reason));
}

std::string Trainer::Impl::last_checkpoint() const {
  return "; last checkpoint: " + (result.checkpoint.empty() ? "none was written" : result.checkpoint.string());
}

/// What is added to the error: where the training can be continued from.
std::string Trainer::Impl::save_last_state() {
  if (!log || state.iteration == 0) return "";
  settle_loss();
  if (!is_whole) return last_checkpoint();
  is_ending = true;
  write_checkpoint();
  if (!failed.empty()) return "; nor could a checkpoint be written: " + failed.back().error + last_checkpoint();
  return detail::concat("; iteration ", state.iteration, " is saved, continue with --resume ",
                        result.checkpoint.string());
}

void Trainer::Impl::end_with_checkpoint() {
  const std::exception_ptr cause = std::current_exception();
  std::string saved;
  try {
    saved = save_last_state();
  } catch (const LossError&) {
    throw;
  } catch (const std::exception& error) {
    saved = "; nor could a checkpoint be written: " + first_line(error.what()) + last_checkpoint();
  }
  try {
    std::rethrow_exception(cause);
  } catch (const InputError& error) {
    throw InputError(error.what() + saved);
  } catch (const IoError& error) {
    throw IoError(error.what() + saved);
  } catch (const NumericError& error) {
    throw NumericError(error.what() + saved);
  } catch (const std::exception& error) {
    if (!is_out_of_memory(error)) throw Error(first_line(error.what()) + saved);
    throw OutOfMemoryError(detail::concat("out of memory after iteration ", state.iteration, ", with ",
                                          state.gaussians.size(), " Gaussians", saved));
  }
}

}  // namespace b3dgs
