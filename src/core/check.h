// Error types, and the functions that throw them. Depends on nothing else.
//
// InputError        the user's input cannot be used: a damaged file, an unknown option, a missing GPU.
// IoError           the operating system refused a read or write: a read-only folder, a full disk.
// NumericError      training diverged.
// OutOfMemoryError  the GPU has less free memory than requested.
// LogicError        a bug: a contract between modules was broken.
//
// app/main.cpp maps the first two to exit code 2 and the others to 1. Code that catches them elsewhere adds context to
// the message, or continues without the part that failed.
#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

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

/// One line: "WHAT: WHERE (expected X, found Y); what to do", for example
/// "scene folder not found: data/garden (expected images/ and sparse/0/)".
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

/// Replaces control characters: names from files may contain line breaks and terminal escape sequences.
inline std::string one_line(std::string text) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  }
  return text;
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
