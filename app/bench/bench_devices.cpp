#include "app/bench/bench_devices.h"

#include "core/check.h"

namespace b3dgs {

#if !B3DGS_HAS_CUDA
namespace {

[[noreturn]] void refuse_cuda() {
  input_error("--device cuda: this build has no CUDA kernels; build with nvcc in PATH or use --device cpu");
}

}  // namespace

void bench_kernels_cuda(const BenchRun&, const BenchScene&, BenchFile&) {
  refuse_cuda();
}
ForwardTimes time_forward_kernels_cuda(const BenchRun&, const BenchScene&) {
  refuse_cuda();
}
bool has_gpu() {
  return false;
}
#endif

std::string default_bench_device() {
  return has_gpu() ? "cuda" : "cpu";
}

void bench_kernels(const BenchRun& run, const BenchScene& scene, BenchFile& file) {
  run.device == "cuda" ? bench_kernels_cuda(run, scene, file) : bench_kernels_cpu(run, scene, file);
}

ForwardTimes time_forward_kernels(const BenchRun& run, const BenchScene& scene) {
  return run.device == "cuda" ? time_forward_kernels_cuda(run, scene) : time_forward_kernels_cpu(run, scene);
}

}  // namespace b3dgs
