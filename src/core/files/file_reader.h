// Sequential reading of a file, or of bytes in memory. The reader knows how many bytes remain, so it checks counts and
// sizes in a damaged file before memory is allocated for them.
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "core/descriptor.h"

namespace b3dgs {

/// Opens a file for reading, without waiting for anything. @throws InputError if the file is missing, unreadable, or a
/// folder, FIFO, device or socket
Descriptor open_for_reading(const std::filesystem::path& path);

/// Returns the content of a file that open_for_reading() accepts, or of a pipe that the shell has opened for this
/// process, as in `--config <(...)`. @throws InputError
std::string read_whole_file(const std::filesystem::path& path);

/// Returns the content of a file, or nullopt if it does not exist. @throws InputError for anything else that cannot be
/// read
std::optional<std::string> read_file_if_there(const std::filesystem::path& path);

class FileReader {
 public:
  /// @throws InputError if the file is missing, unreadable or not a regular file
  explicit FileReader(std::filesystem::path path);
  /// Reads `bytes`, which must outlive the reader, as the content of a file called `name`.
  FileReader(std::string name, std::string_view bytes);
  FileReader(const FileReader&) = delete;
  FileReader& operator=(const FileReader&) = delete;

  std::string name() const { return path_.string(); }
  std::uint64_t remaining() const { return size_ - position_; }  // bytes

  /// Names the record that is read next, for the error if the file ends in it: "point 17 of 20" (`index` is 16).
  void begin_record(const char* kind, std::uint64_t index, std::uint64_t total);

  /// @throws InputError if the rest of the file is too short for `count` records
  void expect_records(const char* kind, std::uint64_t count, std::uint64_t min_bytes_each) const;
  /// @throws InputError if bytes follow the last record
  void expect_end() const;

  /// Returns the next bytes as a number in the machine's byte order. @throws InputError if the file is too short
  template <class T>
  T read() {
    static_assert(std::is_arithmetic_v<T>);
    T value;
    if (end_ - next_ >= sizeof(T)) {
      std::memcpy(&value, data_ + next_, sizeof(T));
      next_ += sizeof(T);
      position_ += sizeof(T);
    } else {
      read_bytes(&value, sizeof(T));
    }
    return value;
  }
  void read_bytes(void* to, std::size_t bytes);
  void skip(std::uint64_t bytes);
  /// Returns the characters up to a zero byte, which is skipped.
  std::string read_c_string();

  /// Reads the next line without "\n" or "\r\n", and the first without a byte order mark. Returns false at the end of
  /// the file. The view is valid until the next call.
  bool read_line(std::string_view& line);
  /// Returns "FILE:LINE" of the last line that was read.
  std::string place() const;

 private:
  bool fill();  // false at the end of the file
  [[noreturn]] void fail_to_read(const char* reason) const;
  [[noreturn]] void fail_truncated(std::uint64_t wanted) const;

  std::filesystem::path path_;
  Descriptor file_;                        // empty if the bytes are in memory
  std::uint64_t size_ = 0, position_ = 0;  // bytes
  std::vector<char> buffer_;               // part of the file
  const char* data_ = nullptr;             // buffer_, or the bytes in memory
  std::size_t next_ = 0, end_ = 0;         // positions in data_
  const char* record_kind_ = "";
  std::uint64_t record_ = 0, record_count_ = 0, line_number_ = 0;
  std::string long_line_;  // a line that does not fit into the buffer
};

}  // namespace b3dgs
