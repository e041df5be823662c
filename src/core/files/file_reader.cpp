#include "core/files/file_reader.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <system_error>

#include "core/check.h"

namespace b3dgs {
namespace {

constexpr std::size_t kBufferBytes = std::size_t{1} << 18;

[[noreturn]] void fail_to_open(const std::filesystem::path& path, const std::string& reason) {
  input_error("file cannot be read: ", path.string(), " (", reason, ")");
}

void require_regular(const std::filesystem::path& path, mode_t mode) {
  if (S_ISREG(mode)) return;
  const char* const kind = S_ISDIR(mode)    ? "a folder"
                           : S_ISFIFO(mode) ? "a FIFO"
                           : S_ISSOCK(mode) ? "a socket"
                                            : "a device";
  input_error("file cannot be read: ", path.string(), " (expected a regular file, found ", kind,
              "); copy its content into a file");
}

/// Returns the number N of a path /dev/fd/N, 0 for /dev/stdin, and -1 for other paths.
int inherited_file(const std::filesystem::path& path) {
  constexpr std::string_view kFolder = "/dev/fd/";
  if (path == "/dev/stdin") return STDIN_FILENO;
  const std::string& text = path.native();
  if (text.compare(0, kFolder.size(), kFolder) != 0) return -1;
  int number = -1;
  const char* const end = text.data() + text.size();
  return std::from_chars(text.data() + kFolder.size(), end, number).ptr == end ? number : -1;
}

/// Reads a pipe to its end.
std::string read_pipe(const std::filesystem::path& path, int pipe) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 26;
  std::string text;
  std::vector<char> buffer(kBufferBytes);
  for (;;) {
    const ssize_t bytes = ::read(pipe, buffer.data(), buffer.size());
    if (bytes < 0 && errno == EINTR) continue;
    if (bytes == 0) return text;
    if (bytes < 0) fail_to_open(path, std::strerror(errno));
    text.append(buffer.data(), static_cast<std::size_t>(bytes));
    if (text.size() > kMostBytes) fail_to_open(path, detail::concat("a pipe with more than ", kMostBytes, " bytes"));
  }
}

}  // namespace

Descriptor open_for_reading(const std::filesystem::path& path) {
  struct stat status {};
  // Check before opening, because opening fails for a socket and may start something in a device.
  if (::stat(path.c_str(), &status) == 0) require_regular(path, status.st_mode);
  // O_NONBLOCK, because a FIFO may have replaced the file meanwhile.
  Descriptor file(::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
  if (!file || ::fstat(file.fd(), &status) != 0) fail_to_open(path, std::strerror(errno));
  require_regular(path, status.st_mode);
  return file;
}

std::string read_whole_file(const std::filesystem::path& path) {
  struct stat status {};
  const int inherited = inherited_file(path);
  if (inherited >= 0 && ::fstat(inherited, &status) == 0 && S_ISFIFO(status.st_mode)) return read_pipe(path, inherited);
  FileReader file(path);
  std::string text(file.remaining(), '\0');
  file.read_bytes(text.data(), text.size());
  return text;
}

std::optional<std::string> read_file_if_there(const std::filesystem::path& path) {
  std::error_code error;
  const auto type = std::filesystem::status(path, error).type();
  if (type == std::filesystem::file_type::not_found) return std::nullopt;
  return read_whole_file(path);
}

FileReader::FileReader(std::filesystem::path path)
    : path_(std::move(path)), file_(open_for_reading(path_)), buffer_(kBufferBytes), data_(buffer_.data()) {
  struct stat status {};
  if (::fstat(file_.fd(), &status) != 0) fail_to_read(std::strerror(errno));
  size_ = static_cast<std::uint64_t>(status.st_size);
}

FileReader::FileReader(std::string name, std::string_view bytes)
    : path_(std::move(name)), size_(bytes.size()), data_(bytes.data()), end_(bytes.size()) {}

void FileReader::fail_to_read(const char* reason) const {
  fail_to_open(path_, reason);
}

void FileReader::begin_record(const char* kind, std::uint64_t index, std::uint64_t total) {
  record_kind_ = kind;
  record_ = index + 1;
  record_count_ = total;
}

void FileReader::expect_records(const char* kind, std::uint64_t count, std::uint64_t min_bytes_each) const {
  if (count <= remaining() / min_bytes_each) return;
  input_error("file too short: ", name(), " (expected ", count, " ", kind, " of at least ", min_bytes_each,
              " bytes each, found ", remaining(),
              " bytes); it is truncated, damaged or in another format: copy or export it again");
}

void FileReader::expect_end() const {
  if (remaining() == 0) return;
  input_error("unexpected data: ", name(), " (", remaining(), " bytes follow after the last record, at byte ",
              position_, "); the file is damaged or in another format: copy or export it again");
}

bool FileReader::fill() {
  if (!file_) return false;
  next_ = end_ = 0;
  for (;;) {
    const ssize_t bytes = ::read(file_.fd(), buffer_.data(), buffer_.size());
    if (bytes < 0 && errno == EINTR) continue;
    if (bytes < 0) fail_to_read(std::strerror(errno));
    end_ = static_cast<std::size_t>(bytes);
    return bytes > 0;
  }
}

void FileReader::fail_truncated(std::uint64_t wanted) const {
  const std::string record =
      record_ > 0 ? detail::concat(record_kind_, " ", record_, " of ", record_count_) : "its header";
  input_error("truncated file: ", name(), " (ends in ", record, " at byte ", size_, ", expected ", wanted,
              " more bytes); copy or export it again");
}

void FileReader::read_bytes(void* to, std::size_t bytes) {
  if (bytes > remaining()) fail_truncated(bytes - remaining());
  char* out = static_cast<char*>(to);
  while (bytes > 0) {
    if (next_ == end_ && !fill()) fail_truncated(bytes);  // the file became shorter meanwhile
    const std::size_t part = std::min(bytes, end_ - next_);
    std::memcpy(out, data_ + next_, part);
    out += part;
    bytes -= part;
    next_ += part;
    position_ += part;
  }
}

void FileReader::skip(std::uint64_t bytes) {
  if (bytes > remaining()) fail_truncated(bytes - remaining());
  position_ += bytes;
  const std::uint64_t buffered = std::min<std::uint64_t>(bytes, end_ - next_);
  next_ += buffered;
  if (bytes > buffered && ::lseek(file_.fd(), static_cast<off_t>(bytes - buffered), SEEK_CUR) < 0) {
    fail_to_read(std::strerror(errno));
  }
}

std::string FileReader::read_c_string() {
  std::string text;
  for (char c = read<char>(); c != '\0'; c = read<char>()) text += c;
  return text;
}

bool FileReader::read_line(std::string_view& line) {
  long_line_.clear();
  bool is_whole = false;
  while (!is_whole) {
    if (next_ == end_ && !fill()) {
      if (long_line_.empty()) return false;
      break;
    }
    const char* begin = data_ + next_;
    const char* newline = static_cast<const char*>(std::memchr(begin, '\n', end_ - next_));
    is_whole = newline != nullptr;
    line = std::string_view(begin, is_whole ? static_cast<std::size_t>(newline - begin) : end_ - next_);
    const std::size_t taken = line.size() + (is_whole ? 1 : 0);
    next_ += taken;
    position_ += std::min<std::uint64_t>(taken, remaining());
    if (!is_whole || !long_line_.empty()) long_line_.append(line);
  }
  if (!long_line_.empty()) line = long_line_;
  ++line_number_;
  if (line_number_ == 1 && line.substr(0, 3) == "\xEF\xBB\xBF") line.remove_prefix(3);  // a byte order mark
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  return true;
}

std::string FileReader::place() const {
  return detail::concat(name(), ":", line_number_);
}

}  // namespace b3dgs
