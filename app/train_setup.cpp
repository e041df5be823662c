#include "app/train_setup.h"

#include <csignal>
#include <cstdint>
#include <ctime>

#include "core/files/remove_tree.h"
#include "report/run_info.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

std::atomic<int> asked_to_stop{0};
std::atomic<std::int64_t> asked_at_ms{0};

std::int64_t now_ms() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);  // async-signal-safe
  return std::int64_t{now.tv_sec} * 1000 + now.tv_nsec / 1000000;
}

/// timeout(1) and some batch systems signal both the program and its process group, so two signals in quick succession
/// are one request. A later second signal means: stop immediately.
extern "C" void ask_to_stop(int signal) {
  constexpr std::int64_t kOneRequestMs = 500;
  int none = 0;
  if (asked_to_stop.compare_exchange_strong(none, signal)) {
    asked_at_ms = now_ms();
  } else if (asked_at_ms > 0 && now_ms() - asked_at_ms > kOneRequestMs) {
    std::signal(signal, SIG_DFL);
    std::raise(signal);
  }
}

}  // namespace

const std::atomic<int>& stop_signal() {
  return asked_to_stop;
}

void catch_stop_signals() {
  std::signal(SIGINT, ask_to_stop);
  std::signal(SIGTERM, ask_to_stop);
  if (std::signal(SIGHUP, ask_to_stop) == SIG_IGN) std::signal(SIGHUP, SIG_IGN);  // of nohup
}

void request_stop() {
  int none = 0;  // asked twice, this does not mean: immediately
  if (asked_to_stop.compare_exchange_strong(none, SIGINT)) asked_at_ms = now_ms();
}

void make_absolute(std::string& path) {
  if (!path.empty()) path = fs::absolute(path).lexically_normal().string();
}

void remove_model(const ModelFolder& folder) {
  std::error_code error;
  for (const int iteration : folder.ply_iterations()) remove_tree(folder.ply(iteration).parent_path());
  for (const int iteration : folder.checkpoint_iterations()) fs::remove(folder.checkpoint(iteration), error);
  for (const fs::path& file : {folder.log(), folder.poses(), folder.exposures(), folder.root() / "report.html"}) {
    fs::remove(file, error);
  }
  for (const fs::path& file : folder.results()) fs::remove(file, error);
  remove_run_info(folder);
}

EmptyFolderGuard::EmptyFolderGuard(const fs::path& folder) {
  std::error_code error;
  if (!fs::exists(folder, error)) folder_ = folder;
}

EmptyFolderGuard::~EmptyFolderGuard() {
  std::error_code error;  // ignored: usually the folder is not empty
  if (!folder_.empty()) fs::remove(folder_, error);
}

}  // namespace b3dgs
