#include "core/files/unicode_names.h"

#include <utf8proc.h>

#include <cstdlib>
#include <memory>
#include <system_error>

namespace b3dgs {
namespace {

std::string in_form(const std::string& name, utf8proc_option_t form) {
  utf8proc_uint8_t* mapped = nullptr;
  const utf8proc_ssize_t length =
      utf8proc_map(reinterpret_cast<const utf8proc_uint8_t*>(name.data()), static_cast<utf8proc_ssize_t>(name.size()),
                   &mapped, static_cast<utf8proc_option_t>(UTF8PROC_STABLE | form));
  const std::unique_ptr<utf8proc_uint8_t, decltype(&std::free)> owner(mapped, &std::free);
  if (length < 0) return name;
  return {reinterpret_cast<const char*>(mapped), static_cast<std::size_t>(length)};
}

}  // namespace

std::string composed_name(const std::string& name) {
  return in_form(name, UTF8PROC_COMPOSE);
}

std::filesystem::path find_in_any_form(const std::filesystem::path& folder, const std::string& name) {
  for (const std::string& form : {name, composed_name(name), in_form(name, UTF8PROC_DECOMPOSE)}) {
    std::error_code error;
    if (std::filesystem::is_regular_file(folder / form, error)) return folder / form;
  }
  return {};
}

}  // namespace b3dgs
