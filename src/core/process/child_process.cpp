#include "core/process/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <mutex>
#include <sstream>
#include <string_view>
#include <utility>

#include "core/check.h"
#include "core/stop_signals.h"

namespace b3dgs {
namespace {

constexpr std::chrono::seconds kGrace{5};  // from SIGTERM to SIGKILL
constexpr int kPollMs = 20;                // longest delay until an end of the child or a change of `stop` is noticed
constexpr std::size_t kReadBytes = 1 << 16, kMaxLine = 1 << 16;
// Maximum number of reads after the program has ended, which is enough to empty a full pipe of 1 MiB. There is a
// maximum, because processes that the program left behind may write forever.
constexpr int kLastReads = 64;

constexpr std::array kSignals{SIGINT, SIGTERM, SIGHUP};

std::mutex users_mutex;
int users = 0;
std::array<struct sigaction, kSignals.size()> actions_before;  // written only while our handler is not installed
std::atomic<int> last_signal{0};
static_assert(std::atomic<int>::is_always_lock_free);

bool is(const struct sigaction& action, void (*handler)(int)) {
  return (action.sa_flags & SA_SIGINFO) == 0 && action.sa_handler == handler;
}

/// Returns whether the signal ends the process at once.
bool ends_process_at_once(const struct sigaction& action) {
  return is(action, SIG_DFL) || is(action, end_by_signal);
}

extern "C" void note_signal(int signal, siginfo_t* info, void* context) {
  const int saved_errno = errno;
  last_signal = signal;
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    if (kSignals[i] != signal || ends_process_at_once(actions_before[i])) continue;
    if ((actions_before[i].sa_flags & SA_SIGINFO) != 0) {
      actions_before[i].sa_sigaction(signal, info, context);
    } else {
      actions_before[i].sa_handler(signal);
    }
  }
  errno = saved_errno;
}

struct Pipe {
  Descriptor read_end, write_end;
};

Pipe open_pipe() {
  std::array<int, 2> ends{};
  if (pipe2(ends.data(), O_CLOEXEC) != 0) io_error("cannot create a pipe: ", std::strerror(errno));
  return {Descriptor(ends[0]), Descriptor(ends[1])};
}

/// Writes without SIGPIPE, which would end this process. The signal is sent to the thread that writes.
ssize_t write_without_sigpipe(int file, const void* data, std::size_t bytes) {
  sigset_t pipe_signal, before, pending;
  sigemptyset(&pipe_signal);
  sigaddset(&pipe_signal, SIGPIPE);
  sigpending(&pending);
  const bool was_pending = sigismember(&pending, SIGPIPE) == 1;
  pthread_sigmask(SIG_BLOCK, &pipe_signal, &before);
  const ssize_t written = ::write(file, data, bytes);
  const int error = errno;
  if (written < 0 && error == EPIPE && !was_pending) {
    const timespec now{};
    sigtimedwait(&pipe_signal, nullptr, &now);
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  errno = error;
  return written;
}

bool begins_as_program(const std::string& file) {
  std::array<char, 4> first{};
  std::ifstream(file, std::ios::binary).read(first.data(), first.size());
  return std::memcmp(first.data(), "\177ELF", 4) == 0 || std::memcmp(first.data(), "#!", 2) == 0;
}

/// Starts a program. If util-linux is installed, the program ends when this process is killed. Otherwise COLMAP, for
/// example, would continue alone and keep its database locked. `input` -1 means none. Both outputs may be the same.
/// @return the error number, or 0
int spawn(std::string program, std::vector<std::string> words, int input, int output, int errors, pid_t& pid) {
  words.front() = program;
  const std::string setpriv = find_program("setpriv");
  if (!setpriv.empty() && begins_as_program(program)) {  // otherwise, the error is about this program
    words.insert(words.begin(), {setpriv, "--pdeathsig", "TERM", "--"});
    program = setpriv;
  }
  std::vector<char*> pointers;
  pointers.reserve(words.size() + 1);
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);

  posix_spawn_file_actions_t actions{};
  posix_spawn_file_actions_init(&actions);
  if (input >= 0) {
    posix_spawn_file_actions_adddup2(&actions, input, STDIN_FILENO);
  } else {
    posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  }
  posix_spawn_file_actions_adddup2(&actions, output, STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, errors, STDERR_FILENO);
#if __GLIBC_PREREQ(2, 34)
  // Close files that a library opened without O_CLOEXEC.
  posix_spawn_file_actions_addclosefrom_np(&actions, STDERR_FILENO + 1);
#endif
  posix_spawnattr_t attributes{};
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setpgroup(&attributes, 0);
  sigset_t none, defaults;
  sigemptyset(&none);
  posix_spawnattr_setsigmask(&attributes, &none);
  sigemptyset(&defaults);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) sigaddset(&defaults, signal);
  posix_spawnattr_setsigdefault(&attributes, &defaults);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);

  const int error = posix_spawn(&pid, program.c_str(), &actions, &attributes, pointers.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  posix_spawnattr_destroy(&attributes);
  return error;
}

}  // namespace

EndingSignals::EndingSignals() {
  const std::lock_guard lock(users_mutex);
  if (users++ > 0) return;
  last_signal = 0;
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    sigaction(kSignals[i], nullptr, &actions_before[i]);
    if (is(actions_before[i], SIG_IGN)) continue;
    struct sigaction action {};
    action.sa_sigaction = note_signal;
    action.sa_flags = SA_SIGINFO;
    sigemptyset(&action.sa_mask);
    sigaction(kSignals[i], &action, nullptr);
  }
}

EndingSignals::~EndingSignals() {
  const std::lock_guard lock(users_mutex);
  if (--users > 0) return;
  bool ends_process = false;
  for (std::size_t i = 0; i < kSignals.size(); ++i) {
    if (!is(actions_before[i], SIG_IGN)) sigaction(kSignals[i], &actions_before[i], nullptr);
    ends_process = ends_process || (ends_process_at_once(actions_before[i]) && kSignals[i] == last_signal);
  }
  if (ends_process) end_by_signal(last_signal);
}

int EndingSignals::received() const {
  return last_signal;
}

Child::Child(const std::vector<std::string>& argv, OnChildLine on_line, const std::atomic<int>* stop,
             OnChildBytes on_bytes, bool has_input)
    : on_line_(std::move(on_line)), on_bytes_(std::move(on_bytes)), stop_(stop) {
  B3DGS_CHECK(!argv.empty(), "no program");
  const std::string program = find_program(argv[0]);
  if (program.empty()) {
    input_error("program not found: ", argv[0], " (expected an executable ",
                argv[0].find('/') == std::string::npos ? "in a folder of PATH" : "file", "); install it");
  }
  Pipe text = open_pipe(), input, data;
  if (has_input) input = open_pipe();
  if (on_bytes_) data = open_pipe();
  // Enlarge these pipes from 64 KiB to 1 MiB, which Linux allows every user, so that writing a frame of 25 MB (3840 x
  // 2160 px) waits a sixteenth as often. If this fails, they stay as they are.
  for (const Descriptor* bulk : {&input.write_end, &data.write_end}) {
    if (*bulk) fcntl(bulk->fd(), F_SETPIPE_SZ, 1 << 20);
  }
  const Descriptor& output = on_bytes_ ? data.write_end : text.write_end;
  const int error = spawn(program, argv, input.read_end.fd(), output.fd(), text.write_end.fd(), pid_);
  if (error != 0) io_error("cannot start ", program, ": ", std::strerror(error));
  text_ = std::move(text.read_end);
  data_ = std::move(data.read_end);
  input_ = std::move(input.write_end);
  for (const Descriptor* own : {&text_, &data_, &input_}) {
    if (*own) fcntl(own->fd(), F_SETFL, fcntl(own->fd(), F_GETFL) | O_NONBLOCK);
  }
}

Child::~Child() {
  if (is_reaped_) return;
  kill(-pid_, SIGKILL);
  reap();
}

bool Child::write(const void* data, std::size_t bytes) {
  B3DGS_CHECK(!is_reaped_, "write() after finish()");
  const char* from = static_cast<const char*>(data);
  while (bytes > 0) {
    end_if_asked();
    if (is_ending_ || has_ended() || !input_) return false;
    wait_for_io(/*wants_to_write=*/true);
    read_output();
    const ssize_t written = write_without_sigpipe(input_.fd(), from, bytes);
    if (written < 0 && errno != EAGAIN && errno != EINTR) {
      input_.close();
      return false;
    }
    if (written > 0) {
      from += written;
      bytes -= static_cast<std::size_t>(written);
    }
  }
  return true;
}

ChildResult Child::finish() {
  B3DGS_CHECK(!is_reaped_, "finish() was called twice");
  input_.close();
  while (!has_ended()) {
    end_if_asked();
    wait_for_io(/*wants_to_write=*/false);
    read_output();
  }
  for (int i = 0; i < kLastReads && read_output(); ++i) {
  }
  if (!line_.empty()) end_line();
  // While the ended program is not reaped, no other process group can have its ID.
  if (is_ending_) kill(-pid_, SIGKILL);
  ChildResult result = reap();
  if (is_ending_ && result.signal == 0) result = {0, SIGTERM};
  return result;
}

bool Child::has_ended() const {
  siginfo_t info{};
  return waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid == pid_;
}

void Child::end_if_asked() {
  if (!is_ending_ && (signals_.received() != 0 || (stop_ != nullptr && *stop_ != 0))) {
    is_ending_ = true;
    kill_at_ = std::chrono::steady_clock::now() + kGrace;
    kill(-pid_, SIGTERM);
    kill(-pid_, SIGCONT);  // a stopped process would not act on it
  }
  if (is_ending_ && std::chrono::steady_clock::now() >= kill_at_) kill(-pid_, SIGKILL);
}

void Child::wait_for_io(bool wants_to_write) {
  // poll() skips closed descriptors, which are negative.
  pollfd files[]{{text_.fd(), POLLIN, 0}, {data_.fd(), POLLIN, 0}, {wants_to_write ? input_.fd() : -1, POLLOUT, 0}};
  poll(files, std::size(files), kPollMs);
}

/// Reads one buffer of each output. Returns false if there is nothing to read at the moment.
bool Child::read_output() {
  const auto read_some = [](Descriptor& from, const auto& take) {
    std::array<char, kReadBytes> buffer;
    const ssize_t bytes = from ? ::read(from.fd(), buffer.data(), buffer.size()) : -1;
    if (bytes > 0) take(buffer.data(), static_cast<std::size_t>(bytes));
    if (bytes == 0) from.close();
    return bytes > 0;
  };
  const bool has_text = read_some(text_, [this](const char* text, std::size_t bytes) { add_text(text, bytes); });
  return read_some(data_, on_bytes_) || has_text;
}

void Child::add_text(const char* text, std::size_t bytes) {
  for (const char c : std::string_view(text, bytes)) {
    const bool is_second_half = c == '\n' && after_return_;
    after_return_ = c == '\r';
    if (is_second_half) continue;
    const bool is_end = c == '\n' || c == '\r';
    if (!is_end) line_ += c;
    if (is_end || line_.size() >= kMaxLine) end_line();
  }
}

void Child::end_line() {
  if (on_line_) on_line_(line_);
  line_.clear();
}

ChildResult Child::reap() {
  int status = 0;
  while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
  }
  is_reaped_ = true;
  if (WIFSIGNALED(status)) return {0, WTERMSIG(status)};
  return {WEXITSTATUS(status), 0};
}

ChildResult run_program_lines(const std::vector<std::string>& argv, const OnChildLine& on_line,
                              const std::atomic<int>* stop, const OnChildBytes& on_bytes) {
  return Child(argv, on_line, stop, on_bytes, /*has_input=*/false).finish();
}

std::string find_program(const std::string& name) {
  namespace fs = std::filesystem;
  const auto is_program = [](const std::string& path) {
    std::error_code error;
    return fs::is_regular_file(path, error) && access(path.c_str(), X_OK) == 0;
  };
  if (name.empty()) return "";
  if (name.find('/') != std::string::npos) return is_program(name) ? name : "";
  const char* const folders = std::getenv("PATH");
  std::istringstream list(folders == nullptr ? "/usr/local/bin:/usr/bin:/bin" : folders);
  for (std::string folder; std::getline(list, folder, ':');) {
    const std::string path = (folder.empty() ? "." : folder) + "/" + name;
    if (is_program(path)) return path;
  }
  return "";
}

std::string describe(const ChildResult& result) {
  if (result.signal == 0) return "exit code " + std::to_string(result.exit_code);
  return "ended by signal " + std::to_string(result.signal) + " (" + strsignal(result.signal) + ")";
}

}  // namespace b3dgs
