#include "app/common/output_file.h"

#include <system_error>

#include "core/check.h"

namespace b3dgs {

namespace fs = std::filesystem;

void check_output_file(const std::string& output, bool overwrite) {
  std::error_code error;  // writing reports it
  if (fs::is_directory(output, error)) input_error(output, " is a folder; expected the name of a file");
  if (fs::exists(fs::symlink_status(output, error)) && !overwrite) {
    input_error(output, " exists; name another file, or replace it with --overwrite");
  }
}

void refuse_to_replace(const fs::path& input, const std::string& output) {
  std::error_code error;
  if (!fs::is_directory(output, error) && fs::equivalent(output, input, error))
    input_error(output, " is a file to read; write to another one");
}

}  // namespace b3dgs
