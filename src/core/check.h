// Kinds of fault and the checks that raise them. Depends on nothing else.
//
// InputError        what the user gave cannot be used: a damaged file, an unknown option, a missing GPU.
// IoError           the system refused to read or write: an unwritable folder, a full disk.
// NumericError      the numbers left the range in which training makes sense.
// OutOfMemoryError  a GPU has not as much memory as was asked for.
// LogicError        a contract between our own modules was broken.
//
// app/main.cpp turns the first two into exit code 2 and the others into 1. Whoever else catches adds a place to the
// message, or can go on without what failed.
#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

namespace b3dgs {

class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One line: "PLACE: what is wrong (expected ..., found ...); remedy".
class InputError : public Error {
 public:
  using Error::Error;
};

class IoError : public Error {
 public:
  using Error::Error;
};

class NumericError : public Error {
 public:
  using Error::Error;
};

class OutOfMemoryError : public Error {
 public:
  using Error::Error;
};

class LogicError : public Error {
 public:
  using Error::Error;
};

namespace detail {

template <class... Parts>
std::string concat(const Parts&... parts) {
  std::ostringstream text;
  (text << ... << parts);
  return text.str();
}

/// Names from files may hold anything; an error stays one line, and nothing in it steers a terminal.
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

/// Throws an InputError whose message is the arguments joined, e.g. input_error(path, ": camera ", id, " ...").
template <class... Parts>
[[noreturn]] void input_error(const Parts&... parts) {
  throw InputError(detail::one_line(detail::concat(parts...)));
}

template <class... Parts>
[[noreturn]] void io_error(const Parts&... parts) {
  throw IoError(detail::one_line(detail::concat(parts...)));
}

}  // namespace b3dgs

/// A contract between modules, checked in every build: B3DGS_CHECK(n >= 0, "n is ", n). Not for inner loops.
#define B3DGS_CHECK(condition, ...)                                                                      \
  do {                                                                                                   \
    if (!(condition)) {                                                                                  \
      ::b3dgs::detail::fail_check(__FILE__, __LINE__, #condition, ::b3dgs::detail::concat(__VA_ARGS__)); \
    }                                                                                                    \
  } while (false)
