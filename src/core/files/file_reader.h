// A file, or bytes in memory, read front to back. The reader knows how much is left, so that nothing is believed before
// it is there.
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace b3dgs {

class FileReader {
 public:
  /// @throws InputError if the file is missing, unreadable or no regular file.
  explicit FileReader(std::filesystem::path path);
  /// Reads `bytes`, which have to outlive the reader, as if they were a file called `name`.
  FileReader(std::string name, std::string_view bytes);
  ~FileReader();
  FileReader(const FileReader&) = delete;
  FileReader& operator=(const FileReader&) = delete;

  std::string name() const { return path_.string(); }
  std::uint64_t remaining() const { return size_ - position_; }  // bytes

  /// Says what is read from here on, for the message if the file ends too early: "point 17 of 20" (index counts from
  /// 0).
  void begin_record(const char* kind, std::uint64_t index, std::uint64_t total);

  /// Refuses a count of records that the rest of the file cannot hold, before anything is allocated for them.
  void expect_records(const char* kind, std::uint64_t count, std::uint64_t min_bytes_each) const;
  /// Refuses bytes after the last record.
  void expect_end() const;

  /// The next bytes as a number in the machine's byte order. @throws InputError if the file ends before.
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
  /// Characters up to a zero byte, which is taken too.
  std::string read_c_string();

  /// The next line without its end ("\n" or "\r\n"); false at the end of the file. The view lasts until the next call.
  bool read_line(std::string_view& line);
  /// "FILE:LINE" of the line last read.
  std::string place() const;

 private:
  bool fill();  // false at the end of the file
  [[noreturn]] void fail_truncated(std::uint64_t wanted) const;

  std::filesystem::path path_;
  int file_ = -1;                          // -1: the bytes are in memory
  std::uint64_t size_ = 0, position_ = 0;  // bytes
  std::vector<char> buffer_;               // of the file
  const char* data_ = nullptr;             // of buffer_, or the bytes in memory
  std::size_t next_ = 0, end_ = 0;         // in data_
  const char* record_kind_ = "";
  std::uint64_t record_ = 0, record_count_ = 0, line_number_ = 0;
  std::string long_line_;  // a line that does not lie in the buffer as a whole
};

}  // namespace b3dgs
