// Tables of kernels are indexed by an enumerator that each row names too.
#pragma once

#include <cstddef>

namespace b3dgs {

/// Whether row i of `rows` is that of enumerator i. Kernels compute the same, so no test would notice two that had
/// changed places.
template <class Rows>
constexpr bool is_in_order(const Rows& rows) {
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (static_cast<std::size_t>(rows[i].kernel) != i) return false;
  }
  return true;
}

}  // namespace b3dgs
