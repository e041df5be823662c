#pragma once

namespace b3dgs {

/// Returns "0.1.0 (commit 1a2b3c4d5)", without the commit if the sources are not in a git repository. The commit ends
/// in "+changes" if there were uncommitted changes.
const char* version();

}  // namespace b3dgs
