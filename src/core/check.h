// Error types, and the functions that throw them. Depends on no other header of the project.
//
// InputError        the user's input cannot be used: a damaged file, an unknown option, a missing GPU.
// IoError           the operating system refused a read or write: a read-only folder, a full disk.
// NumericError      training diverged.
// OutOfMemoryError  the GPU has less free memory than requested.
// LogicError        a bug: a contract between modules was broken.
//
// app/main.cpp maps the first two to exit code 2 and the others to 1. Other code that catches them adds context to the
// message, or continues without the part that failed.
#pragma once

#include <cstddef>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>

namespace b3dgs {

class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
  /// Throws the same error with more text at its end.
  [[noreturn]] virtual void rethrow_with(const std::string& more) const { throw Error(what() + more); }
};

/// A kind of error.
template <class Kind, class Base = Error>
class ErrorOf : public Base {
 public:
  using Base::Base;
  [[noreturn]] void rethrow_with(const std::string& more) const override { throw ErrorOf(this->what() + more); }
};

/// An error with one line: "WHAT: WHERE (expected X, found Y); what to do", for example "scene folder not found:
/// data/garden (expected images/ and sparse/0/)".
using InputError = ErrorOf<struct InputKind>;
using IoError = ErrorOf<struct IoKind>;
using NumericError = ErrorOf<struct NumericKind>;
using OutOfMemoryError = ErrorOf<struct OutOfMemoryKind>;
using LogicError = ErrorOf<struct LogicKind>;

namespace detail {

template <class... Parts>
std::string concat(const Parts&... parts) {
  std::ostringstream text;
  (text << ... << parts);
  return text.str();
}

/// The first character of a UTF-8 text, and its number of bytes. Bytes that are not UTF-8 are separate characters.
struct Character {
  char32_t code = 0;
  std::size_t bytes = 1;
  bool is_utf8 = false;
};

inline Character first_character(std::string_view text) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  Character c{byte(0), 1, byte(0) < 0x80};
  const std::size_t bytes = c.code >= 0xF0 ? 4 : c.code >= 0xE0 ? 3 : c.code >= 0xC0 ? 2 : 1;
  if (bytes == 1 || c.code >= 0xF8 || bytes > text.size()) return c;
  char32_t code = c.code & (0x7Fu >> bytes);
  for (std::size_t i = 1; i < bytes; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return c;
    code = code << 6 | (byte(i) & 0x3Fu);
  }
  constexpr char32_t kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
  const bool is_valid = code >= kLeast[bytes] && code <= 0x10FFFF && (code < 0xD800 || code > 0xDFFF);
  return is_valid ? Character{code, bytes, true} : c;
}

/// Returns whether a character can control a terminal (C0, C1), break a line, or change the order of other characters.
inline bool is_control(const Character& c) {
  const auto is_in = [&](char32_t first, char32_t last) { return c.is_utf8 && c.code >= first && c.code <= last; };
  return is_in(0, 0x1F) || is_in(0x7F, 0x9F) || is_in(0x2028, 0x202E) || is_in(0x2066, 0x2069);
}

/// Checks a name that a file gives. Bytes that are not UTF-8, as in Latin-1 or Shift-JIS, are not control characters,
/// because one_line() never prints them.
inline bool has_control_characters(std::string_view text) {
  for (std::size_t at = 0; at < text.size();) {
    const Character c = first_character(text.substr(at));
    if (is_control(c)) return true;
    at += c.bytes;
  }
  return false;
}

/// Replaces control characters and bytes that are not UTF-8, because names from files may contain line breaks and
/// terminal escape sequences.
inline std::string one_line(std::string_view text) {
  std::string line;
  for (std::size_t at = 0; at < text.size();) {
    const Character c = first_character(text.substr(at));
    line += c.is_utf8 && !is_control(c) ? text.substr(at, c.bytes) : "?";
    at += c.bytes;
  }
  return line;
}

[[noreturn]] inline void fail_check(const char* file, int line, const char* condition, const std::string& message) {
  throw LogicError(concat(file, ":", line, ": check failed: ", condition, message.empty() ? "" : "; ", message));
}

}  // namespace detail

/// Throws an InputError with the concatenated arguments: input_error("file not found: ", path).
template <class... Parts>
[[noreturn]] void input_error(const Parts&... parts) {
  throw InputError(detail::one_line(detail::concat(parts...)));
}

template <class... Parts>
[[noreturn]] void io_error(const Parts&... parts) {
  throw IoError(detail::one_line(detail::concat(parts...)));
}

}  // namespace b3dgs

/// Checks a contract between modules, in every build type: B3DGS_CHECK(n >= 0, "n is ", n). Not for inner loops.
#define B3DGS_CHECK(condition, ...)                                                                      \
  do {                                                                                                   \
    if (!(condition)) {                                                                                  \
      ::b3dgs::detail::fail_check(__FILE__, __LINE__, #condition, ::b3dgs::detail::concat(__VA_ARGS__)); \
    }                                                                                                    \
  } while (false)
