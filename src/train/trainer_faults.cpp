// What happens when a step fails: the state is rolled back to the end of the iteration before. If the cause is a
// Gaussian that cannot be rendered, the step is repeated without it; otherwise a checkpoint is written and training
// ends.
//
// Rolling back is cheap because a step changes Gaussians, moments and statistics last, and nothing can fail after the
// first of these changes: by then the photograph is loaded and all memory is allocated. Deferred optimizer updates need
// no roll-back: they may be applied at any time (optimizer/deferred_sh.h).

#include <c10/util/Exception.h>

#include <cstring>
#include <new>

#include "core/shell_quote.h"
#include "train/density/invalid_gaussians.h"
#include "train/trainer_impl.h"

namespace b3dgs {
namespace {

constexpr const char* kNoCheckpoint = "; a checkpoint could not be written either: ";

bool is_out_of_memory(const std::exception& error) {
  return dynamic_cast<const OutOfMemoryError*>(&error) != nullptr ||
         dynamic_cast<const std::bad_alloc*>(&error) != nullptr ||
         dynamic_cast<const c10::OutOfMemoryError*>(&error) != nullptr ||
         std::strstr(error.what(), "allocate memory") != nullptr ||  // LibTorch's on a CPU
         std::strstr(error.what(), "out of memory") != nullptr;
}

/// Whether an error, perhaps of another rank, says where training can be resumed.
bool names_checkpoint(const char* error) {
  return std::strstr(error, "; last checkpoint: ") != nullptr ||
         std::strstr(error, " is saved, continue with ") != nullptr;
}

std::string first_line(const char* text) {
  return {text, std::strcspn(text, "\n")};  // LibTorch appends a stack trace
}

}  // namespace

void Trainer::Impl::roll_back() {
  timer.cancel();
  if (state.adam.steps != step_start.adam_steps) {
    is_consistent = false;
    return;
  }
  if (unread_loss && unread_loss->iteration > step_start.iteration) unread_loss.reset();
  while (!unread_losses.empty() && unread_losses.back().iteration > step_start.iteration) unread_losses.pop_back();
  stepper.drop_views();
  poses.drop_gradients();
  if (std::exchange(saved_statistics.is_in_use, false)) {
    for (std::size_t i = 0; i < saved_statistics.columns.size(); ++i) {
      state.statistics.all()[i]->copy_(saved_statistics.columns[i]);
    }
  }
  state.iteration = step_start.iteration;
  state.step_iterations = step_start.step_iterations;
  state.sh_degree = step_start.sh_degree;
  state.view_order = step_start.view_order;
  if (step_start.loss_average) state.loss_average = *step_start.loss_average;
}

void Trainer::Impl::remove_invalid_gaussians(const InvalidGaussianError& error) {
  read_loss();  // throws if it is not finite, which would be the cause
  flush();
  is_consistent = false;
  const std::int64_t n = remove_invalid_rows(error.row());
  is_consistent = true;
  state.n_removed += n;
  const std::string reason = first_line(error.what());
  recorder.log_event(state.iteration, "gaussians_removed",
                     {{"count", n}, {"total", state.n_removed}, {"reason", reason}});
  if (state.n_gaussians() == 0) {
    throw LossError(detail::concat("after iteration ", state.iteration,
                                   ": no Gaussian is left that can be rendered: ", reason, recorder.last_checkpoint()));
  }
  if (state.n_removed < 2 * n_warned_of) return;
  n_warned_of = state.n_removed;
  recorder.warn(detail::concat("after iteration ", state.iteration, ": removed ", n,
                               n == 1 ? " Gaussian" : " Gaussians", " that cannot be rendered (", state.n_removed,
                               " so far): ", reason));
}

std::string Trainer::Impl::resume_words(const std::filesystem::path& checkpoint) const {
  return "continue with " +
         (hooks.resume_command.empty() ? "--resume " + shell_quote(checkpoint.string()) : hooks.resume_command);
}

std::string Trainer::Impl::last_checkpoint_of_ranks() const {
  const std::vector<int> iterations = folder.checkpoint_iterations();
  if (iterations.empty()) return "; last checkpoint: none was written";
  const std::filesystem::path last = folder.checkpoint(iterations.back());
  return "; last checkpoint: " + last.string() + ", " + resume_words(last);
}

/// The end of the error message: where training can be resumed.
std::string Trainer::Impl::save_last_state() {
  if (is_distributed()) return has_failed_together ? save_together() : last_checkpoint_of_ranks();
  if (!recorder.is_log_open() || state.iteration == 0) return "";
  read_loss();
  if (!is_consistent) return recorder.last_checkpoint();
  recorder.set_ending(true);
  write_checkpoint();
  if (const std::vector<WrittenFile>& failed = recorder.failed_files(); !failed.empty()) {
    return kNoCheckpoint + failed.back().error + recorder.last_checkpoint();
  }
  return detail::concat("; iteration ", state.iteration, " is saved, ", resume_words(recorder.outputs().checkpoint));
}

std::string Trainer::Impl::save_together() {
  has_failed_together = false;
  if (state.iteration == 0) return "";
  if (!is_consistent) return last_checkpoint_of_ranks();
  free_scratch()();  // rows are exchanged through memory of the device
  recorder.set_ending(true);
  write_checkpoint();
  if (!has_written_files()) return detail::concat(kNoCheckpoint, "see rank 0", last_checkpoint_of_ranks());
  return detail::concat("; iteration ", state.iteration, " is saved, ",
                        resume_words(folder.checkpoint(state.iteration)));
}

void Trainer::Impl::end_with_checkpoint() {
  const std::exception_ptr cause = std::current_exception();
  std::string saved;
  try {
    saved = save_last_state();
  } catch (const LossError&) {
    throw;
  } catch (const std::exception& error) {
    saved = kNoCheckpoint + first_line(error.what()) + recorder.last_checkpoint();
  }
  try {
    std::rethrow_exception(cause);
  } catch (const PeerError& error) {
    throw PeerError(error, names_checkpoint(error.what()) ? "" : saved);
  } catch (const InputError& error) {
    throw InputError(error.what() + saved);
  } catch (const IoError& error) {
    throw IoError(error.what() + saved);
  } catch (const NumericError& error) {
    throw NumericError(error.what() + saved);
  } catch (const std::exception& error) {
    if (!is_out_of_memory(error)) throw Error(first_line(error.what()) + saved);
    throw OutOfMemoryError(detail::concat("out of memory after iteration ", state.iteration, ", with ",
                                          state.n_gaussians(), " Gaussians", saved));
  }
}

}  // namespace b3dgs
