#include "model/training_id.h"

#include <random>
#include <system_error>

#include "core/check.h"

namespace b3dgs {

namespace fs = std::filesystem;

std::string new_training_id() {
  std::random_device random;
  std::string id;
  for (int i = 0; i < 16; ++i) id += "0123456789abcdef"[random() % 16];
  return id;
}

bool may_continue_in(const ModelFolder& folder, const fs::path& checkpoint, const std::string& training_id) {
  if (!folder.holds_model()) return true;
  const std::string own = folder.training_id();
  if (!training_id.empty() && !own.empty()) return training_id == own;
  std::error_code error;
  return fs::equivalent(checkpoint.parent_path(), folder.checkpoint(0).parent_path(), error);
}

void check_training_id(const ModelFolder& folder, const fs::path& checkpoint, const std::string& training_id) {
  if (may_continue_in(folder, checkpoint, training_id)) return;
  input_error(folder.root().string(), ": holds the model of another training than ", checkpoint.string(),
              "; choose another folder with -m, or replace the model with --overwrite");
}

void check_holds_no_model(const ModelFolder& folder) {
  if (!folder.holds_model()) return;
  input_error(folder.root().string(), ": holds the model of another training; resume that one, or train into another ",
              "folder");
}

std::string training_id_for(const ModelFolder& folder) {
  const std::string own = folder.training_id();
  return own.empty() || !folder.holds_model() ? new_training_id() : own;
}

}  // namespace b3dgs
