#pragma once

namespace b3dgs {

/// "0.1.0 (commit 1a2b3c4d5)"; without the commit where the sources came without git's records. A commit that ends in
/// "+changes" was built with changes that are not committed.
const char* version();

}  // namespace b3dgs
