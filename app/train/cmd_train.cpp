// b3dgs train: trains a scene, from the start or from a checkpoint.
#include <fcntl.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>

#include "app/common/commands.h"
#include "app/common/stop_request.h"
#include "app/common/torch/machine.h"
#include "app/common/torch/model.h"
#include "app/common/torch/progress.h"
#include "app/report/train_report.h"
#include "app/train/rank_setup.h"
#include "app/train/replaced_model.h"
#include "app/train/session_record.h"
#include "app/train/train_plan.h"
#include "app/view/view_options.h"
#include "app/view/watched_training.h"
#include "config/option_layers.h"
#include "config/original_options.h"
#include "config/presets.h"
#include "config/train_options.h"
#include "core/check.h"
#include "core/files/folders.h"
#include "core/host_memory.h"
#include "core/options/command_line.h"
#include "core/text.h"
#include "dist/communicator.h"
#include "dist/launch/start_ranks.h"
#include "multi/rank_team.h"
#include "scene/images/image_memory.h"
#include "train/checkpoint/checkpoint.h"
#include "train/device.h"
#include "train/scene_limits.h"
#include "train/trainer.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Thrown if a signal stops the training before its first step.
class StoppedEarly : public Error {
 public:
  StoppedEarly() : Error("stopped by a signal before the first iteration") {}
};

void throw_if_stopped() {
  if (stop_signal() != 0) throw StoppedEarly();
}

std::string describe_ranks(int n_ranks, const TrainPlan& plan) {
  const int batch = plan.config.batch;
  const bool is_default = plan.layers && plan.layers->config.batch != batch;
  const char* reason = batch == n_ranks ? " (one per rank; --batch changes it)" : " (--batch changes it)";
  return detail::concat("ranks       ", n_ranks, ", ", batch, " views per step", is_default ? reason : "");
}

/// Describes the communication between ranks if it is slow. Returns "" otherwise.
std::string describe_slow_transport(const Communicator& ranks) {
  if (ranks.size() == 1 || ranks.transport() != Transport::kRelay) return "";
  const char* const without = ranks.device().is_cuda() ? "a build has no NCCL" : "a build has no Gloo";
  return std::string("exchange    through the memory of rank 0, which is slow: ") +
         (ranks.shares_gpus() ? "ranks share a GPU" : without);
}

std::string describe_memory(const MemoryForecast& forecast) {
  return "GPU memory  photographs " + format_bytes(forecast.photographs) + ", images " + format_bytes(forecast.images) +
         ", model " + format_bytes(forecast.model) + ", pairs about " + format_bytes(forecast.pairs) + " of " +
         format_bytes(forecast.limit) + "; room for about " + format_count(forecast.largest_count) + " Gaussians";
}

void print_labelled(const char* name, const std::string& text) {
  std::printf("%-12s%s\n", name, text.c_str());
}

void report_history(const ModelFolder& folder, std::int64_t limit) {
  const TrainHistory history = read_train_log(folder.log());
  const std::string kept = limit_text(history, limit), floaters = floaters_text(history);
  if (!kept.empty()) print_labelled("Gaussians", kept);
  if (!floaters.empty()) print_labelled("floaters", "possible: " + floaters + "; see docs/recipes.md#floaters");
  if (const std::optional<Overfitting> found = find_overfitting(history)) {
    print_labelled("overfitting",
                   print_to_string("PSNR was %.2f dB higher after iteration %d", found->lost, found->iteration) +
                       ", as happens with few photographs or things that move; see "
                       "docs/recipes.md#few-photographs");
  }
}

void report_training(const TrainResult& result, const TrainConfig& config, double total_s) {
  const std::string range = result.first_iteration > 0 && result.first_iteration < result.iteration
                                ? print_to_string(" (%d to %d)", result.first_iteration + 1, result.iteration)
                                : "";
  const bool is_in_training = result.interrupted || result.n_saved == 0;
  print_labelled(
      "trained",
      detail::concat(result.iteration - result.first_iteration, " iterations", range, " in ",
                     format_duration(result.train_s), " (", format_duration(total_s), " with reading and saving), ",
                     format_count(is_in_training ? result.n_gaussians : result.n_saved), " Gaussians"));
  if (result.peak_memory_bytes > 0) {
    print_labelled("GPU memory", "peak " + format_bytes(result.peak_memory_bytes) + ", without the CUDA context");
  }
  for (const auto& [iteration, evaluation] : result.evaluations) {
    print_labelled("quality", describe_quality(iteration, evaluation));
  }
  if (result.n_removed > 0) print_labelled("removed", format_count(result.n_removed) + " invalid Gaussians");
  for (const fs::path& path : result.not_written) print_labelled("not written", path.string());
  if (!result.ply.empty()) print_labelled("PLY", result.ply.string());
  if (!result.checkpoint.empty()) print_labelled("checkpoint", result.checkpoint.string());
  print_labelled("model", config.model_path);
}

/// Returns the options of the scene. Without --host_memory_gb, each rank of this machine gets an equal part of the host
/// memory.
SceneOptions scene_options_of_rank(const TrainConfig& config, int n_ranks_here) {
  SceneOptions options = scene_options(config);
  if (n_ranks_here > 1 && config.host_memory_gb < 0) {
    const std::int64_t available = available_host_memory() / n_ranks_here;
    options.host_memory_gb = 1e-9 * static_cast<double>(image_memory_limit(config.host_memory_gb, available));
  }
  return options;
}

/// Performs all checks that are possible before photographs are read. From then on, only this process trains into the
/// model folder.
std::unique_ptr<FolderLock> check_and_lock(TrainPlan& plan, torch::Device device, StatusLine& status) {
  check_options(plan.config, device);
  if (const int threads = set_compute_threads(plan.config.threads); threads < plan.config.threads) {
    status.warn(detail::concat("--threads ", plan.config.threads, " are far more than this machine has cores: using ",
                               threads));
  }
  const ModelFolder folder(plan.config.model_path);
  auto lock = std::make_unique<FolderLock>(folder.root());  // so that a read-only folder fails early
  plan.is_replaced = guard_model(folder, plan);
  check_checkpoint(plan);
  return lock;
}

void resume(Trainer& trainer, const fs::path& checkpoint, bool is_first) {
  const std::vector<std::string> changes = trainer.resume(checkpoint);
  if (!is_first) return;
  std::cout << "resuming " << checkpoint.string() << (changes.empty() ? "" : "; changed options:") << std::endl;
  for (const std::string& change : changes) std::cout << "  " << change << std::endl;
}

/// Makes sure that a training does not end or fail because its output cannot be written (`| head -1`, a full disk under
/// `> log`).
void drop_unshown_output() {
  std::cout.flush();
  if (std::cout && std::ferror(stdout) == 0) return;
  std::cerr << "warning: standard output could not be written; what was printed from then on is lost" << std::endl;
  const int nowhere = ::open("/dev/null", O_WRONLY | O_CLOEXEC);
  if (nowhere >= 0) ::dup2(nowhere, STDOUT_FILENO);
  if (nowhere > STDERR_FILENO) ::close(nowhere);
  std::clearerr(stdout);
  std::cout.clear();
}

/// @param device_name_of_all  --device, the same on all ranks
int train(const CommandLine& line, const TrainCommandOptions& options, const GivenOptions& given,
          const std::string& device_name_of_all, Communicator& ranks, const MachineShare& machine = {}) {
  catch_stop_signals();
  const double start_s = steady_seconds();
  const bool is_first = ranks.is_first(), has_peers = ranks.size() > 1;
  const bool quiet = options.quiet || !is_first;
  StatusLine status = is_first ? StatusLine::for_stderr(options.quiet) : StatusLine::silent();
  TrainPlan plan;
  const torch::Device device = choose_device(device_name_of_all);
  if (has_peers) check_same_options(ranks, line.given());
  if (is_first) plan = make_plan(line, status, options, given, ranks.size(), device_name(device));
  const std::unique_ptr<FolderLock> lock = is_first ? check_and_lock(plan, device, status) : nullptr;
  if (has_peers) share_plan(ranks, plan);
  if (!is_first) set_compute_threads(plan.config.threads);
  const ModelFolder folder(plan.config.model_path);

  const double reading_start_s = steady_seconds();
  const ProgressFn on_loading = [show = show_loading(status)](auto&&... progress) {
    throw_if_stopped();
    show(progress...);
  };
  SceneOptions scene_options = scene_options_of_rank(plan.config, machine.n_ranks);
  if (!plan.checkpoint.empty()) scene_options.frame = checkpoint_frame(plan.header, plan.checkpoint.string());
  const Scene scene = open_scene(scene_options, status, on_loading);
  const auto say = [&](const std::string& text) {
    if (!quiet && !text.empty()) std::cout << text << std::endl;
  };
  for (const std::string& text : scene.summary) say(text);
  say(describe_device(device));
  if (has_peers) say(describe_ranks(ranks.size(), plan));
  say(describe_slow_transport(ranks));
  const FittedPlan fitted = fit_to_scene(plan, scene);
  for (const std::string& text : fitted.lines) say(text);
  const TrainConfig& config = fitted.config.options;

  TrainProgressView progress(status, config);
  TrainHooks hooks = hooks_for(status);  // silent on other ranks
  hooks.stop_signal = &stop_signal();
  hooks.on_loading = on_loading;
  use_rank_team(ranks, config, hooks);
  if (is_first) hooks.on_progress = std::ref(progress);
  std::unique_ptr<Trainer> owned;
  hooks.on_last_files_written = [&] { record_previews(*owned, scene, folder, ranks); };
  std::optional<WatchedTraining> watched;
  std::unique_ptr<ViewServer> server;
  if (!options.view.empty()) {
    watched.emplace(fitted.config, scene, request_stop);
    watched->attach(hooks);
    watched->set_save([&] { return owned->save(); });
    server = start_view_server(*watched, parse_view_place(options.view), status);
  }
  owned = std::make_unique<Trainer>(fitted.config, scene, folder, hooks);
  Trainer& trainer = *owned;
  const double reading_s = steady_seconds() - reading_start_s;
  status.clear();
  say("photographs " + trainer.describe_images());
  if (!plan.checkpoint.empty()) resume(trainer, plan.checkpoint, is_first);
  throw_if_stopped();  // before anything is replaced
  if (plan.is_replaced) put_model_aside(folder, status);
  ranks.barrier("model folder");

  if (const auto forecast = trainer.forecast_memory()) say(describe_memory(*forecast));
  const TrainResult result = trainer.run();
  if (watched) watched->finish(result);
  status.clear();
  if (is_first) report_training(result, config, steady_seconds() - start_s);
  try {
    record_session(describe_machine(device), reading_s, result.output_s, trainer, scene, folder, ranks);
    if (is_first) {
      report_history(folder, result.interrupted ? 0 : config.max_gaussians);
      print_labelled("report", write_train_report(folder).string());
    }
  } catch (const IoError& error) {
    status.warn(detail::concat(error.what(), "; only the report is missing, write it with: b3dgs report ",
                               shell_quote(folder.root().string())));
  }
  if (is_first && !result.interrupted && !result.ply.empty()) drop_replaced_model(folder.root());
  // A launcher may end the remaining ranks after one has returned a nonzero exit code.
  ranks.barrier("end");
  if (is_first && result.interrupted) {
    std::cout << "stopped by a signal; resume with: b3dgs train --resume " << shell_quote(result.checkpoint.string())
              << options.rank.as_words() << (ranks.shares_gpus() ? " --device cuda" : "") << "\n";
  }
  drop_unshown_output();
  return result.interrupted ? 128 + static_cast<int>(ranks.max("stop signal", stop_signal())) : 0;
}

void check_view_options(const TrainCommandOptions& options, const RankPlan& plan) {
  if (options.view.empty()) return;
  parse_view_place(options.view);
  if (plan.n_to_start > 1 || plan.place.size > 1) {
    input_error(
        "--view: a training on several ranks cannot be shown yet; train on one (--ranks 1), or leave out --view");
  }
}

}  // namespace

int run_train(const std::vector<std::string>& words) {
  CommandLine line("train", "Train a scene.", "b3dgs train scenes/garden -m output/garden --eval");
  TrainCommandOptions options;
  line.add(options, "Run");
  line.add(resolve_options().config, "Training", {"source_path"});  // defaults for the help; given_options() has values
  add_original_options(line, OriginalScript::kTrain);
  line.set_notes(presets_help());
  if (!line.parse(join_view_place(words))) return 0;
  std::signal(SIGPIPE, SIG_IGN);

  const GivenOptions given = given_options(line, options.config);  // read once, since the file may be a pipe
  const std::string device = resolve_options(given).config.device;
  const RankPlan plan = plan_ranks(options.rank, device);
  check_view_options(options, plan);
  if (plan.n_to_start > 0) {
    if (!options.config.empty() && !std::filesystem::is_regular_file(options.config)) {
      input_error("--config ", options.config,
                  " can be read only once, but each rank reads it; write it to a file, or ", "train on one rank");
    }
    StatusLine silent = StatusLine::silent();
    // An error in the options appears once, not for each rank.
    make_plan(line, silent, options, given, plan.n_to_start, device);
    std::vector<std::string> all{"train"};
    all.insert(all.end(), words.begin(), words.end());
    return start_ranks(plan.n_to_start, all);
  }
  if (plan.place.size == 1) {
    try {
      return train(line, options, given, plan.device_name, *Communicator::alone());
    } catch (const StoppedEarly& stopped) {
      std::cout << stopped.what() << "; nothing was written\n";
      return 128 + stop_signal();
    }
  }
  const JoinedRank joined = join_ranks(plan);
  return run_as_rank(*joined.ranks, [&] {
    const MachineShare machine = share_machine(*joined.ranks);
    set_default_threads(machine.n_cores);
    return train(line, options, given, device_name(joined.device), *joined.ranks, machine);
  });
}

}  // namespace b3dgs
