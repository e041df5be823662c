// What ranks tell each other on the host while they train together.
#pragma once

#include <cstdint>
#include <vector>

#include "config/batch_steps.h"
#include "core/check.h"
#include "raster/args.h"
#include "raster/checks.h"
#include "raster/math/project_splat.h"

namespace b3dgs {

/// What each rank tells the others of the views that it has rendered in the last step.
struct RenderedRecord {
  double losses[kMaxBatch]{};
  std::int64_t entries[kMaxBatch]{};
};

/// What each rank tells the others in a step, after its projections.
struct StepRecord {
  std::int64_t first_invalid = -1;     // row of the model that cannot be rendered
  RenderedRecord rendered{};           // of the step before
  std::int64_t n_splats[kMaxBatch]{};  // of each view
  std::int32_t stop = 0;
  std::int32_t write_checkpoint = 0, check_kernels = 0;  // only rank 0's values are used
  std::int32_t is_out_of_memory = 0;
};

/// What rank 0 asks of the others in on_first().
struct RenderRequest {
  enum Kind : std::int32_t { kDone, kRender, kRemove, kFailed };
  std::int64_t row = 0;  // to remove
  CameraView view{};
  RenderSettings settings{};
  Kind kind = kDone;
  bool can_save = false;  // after a failure: whether the model is undamaged
};

/// What each rank tells the others of its projection of such a view.
struct ProjectRecord {
  std::int64_t n_splats = 0, first_invalid = -1;
  std::int32_t is_out_of_memory = 0;
};

/// @throws InvalidGaussianError, on all ranks, if one of them has found an invalid Gaussian
template <class Record>
void check_valid(const std::vector<Record>& records) {
  std::int64_t first = -1;
  for (const Record& record : records) {
    if (record.first_invalid >= 0 && (first < 0 || record.first_invalid < first)) first = record.first_invalid;
  }
  if (first >= 0) throw InvalidGaussianError(first, detail::concat("Gaussian ", first, kInvalidText));
}

}  // namespace b3dgs
