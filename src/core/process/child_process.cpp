#include "core/process/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>

#include "core/check.h"
#include "core/descriptor.h"
#include "core/process/ending_signals.h"

namespace b3dgs {
namespace {

using SteadyClock = std::chrono::steady_clock;

constexpr std::chrono::seconds kGrace{5};  // from SIGTERM to SIGKILL
constexpr int kPollMs = 20;                // how long an end of the child or a change of `stop` may go unnoticed
constexpr std::size_t kReadBytes = 1 << 16;
constexpr int kLastReads = 64;  // what a pipe may hold; children that an ended program left behind may write for ever

struct Pipe {
  Descriptor read_end, write_end;
};

Pipe open_pipe() {
  std::array<int, 2> ends{};
  if (pipe2(ends.data(), O_CLOEXEC) != 0) io_error("cannot create a pipe: ", std::strerror(errno));
  return {Descriptor(ends[0]), Descriptor(ends[1])};
}

/// Lets a pipe hold 1 MiB, which Linux lets every user have, instead of 64 KiB: of a frame of 25 MB (3840 x 2160 px),
/// the writer then waits for the reader a sixteenth as often. Where it is refused, the pipe stays as it is.
void hold_more(const Descriptor& write_end) {
  fcntl(write_end.fd(), F_SETPIPE_SZ, 1 << 20);
}

void never_wait(const Descriptor& descriptor) {
  fcntl(descriptor.fd(), F_SETFL, fcntl(descriptor.fd(), F_GETFL) | O_NONBLOCK);
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

/// Calls a function for each line, without its end: "\n", "\r\n" or "\r". Lines above 64 KiB come in parts.
class LineSplitter {
 public:
  explicit LineSplitter(std::function<void(const std::string& line)> on_line) : on_line_(std::move(on_line)) {}

  void add(const char* text, std::size_t bytes) {
    for (std::size_t i = 0; i < bytes; ++i) {
      const char c = text[i];
      const bool is_second_half = c == '\n' && after_return_;
      after_return_ = c == '\r';
      if (is_second_half) continue;
      if (c == '\n' || c == '\r') {
        end_line();
      } else {
        line_ += c;
        if (line_.size() >= kMaxLine) end_line();
      }
    }
  }

  /// Passes on a last line that has no end.
  void finish() {
    if (!line_.empty()) end_line();
  }

 private:
  static constexpr std::size_t kMaxLine = 1 << 16;

  void end_line() {
    if (on_line_) on_line_(line_);
    line_.clear();
  }

  std::function<void(const std::string& line)> on_line_;
  std::string line_;
  bool after_return_ = false;
};

bool begins_as_program(const std::string& file) {
  std::array<char, 4> first{};
  std::ifstream(file, std::ios::binary).read(first.data(), first.size());
  return std::memcmp(first.data(), "\177ELF", 4) == 0 || std::memcmp(first.data(), "#!", 2) == 0;
}

/// What posix_spawn() shall do in the child before it executes the program.
class SpawnSettings {
 public:
  /// `input` -1: none. Both outputs may be the same.
  SpawnSettings(int input, int output, int errors) {
    posix_spawn_file_actions_init(&actions_);
    if (input >= 0) {
      posix_spawn_file_actions_adddup2(&actions_, input, STDIN_FILENO);
    } else {
      posix_spawn_file_actions_addopen(&actions_, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    }
    posix_spawn_file_actions_adddup2(&actions_, output, STDOUT_FILENO);
    posix_spawn_file_actions_adddup2(&actions_, errors, STDERR_FILENO);
#if __GLIBC_PREREQ(2, 34)
    // Files that a library opened without O_CLOEXEC.
    posix_spawn_file_actions_addclosefrom_np(&actions_, STDERR_FILENO + 1);
#endif
    posix_spawnattr_init(&attributes_);
    posix_spawnattr_setpgroup(&attributes_, 0);
    sigset_t none, defaults;
    sigemptyset(&none);
    posix_spawnattr_setsigmask(&attributes_, &none);
    sigemptyset(&defaults);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) sigaddset(&defaults, signal);
    posix_spawnattr_setsigdefault(&attributes_, &defaults);
    posix_spawnattr_setflags(&attributes_, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
  }
  ~SpawnSettings() {
    posix_spawn_file_actions_destroy(&actions_);
    posix_spawnattr_destroy(&attributes_);
  }
  SpawnSettings(const SpawnSettings&) = delete;
  SpawnSettings& operator=(const SpawnSettings&) = delete;

  /// If this process is killed, the program ends, too, where util-linux is installed: otherwise COLMAP, for example,
  /// would go on alone, and keep its database locked. @return the error number, or 0
  int spawn(std::string program, std::vector<std::string> words, pid_t& pid) const {
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
    return posix_spawn(&pid, program.c_str(), &actions_, &attributes_, pointers.data(), environ);
  }

 private:
  posix_spawn_file_actions_t actions_{};
  posix_spawnattr_t attributes_{};
};

}  // namespace

/// A running program.
class Child {
 public:
  /// Without `on_bytes`, both outputs are passed on as lines.
  Child(const std::vector<std::string>& argv, const OnChildLine& on_line, const OnChildBytes& on_bytes,
        const std::atomic<int>* stop, bool has_input)
      : lines_(on_line), on_bytes_(on_bytes), stop_(stop) {
    B3DGS_CHECK(!argv.empty(), "no program");
    const std::string program = find_program(argv[0]);
    if (program.empty()) {
      input_error("program not found: ", argv[0], " (expected an executable ",
                  argv[0].find('/') == std::string::npos ? "in a folder of PATH" : "file", "); install it");
    }
    Pipe text = open_pipe(), input, data;
    if (has_input) input = open_pipe();
    if (on_bytes_) data = open_pipe();
    for (const Descriptor* bulk : {&input.write_end, &data.write_end}) {
      if (*bulk) hold_more(*bulk);
    }
    const Descriptor& output = on_bytes_ ? data.write_end : text.write_end;
    const int error = SpawnSettings(input.read_end.fd(), output.fd(), text.write_end.fd()).spawn(program, argv, pid_);
    if (error != 0) io_error("cannot start ", program, ": ", std::strerror(error));
    text_ = std::move(text.read_end);
    data_ = std::move(data.read_end);
    input_ = std::move(input.write_end);
    for (const Descriptor* own : {&text_, &data_, &input_}) {
      if (*own) never_wait(*own);
    }
  }

  ~Child() {
    if (is_reaped_) return;
    kill(-pid_, SIGKILL);
    reap();
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  bool write(const char* data, std::size_t bytes) {
    while (bytes > 0) {
      end_if_asked();
      if (is_ending_ || has_ended() || !input_) return false;
      wait_for_io(/*wants_to_write=*/true);
      read_output();
      const ssize_t written = write_without_sigpipe(input_.fd(), data, bytes);
      if (written < 0 && errno != EAGAIN && errno != EINTR) {
        input_.close();
        return false;
      }
      if (written > 0) {
        data += written;
        bytes -= static_cast<std::size_t>(written);
      }
    }
    return true;
  }

  ChildResult finish() {
    input_.close();
    while (!has_ended()) {
      end_if_asked();
      wait_for_io(/*wants_to_write=*/false);
      read_output();
    }
    for (int i = 0; i < kLastReads && read_output(); ++i) {
    }
    lines_.finish();
    // While the ended program is not reaped, no other process group can have its number.
    if (is_ending_) kill(-pid_, SIGKILL);
    ChildResult result = reap();
    if (is_ending_ && result.signal == 0) result = {0, SIGTERM};
    return result;
  }

 private:
  bool has_ended() const {
    siginfo_t info{};
    return waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid == pid_;
  }

  void end_if_asked() {
    if (!is_ending_ && (signals_.received() != 0 || (stop_ != nullptr && *stop_ != 0))) {
      is_ending_ = true;
      kill_at_ = SteadyClock::now() + kGrace;
      kill(-pid_, SIGTERM);
      kill(-pid_, SIGCONT);  // a stopped process would not act on it
    }
    if (is_ending_ && SteadyClock::now() >= kill_at_) kill(-pid_, SIGKILL);
  }

  void wait_for_io(bool wants_to_write) {
    std::array<pollfd, 3> files{};
    files[0] = {text_.fd(), POLLIN, 0};  // poll() passes over closed ones, which are negative
    files[1] = {data_.fd(), POLLIN, 0};
    files[2] = {wants_to_write ? input_.fd() : -1, POLLOUT, 0};
    poll(files.data(), files.size(), kPollMs);
  }

  /// Reads one buffer of each output. False if there is nothing to read at the moment.
  bool read_output() {
    const bool has_text = read_some(text_, [this](const char* text, std::size_t bytes) { lines_.add(text, bytes); });
    return read_some(data_, on_bytes_) || has_text;
  }

  template <class Take>
  static bool read_some(Descriptor& from, const Take& take) {
    if (!from) return false;
    std::array<char, kReadBytes> buffer;
    const ssize_t bytes = ::read(from.fd(), buffer.data(), buffer.size());
    if (bytes > 0) take(buffer.data(), static_cast<std::size_t>(bytes));
    if (bytes == 0) from.close();
    return bytes > 0;
  }

  ChildResult reap() {
    int status = 0;
    while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
    }
    is_reaped_ = true;
    if (WIFSIGNALED(status)) return {0, WTERMSIG(status)};
    return {WEXITSTATUS(status), 0};
  }

  EndingSignals signals_;  // first, so that a signal between this and the start of the program is not lost
  LineSplitter lines_;
  OnChildBytes on_bytes_;
  const std::atomic<int>* stop_;
  Descriptor text_, data_, input_;
  pid_t pid_ = -1;
  bool is_reaped_ = false;
  bool is_ending_ = false;
  SteadyClock::time_point kill_at_{};
};

ChildInput::ChildInput(const std::vector<std::string>& argv, const OnChildLine& on_line, const std::atomic<int>* stop)
    : child_(std::make_unique<Child>(argv, on_line, OnChildBytes(), stop, /*has_input=*/true)) {}

ChildInput::~ChildInput() = default;

bool ChildInput::write(const void* data, std::size_t bytes) {
  B3DGS_CHECK(child_ != nullptr, "write() after finish()");
  return child_->write(static_cast<const char*>(data), bytes);
}

ChildResult ChildInput::finish() {
  B3DGS_CHECK(child_ != nullptr, "finish() was called twice");
  const ChildResult result = child_->finish();
  child_.reset();
  return result;
}

ChildResult run_program_lines(const std::vector<std::string>& argv, const OnChildLine& on_line,
                              const std::atomic<int>* stop, const OnChildBytes& on_bytes) {
  return Child(argv, on_line, on_bytes, stop, /*has_input=*/false).finish();
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
