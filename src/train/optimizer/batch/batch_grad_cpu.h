// CPU version of the gradients of a step of several views, without torch.
#pragma once

#include "train/optimizer/batch/batch_grad.h"

namespace b3dgs::cpu {

/// Gradients of the mean over the views. `out.means2d` is not used. The result does not depend on the number of
/// threads.
void batch_gradients(const BatchGradArgs& args, const GaussianGradArrays& out);

}  // namespace b3dgs::cpu
