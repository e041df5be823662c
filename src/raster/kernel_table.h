// Look-up in the tables of kernels (forward_kernel.h, backward_kernel.h).
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>

#include "core/check.h"

namespace b3dgs {

/// The kernel with this name, if there is one. `rows` is an array of structs with members `kernel` and `name`.
template <class Rows>
constexpr auto find_kernel(const Rows& rows, std::string_view name) -> std::optional<decltype(rows[0].kernel)> {
  for (const auto& row : rows) {
    if (row.name == name) return row.kernel;
  }
  return std::nullopt;
}

/// The kernel with this name. @throws LogicError if there is none: names from users are checked before.
template <class Rows>
auto kernel_named(const Rows& rows, std::string_view name) {
  const auto kernel = find_kernel(rows, name);
  B3DGS_CHECK(kernel.has_value(), "unknown kernel: ", name);
  return *kernel;
}

}  // namespace b3dgs
