// Checks the type and the message of an exception, and the content of texts.
#pragma once

#include <gtest/gtest.h>

#include <initializer_list>
#include <string>

namespace b3dgs::test {

inline bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

/// Succeeds if call() throws a Kind whose message is one line that contains all `parts`.
template <class Kind, class Call>
testing::AssertionResult fails_with(std::initializer_list<std::string> parts, Call&& call) {
  try {
    call();
  } catch (const Kind& error) {
    const std::string message = error.what();
    if (message.find('\n') != std::string::npos)
      return testing::AssertionFailure() << "the message has several lines: " << message;
    for (const std::string& part : parts) {
      if (!contains(message, part)) {
        return testing::AssertionFailure() << "\"" << part << "\" is not in: " << message;
      }
    }
    return testing::AssertionSuccess();
  } catch (const std::exception& error) {
    return testing::AssertionFailure() << "an exception of another type: " << error.what();
  }
  return testing::AssertionFailure() << "no exception";
}

}  // namespace b3dgs::test
