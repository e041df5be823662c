#include "support/run_program.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/capability.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <thread>

#include "support/files.h"
#include "support/temp_dir.h"

namespace b3dgs::test {
namespace {

using SteadyClock = std::chrono::steady_clock;

/// Runs in the child: redirects standard streams to files, sets limits, then runs the program.
[[noreturn]] void become_program(char* const* argv, const RunOptions& options, const std::string& out,
                                 const std::string& err) {
  const auto redirect = [](int stream, const char* file, int flags) {
    const int opened = open(file, flags, 0600);
    if (opened < 0 || dup2(opened, stream) < 0) _exit(126);
  };
  // A script that runs the tests in the background ignores SIGINT, and the program would, too.
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) std::signal(signal, SIG_DFL);
  redirect(STDIN_FILENO, "/dev/null", O_RDONLY);
  redirect(STDOUT_FILENO, out.c_str(), O_WRONLY | O_CREAT | O_TRUNC);
  redirect(STDERR_FILENO, err.c_str(), O_WRONLY | O_CREAT | O_TRUNC);
  if (!options.folder.empty() && chdir(options.folder.c_str()) != 0) _exit(126);
  if (options.file_size_limit > 0) {
    const rlim_t limit = static_cast<rlim_t>(options.file_size_limit);
    const rlimit limits{limit, limit};
    std::signal(SIGXFSZ, SIG_IGN);  // then write() fails instead
    if (setrlimit(RLIMIT_FSIZE, &limits) != 0) _exit(126);
  }
  // Without this capability, root needs permissions like others. Other users do not have it and cannot drop it.
  if (options.obeys_permissions && prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE) != 0 && geteuid() == 0) _exit(126);
  execv(argv[0], argv);
  _exit(127);
}

}  // namespace

Outcome run_b3dgs(const std::vector<std::string>& words, const RunOptions& options) {
  const TempDir streams;
  const std::string out = (streams.path() / "out").string(), err = (streams.path() / "err").string();
  std::vector<std::string> command{options.program};
  command.insert(command.end(), words.begin(), words.end());
  std::vector<char*> argv;
  for (std::string& word : command) argv.push_back(word.data());
  argv.push_back(nullptr);

  const pid_t child = fork();
  if (child == 0) become_program(argv.data(), options, out, err);
  int status = 0;
  bool is_signalled = false;
  const auto end = SteadyClock::now() + std::chrono::minutes(2);
  while (waitpid(child, &status, WNOHANG) == 0) {
    if (options.signal_when && !is_signalled && options.signal_when()) {
      for (int i = 0; i < options.n_signals; ++i) {
        kill(child, options.signal);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      is_signalled = true;
    }
    if (SteadyClock::now() > end) {
      ADD_FAILURE() << "b3dgs " << (words.empty() ? "" : words[0]) << " does not end";
      kill(child, SIGKILL);
      waitpid(child, &status, 0);
      break;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  Outcome outcome;
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  outcome.out = read_bytes(out);
  outcome.err = read_bytes(err);
  return outcome;
}

int run_shell(const std::filesystem::path& folder, const std::string& command) {
  const int status = std::system((command + " > '" + (folder / "out").string() + "' 2>&1").c_str());
  return WEXITSTATUS(status);
}

}  // namespace b3dgs::test
