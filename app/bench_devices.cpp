#include "app/bench_devices.h"

#include "check.h"

namespace b3dgs {

#if !B3DGS_HAS_CUDA
namespace {

[[noreturn]] void refuse_cuda() {
  input_error("--device cuda: this build has no CUDA kernels; build with nvcc on the PATH, or use --device cpu");
}

}  // namespace

nlohmann::ordered_json bench_kernels_cuda(const BenchRun&, const BenchScene&) {
  refuse_cuda();
}
ForwardTimes time_forward_kernels_cuda(const BenchRun&, const BenchScene&) {
  refuse_cuda();
}
#endif

nlohmann::ordered_json bench_kernels(const BenchRun& run, const BenchScene& scene) {
  return run.device == "cuda" ? bench_kernels_cuda(run, scene) : bench_kernels_cpu(run, scene);
}

ForwardTimes time_forward_kernels(const BenchRun& run, const BenchScene& scene) {
  return run.device == "cuda" ? time_forward_kernels_cuda(run, scene) : time_forward_kernels_cpu(run, scene);
}

}  // namespace b3dgs
