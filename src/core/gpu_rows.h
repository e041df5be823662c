// The counterpart of for_rows() (parallel.h) on a GPU.
#pragma once

#include <cstdint>

#include "core/vec.h"

namespace b3dgs::cuda {

/// Calls row(args, i) for each i in [0, n), a thread for each. Asynchronous. Defined for the rows that B3DGS_ROW_KERNEL
/// names (cuda_rows.cuh).
template <auto row, class Args>
void for_rows(const Args& args, std::int64_t n, cudaStream_t stream);

}  // namespace b3dgs::cuda
