#include "dist/launch/start_ranks.h"

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/random.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <set>

#include "core/check.h"
#include "core/text.h"
#include "dist/control/message.h"
#include "dist/control/socket.h"

namespace b3dgs {
namespace {

using Clock = std::chrono::steady_clock;

constexpr char kAddress[] = "127.0.0.1";
constexpr int kCannotStart = 127;  // as shells say it
constexpr std::array kPassedOn{SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2};

/// Holds back SIGCHLD and the signals to pass on, for sigtimedwait().
class BlockedSignals {
 public:
  BlockedSignals() {
    sigemptyset(&set_);
    for (const int signal : kPassedOn) sigaddset(&set_, signal);
    sigaddset(&set_, SIGCHLD);
    pthread_sigmask(SIG_BLOCK, &set_, &before_);
  }
  ~BlockedSignals() { restore(); }
  BlockedSignals(const BlockedSignals&) = delete;
  BlockedSignals& operator=(const BlockedSignals&) = delete;

  void restore() const { pthread_sigmask(SIG_SETMASK, &before_, nullptr); }

  /// The next signal, or 0 after a while without one.
  int wait() const {
    const timespec limit{0, 200000000};
    const int signal = sigtimedwait(&set_, nullptr, &limit);
    return signal > 0 ? signal : 0;
  }

 private:
  sigset_t set_{}, before_{};
};

/// Keeps strangers' processes from joining by mistake.
std::string random_job() {
  std::array<unsigned char, 16> bytes{};
  if (getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size())) {
    io_error("cannot get random bytes: ", std::strerror(errno));
  }
  std::string text;
  for (const unsigned char byte : bytes) text += print_to_string("%02x", byte);
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

struct Job {
  int size;
  std::string id;
  int port;
  int listening_socket;
};

/// This process's environment with the variables that read_rank_place() reads.
std::vector<std::string> environment_of(const Job& job, int rank) {
  std::vector<std::string> variables{"RANK=" + std::to_string(rank),
                                     "WORLD_SIZE=" + std::to_string(job.size),
                                     "LOCAL_RANK=" + std::to_string(rank),
                                     std::string("MASTER_ADDR=") + kAddress,
                                     "MASTER_PORT=" + std::to_string(job.port),
                                     "B3DGS_JOB=" + job.id};
  if (rank == 0) variables.push_back("B3DGS_LISTENING_SOCKET=" + std::to_string(job.listening_socket));
  std::set<std::string> names{"B3DGS_LISTENING_SOCKET"};
  for (const std::string& variable : variables) names.insert(variable.substr(0, variable.find('=')));
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string variable = *entry;
    if (names.count(variable.substr(0, variable.find('='))) == 0) variables.push_back(variable);
  }
  return variables;
}

/// In the child: only calls that are safe after fork().
[[noreturn]] void become_rank(const char* program, char* const* words, char* const* variables, pid_t parent,
                              int inherited_socket, const BlockedSignals& signals) {
  setpgid(0, 0);  // Ctrl-C in a terminal reaches the parent alone, which passes it on
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
  RankProcesses(int size, std::chrono::milliseconds grace) : pids_(static_cast<std::size_t>(size), 0), grace_(grace) {}
  ~RankProcesses() {  // only after an exception do any run still
    kill_all(SIGKILL);
    for (const pid_t pid : pids_) {
      if (pid > 0) waitpid(pid, nullptr, 0);
    }
  }
  RankProcesses(const RankProcesses&) = delete;
  RankProcesses& operator=(const RankProcesses&) = delete;

  void add(int rank, pid_t pid) { pids_[static_cast<std::size_t>(rank)] = pid; }

  /// Passes signals on, and waits until all have ended. @return as start_ranks()
  int wait(const BlockedSignals& signals) {
    while (note_ends()) {
      const int signal = signals.wait();
      if (signal != 0 && signal != SIGCHLD) {
        passed_on_.insert(signal);
        kill_all(signal);
      }
      if (result_ != 0 && !has_killed_ && Clock::now() > end_) {
        has_killed_ = true;
        kill_all(SIGKILL);
      }
    }
    return result_;
  }

 private:
  void kill_all(int signal) const {
    for (const pid_t pid : pids_) {
      if (pid > 0) kill(pid, signal);
    }
  }

  /// @return whether any still runs
  bool note_ends() {
    bool any_runs = false;
    for (std::size_t rank = 0; rank < pids_.size(); ++rank) {
      int status = 0;
      if (pids_[rank] > 0 && waitpid(pids_[rank], &status, WNOHANG) == pids_[rank]) {
        pids_[rank] = 0;
        note_end(rank, status);
      }
      any_runs = any_runs || pids_[rank] > 0;
    }
    return any_runs;
  }

  void note_end(std::size_t rank, int status) {
    const int code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    if (code == 0) return;
    const std::string who = detail::concat("error: rank ", rank, " of ", pids_.size());
    if (has_killed_ && code == 128 + SIGKILL) {
      std::fprintf(stderr, "%s was killed: it still ran %lld s after another one had failed\n", who.c_str(),
                   static_cast<long long>(grace_.count() / 1000));
      return;
    }
    if (WIFSIGNALED(status) && passed_on_.count(WTERMSIG(status)) == 0) {
      std::fprintf(stderr, "%s was killed by signal %d (%s)\n", who.c_str(), WTERMSIG(status),
                   strsignal(WTERMSIG(status)));
    } else if (code == kCannotStart) {
      std::fprintf(stderr, "%s could not be started\n", who.c_str());
    }
    if (result_ == 0) end_ = Clock::now() + grace_;
    if (result_ == 0 || result_ == PeerError::kExitCode) result_ = code;
  }

  std::vector<pid_t> pids_;  // 0: has ended
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
  const Job job{size, random_job(), port_of(listening), listening.fd()};
  std::vector<std::string> command{"b3dgs"};
  command.insert(command.end(), words.begin(), words.end());
  const WordArray arguments(command);

  std::fflush(nullptr);
  const BlockedSignals signals;
  const pid_t parent = getpid();
  RankProcesses ranks(size, options.grace);
  for (int rank = 0; rank < size; ++rank) {
    const WordArray variables(environment_of(job, rank));
    const pid_t pid = fork();
    if (pid == 0) {
      become_rank(options.program.c_str(), arguments.get(), variables.get(), parent,
                  rank == 0 ? job.listening_socket : -1, signals);
    }
    if (pid < 0) io_error("cannot start rank ", rank, " of ", size, ": ", std::strerror(errno));
    ranks.add(rank, pid);
  }
  return ranks.wait(signals);
}

}  // namespace b3dgs
