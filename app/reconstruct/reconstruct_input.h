// The input of a reconstruction, checked before anything is written.
#pragma once

#include <filesystem>
#include <vector>

#include "app/reconstruct/photographs.h"
#include "app/reconstruct/reconstruct.h"
#include "app/reconstruct/scene_folder.h"

namespace b3dgs {

struct ReconstructInput {
  std::filesystem::path source;  // a folder of photographs, or a video; without links
  bool is_video = false;
  bool is_in_place = false;             // the photographs are already in SCENE/images
  std::vector<Photograph> photographs;  // empty for a video
};

/// `warn` gets a line about photographs that are left out. @throws InputError, with the remedy, if the input or the
/// scene folder cannot be used, or if a required program is not installed
ReconstructInput check_input(const ReconstructOptions& options, const ScenePlaces& places, const WarnFn& warn);

bool is_there(const std::filesystem::path& path);

bool is_same_place(const std::filesystem::path& a, const std::filesystem::path& b);

}  // namespace b3dgs
