// Environment variables during a test.
#pragma once

#include <cstdlib>
#include <initializer_list>
#include <string>
#include <utility>
#include <vector>

namespace b3dgs::test {

/// Sets variables, and removes them at the end.
class Variables {
 public:
  Variables(std::initializer_list<std::pair<const char*, std::string>> values)
      : Variables(std::vector<std::pair<const char*, std::string>>(values)) {}
  explicit Variables(const std::vector<std::pair<const char*, std::string>>& values) {
    for (const auto& [name, value] : values) {
      setenv(name, value.c_str(), 1);
      names_.push_back(name);
    }
  }
  ~Variables() {
    for (const char* name : names_) unsetenv(name);
  }
  Variables(const Variables&) = delete;
  Variables& operator=(const Variables&) = delete;

 private:
  std::vector<const char*> names_;
};

}  // namespace b3dgs::test
