// Kernels with one thread per Gaussian, draw or pixel. Their code is in the header of each subject. CPU threads call
// the same functions, so that results on both devices differ at most by the rounding of elementary functions.

#include "core/cuda_rows.cuh"
#include "train/appearance/appearance_kernels.h"
#include "train/density/density_kernels.h"
#include "train/density/strategies/budget_kernels.h"
#include "train/density/strategies/mcmc_math.h"
#include "train/depth/depth_loss.h"
#include "train/gaussians/smoothing_filter_args.h"
#include "train/images/reduce_image.h"
#include "train/loss/loss_args.h"

namespace b3dgs::cuda {

constexpr int kFewThreads = 128, kThreads = 256;  // threads per block; few if each does much work

B3DGS_ROW_KERNEL(add_view_row, kThreads, AddViewArgs)
B3DGS_ROW_KERNEL(draw_split_sample, kFewThreads, SplitSampleArgs)
B3DGS_ROW_KERNEL(draw_parent_key, kThreads, ParentKeyArgs)
B3DGS_ROW_KERNEL(make_part, kThreads, PartArgs)
B3DGS_ROW_KERNEL(write_draw_weight, kFewThreads, DrawWeightArgs)
B3DGS_ROW_KERNEL(draw_row, kFewThreads, DrawArgs)
B3DGS_ROW_KERNEL(share_row, kFewThreads, ShareArgs)
B3DGS_ROW_KERNEL(add_noise_row, kFewThreads, MeanNoiseArgs)
B3DGS_ROW_KERNEL(depth_loss_grad_at, kThreads, DepthLossArgs)
B3DGS_ROW_KERNEL(write_pixel_error, kThreads, ErrorImageArgs)
B3DGS_ROW_KERNEL(expose_pixel, kThreads, AppearanceArgs)
B3DGS_ROW_KERNEL(correct_pixel, kThreads, AppearanceArgs)
B3DGS_ROW_KERNEL(correct_pixel_backward, kThreads, AppearanceArgs)
B3DGS_ROW_KERNEL(write_grid_grad, kThreads, AppearanceArgs)
B3DGS_ROW_KERNEL(reduce_pixel, kFewThreads, ReduceImageArgs)
B3DGS_ROW_KERNEL(write_filter_size, kFewThreads, SmoothingFilterArgs)
B3DGS_ROW_KERNEL(write_finest_pixel, kFewThreads, SmoothingFilterArgs)

}  // namespace b3dgs::cuda
