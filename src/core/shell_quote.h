// Words of commands that are printed to be copied into a shell.
#pragma once

#include <string>

namespace b3dgs {

/// The word as a POSIX shell reads it back: unchanged if it has only characters without a meaning there, else in single
/// quotes. A name that begins with "-" is to be written "./-name" before.
inline std::string shell_quote(const std::string& word) {
  constexpr const char* kPlain = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-+./:,=@%";
  if (!word.empty() && word.find_first_not_of(kPlain) == std::string::npos) return word;
  std::string quoted = "'";
  for (const char c : word) quoted += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return quoted + "'";
}

}  // namespace b3dgs
