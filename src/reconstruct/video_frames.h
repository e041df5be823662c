// Frames of a video for a reconstruction: the sharpest of each of equally long windows. Runs ffprobe and ffmpeg.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "reconstruct/program_log.h"

namespace b3dgs {

struct VideoInfo {
  int width = 0, height = 0;  // px
  double seconds = 0;         // 0: the file does not say
  std::size_t n_frames = 0;   // as the file says, or estimated; 0: unknown
};

/// @throws InputError if ffmpeg or ffprobe is not in PATH, with the remedy
void check_ffmpeg_is_installed();

/// @throws InputError if the file is no video that ffmpeg can read, or the programs are missing
VideoInfo read_video_info(const std::filesystem::path& video, ProgramLog& log);

/// Variance of the Laplacian of a grey image, [height, width] bytes: larger where edges are sharper. For comparing
/// frames of one video that show about the same.
double sharpness(const std::uint8_t* grey, int width, int height);

/// How many frames to use where the user has not said it: 2 per second, but 100 to 300, and not more than there are.
std::size_t automatic_frame_count(double seconds, std::size_t n_frames);

/// Splits the frames into `count` windows of equal length, up to rounding, and returns the number of the frame with the
/// highest value in each, ascending.
std::vector<std::size_t> sharpest_of_windows(const std::vector<double>& sharpness, std::size_t count);

/// Decodes the video to measure all frames, and again for each 5000 that it writes into `folder`, which must not exist,
/// as frame_00001.jpg, frame_00002.jpg, ... `wanted` 0: automatic_frame_count(). @return their names
/// @throws InputError also if there are fewer than two; IoError, Stopped
std::vector<std::string> extract_frames(
    const std::filesystem::path& video, std::size_t wanted, const std::filesystem::path& folder, ProgramLog& log,
    const std::function<void(const char* stage, std::size_t done, std::size_t total)>& progress);

}  // namespace b3dgs
