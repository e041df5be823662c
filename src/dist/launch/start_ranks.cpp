#include "dist/launch/start_ranks.h"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <random>
#include <set>
#include <utility>

#include "core/check.h"
#include "core/text.h"
#include "dist/control/message.h"
#include "dist/control/socket.h"

namespace b3dgs {
namespace {

using Clock = std::chrono::steady_clock;

constexpr char kAddress[] = "127.0.0.1";
constexpr int kCannotStart = 127;  // as in shells

/// Blocks SIGCHLD and the signals to pass on, for sigtimedwait().
class BlockedSignals {
 public:
  BlockedSignals() {
    sigemptyset(&set_);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGCHLD}) sigaddset(&set_, signal);
    pthread_sigmask(SIG_BLOCK, &set_, &before_);
  }
  ~BlockedSignals() { restore(); }
  BlockedSignals(const BlockedSignals&) = delete;
  BlockedSignals& operator=(const BlockedSignals&) = delete;

  void restore() const { pthread_sigmask(SIG_SETMASK, &before_, nullptr); }

  /// Returns the next signal to pass on, or 0 if a process has ended or after a while.
  int wait() const {
    const timespec limit{0, 200000000};
    const int signal = sigtimedwait(&set_, nullptr, &limit);
    return signal > 0 && signal != SIGCHLD ? signal : 0;
  }

 private:
  sigset_t set_{}, before_{};
};

/// Prevents unrelated processes from joining by mistake.
std::string random_job() {
  std::random_device random;
  std::string text;
  for (int i = 0; i < 4; ++i) text += print_to_string("%08x", random());
  return text;
}

/// Strings as the array of pointers that execve() takes.
class WordArray {
 public:
  explicit WordArray(std::vector<std::string> words) : words_(std::move(words)) {
    for (std::string& word : words_) pointers_.push_back(word.data());
    pointers_.push_back(nullptr);
  }
  char* const* get() const { return pointers_.data(); }

 private:
  std::vector<std::string> words_;
  std::vector<char*> pointers_;
};

/// Returns the environment of this process, with `variables` ("NAME=value") replacing its own.
std::vector<std::string> environment_with(std::vector<std::string> variables) {
  const auto name_of = [](const std::string& variable) { return variable.substr(0, variable.find('=')); };
  std::set<std::string> names{"B3DGS_LISTENING_SOCKET"};
  for (const std::string& variable : variables) names.insert(name_of(variable));
  for (char** entry = environ; *entry != nullptr; ++entry) {
    if (names.count(name_of(*entry)) == 0) variables.emplace_back(*entry);
  }
  return variables;
}

/// Runs in the child, so it only makes calls that are safe after fork().
[[noreturn]] void become_rank(const char* program, char* const* words, char* const* variables, pid_t parent,
                              int inherited_socket, const BlockedSignals& signals) {
  setpgid(0, 0);  // Ctrl-C in a terminal reaches only the parent, which passes it on
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (getppid() != parent) _exit(1);
  const int nothing = open("/dev/null", O_RDONLY);
  if (nothing >= 0) dup2(nothing, STDIN_FILENO);
  if (inherited_socket >= 0) fcntl(inherited_socket, F_SETFD, 0);
  signals.restore();
  execve(program, words, variables);
  _exit(kCannotStart);
}

class RankProcesses {
 public:
  explicit RankProcesses(std::chrono::milliseconds grace) : grace_(grace) {}
  ~RankProcesses() {  // only after an exception are any still running
    kill_all(SIGKILL);
    for (const pid_t pid : pids_) {
      while (pid > 0 && waitpid(pid, nullptr, 0) < 0 && errno == EINTR) {
      }
    }
  }
  RankProcesses(const RankProcesses&) = delete;
  RankProcesses& operator=(const RankProcesses&) = delete;

  void add(pid_t pid) { pids_.push_back(pid); }

  /// Passes signals on, and waits until all have ended. @return as start_ranks()
  int wait(const BlockedSignals& signals) {
    while (note_ends()) {
      if (const int signal = signals.wait()) {
        passed_on_.insert(signal);
        kill_all(signal);
      }
      if (result_ != 0 && Clock::now() > end_ && !std::exchange(has_killed_, true)) kill_all(SIGKILL);
    }
    return result_;
  }

 private:
  void kill_all(int signal) const {
    for (const pid_t pid : pids_) {
      if (pid > 0) kill(pid, signal);
    }
  }

  /// @return whether any is still running
  bool note_ends() {
    for (std::size_t rank = 0; rank < pids_.size(); ++rank) {
      int status = 0;
      if (pids_[rank] > 0 && waitpid(pids_[rank], &status, WNOHANG) > 0) {
        pids_[rank] = 0;
        note_end(rank, status);
      }
    }
    return std::any_of(pids_.begin(), pids_.end(), [](pid_t pid) { return pid > 0; });
  }

  void note_end(std::size_t rank, int status) {
    const int signal = WIFSIGNALED(status) ? WTERMSIG(status) : 0;
    const int code = signal > 0 ? 128 + signal : WEXITSTATUS(status);
    if (code == 0) return;
    std::string end;
    if (has_killed_ && signal == SIGKILL) {
      end = detail::concat("was killed: it still ran ", grace_.count() / 1000, " s after another one had failed");
    } else if (signal > 0 && passed_on_.count(signal) == 0) {
      end = detail::concat("was killed by signal ", signal, " (", strsignal(signal), ')');
    } else if (code == kCannotStart) {
      end = "could not be started";
    }
    if (!end.empty()) {
      std::fputs(detail::concat("error: rank ", rank, " of ", pids_.size(), ' ', end, '\n').c_str(), stderr);
    }
    if (has_killed_ && signal == SIGKILL) return;
    if (result_ == 0) end_ = Clock::now() + grace_;
    if (result_ == 0 || result_ == PeerError::kExitCode) result_ = code;
  }

  std::vector<pid_t> pids_;  // by rank; 0 if it has ended
  std::chrono::milliseconds grace_;
  std::set<int> passed_on_;
  int result_ = 0;
  bool has_killed_ = false;
  Clock::time_point end_{};
};

}  // namespace

int start_ranks(int size, const std::vector<std::string>& words, const StartOptions& options) {
  B3DGS_CHECK(size >= 1, "size is ", size);
  // Rank 0 inherits the socket, so that nobody can take the port in between.
  const Socket listening = listen_at(kAddress, 0);
  std::vector<std::string> command{"b3dgs"};
  command.insert(command.end(), words.begin(), words.end());
  const WordArray arguments(command);
  const std::string job = random_job();

  std::fflush(nullptr);
  const BlockedSignals signals;
  const pid_t parent = getpid();
  RankProcesses ranks(options.grace);
  for (int rank = 0; rank < size; ++rank) {
    const int socket = rank == 0 ? listening.fd() : -1;
    std::vector<std::string> own{detail::concat("RANK=", rank),
                                 detail::concat("WORLD_SIZE=", size),
                                 detail::concat("LOCAL_RANK=", rank),
                                 detail::concat("MASTER_ADDR=", kAddress),
                                 detail::concat("MASTER_PORT=", port_of(listening)),
                                 "B3DGS_JOB=" + job};
    if (rank == 0) own.push_back(detail::concat("B3DGS_LISTENING_SOCKET=", socket));
    const WordArray variables(environment_with(std::move(own)));
    const pid_t pid = fork();
    if (pid == 0) become_rank(options.program.c_str(), arguments.get(), variables.get(), parent, socket, signals);
    if (pid < 0) io_error("cannot start rank ", rank, " of ", size, ": ", std::strerror(errno));
    ranks.add(pid);
  }
  return ranks.wait(signals);
}

}  // namespace b3dgs
