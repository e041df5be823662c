// The web page, which CMake makes of page/.
#pragma once

namespace b3dgs {

/// HTML with style and script inside. "@NONCE@" stands where each answer has a random value of its own.
extern const char* const kViewPage;

}  // namespace b3dgs
