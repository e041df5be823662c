// Frames of a video for a reconstruction: the sharpest frame in each of several windows of equal length. Runs ffprobe
// and ffmpeg.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "app/reconstruct/program_log.h"

namespace b3dgs {

struct VideoInfo {
  int width = 0, height = 0;  // px
  double seconds = 0;         // 0: not in the file
  std::size_t n_frames = 0;   // as given in the file, or estimated; 0: unknown
};

/// @throws InputError with the remedy if ffmpeg or ffprobe is not in PATH
void check_ffmpeg_is_installed();

/// @throws InputError if the file is not a video that ffmpeg can read, or the programs are missing
VideoInfo read_video_info(const std::filesystem::path& video, ProgramLog& log);

/// Returns the variance of the Laplacian of a grey image, [height, width] bytes, which is larger for sharper edges. It
/// is for comparing frames of one video with about the same content.
double sharpness(const std::uint8_t* grey, int width, int height);

/// Returns the number of frames unless the user gives it: 2 per second, but 100 to 300, and not more than there are.
std::size_t automatic_frame_count(double seconds, std::size_t n_frames);

/// Splits the frames into `count` windows of equal length, up to rounding, and returns the index of the frame with the
/// highest value in each, ascending.
std::vector<std::size_t> sharpest_of_windows(const std::vector<double>& sharpness, std::size_t count);

/// Decodes the video to measure all frames, and again for each 5000 that it writes into `folder`, which must not exist,
/// as frame_00001.jpg, frame_00002.jpg, ... `wanted` 0: automatic_frame_count(). @return their names @throws InputError
/// also if there are fewer than two; IoError, Stopped
std::vector<std::string> extract_frames(
    const std::filesystem::path& video, std::size_t wanted, const std::filesystem::path& folder, ProgramLog& log,
    const std::function<void(const char* stage, std::size_t done, std::size_t total)>& progress);

}  // namespace b3dgs
