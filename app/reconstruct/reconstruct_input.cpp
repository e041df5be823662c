#include "app/reconstruct/reconstruct_input.h"

#include <system_error>
#include <utility>

#include "app/reconstruct/colmap_program.h"
#include "app/reconstruct/stage_record.h"
#include "app/reconstruct/video_frames.h"
#include "core/check.h"
#include "core/files/own_files.h"
#include "core/text.h"
#include "scene/images/image_folder.h"

namespace b3dgs {
namespace {

namespace fs = std::filesystem;

/// Returns whether `path` is below `folder`. Both must be without links.
bool is_inside(const fs::path& path, const fs::path& folder) {
  const fs::path relative = path.lexically_relative(folder);
  return !relative.empty() && *relative.begin() != ".." && relative != ".";
}

void list_input(ReconstructInput& input, const ReconstructOptions& options, const ScenePlaces& places,
                const WarnFn& warn) {
  fs::path& source = input.source;
  if (is_same_place(source, places.root)) {
    // Photographs beside SCENE/images would be found twice the next time.
    if (!is_there(places.images)) {
      input_error(options.output, ": is the folder of the photographs, too (expected another folder); ",
                  "choose another scene folder, or move the photographs to ", places.images.string());
    }
    source = places.images;
  }
  input.is_in_place = is_same_place(source, places.images);
  std::vector<fs::path> except{places.work};
  if (is_inside(places.root, source)) except = {places.root};
  if (is_inside(places.images, source)) except.push_back(places.images);
  PhotographList list = list_photographs(source, except);
  input.photographs = std::move(list.photographs);
  if (list.unreadable.empty()) return;
  warn(detail::one_line(detail::concat(list.unreadable.size(), " raw or HEIC files are left out (the first: ",
                                       list.unreadable[0], "); convert them to JPEG to use them")));
}

}  // namespace

bool is_there(const fs::path& path) {
  std::error_code error;
  return fs::exists(path, error);
}

bool is_same_place(const fs::path& a, const fs::path& b) {
  std::error_code error;
  return a == b || fs::equivalent(a, b, error);
}

ReconstructInput check_input(const ReconstructOptions& options, const ScenePlaces& places, const WarnFn& warn) {
  ReconstructInput input;
  input.source = real_path(options.input);
  if (!is_there(input.source)) {
    input_error("photographs not found: ", options.input, " (expected a folder or a video)");
  }
  input.is_video = !fs::is_directory(input.source);
  if (input.is_video && !fs::is_regular_file(input.source)) {
    input_error(options.input, ": neither a folder nor a file (expected photographs or a video)");
  }
  if (input.is_video && has_image_extension(input.source)) {
    input_error(options.input, ": only one photograph (expected a folder of photographs, or a video)");
  }
  if (!input.is_video && options.frames > 0) {
    input_error("--frames has no effect on photographs (", options.input, " is a folder); it is an option of videos");
  }
  if (is_there(places.root) && !fs::is_directory(places.root)) {
    input_error("not a folder: ", options.output, " (expected the scene folder to make)");
  }
  if (options.frames == 1) input_error("--frames 1: expected at least 2 frames, each from another place");
  check_work_folder(places);
  if (!input.is_video) list_input(input, options, places, warn);
  check_colmap_is_installed();
  if (input.is_video) check_ffmpeg_is_installed();
  if (is_stage_record(places.record)) return input;
  // Existing files before the first call belong to the user.
  for (const fs::path& folder : {places.sparse / "0", places.sparse, places.root}) {
    if (!colmap_format(folder)) continue;
    input_error(folder.string(), ": there is a COLMAP model already, which `b3dgs train ", shell_quote(options.output),
                "` takes; choose another scene folder to reconstruct it again");
  }
  if (!input.is_in_place && holds_files(places.images)) {
    input_error(places.images.string(), ": there are files already; to use them, give this folder as PHOTOS, ",
                "otherwise choose another scene folder");
  }
  return input;
}

}  // namespace b3dgs
