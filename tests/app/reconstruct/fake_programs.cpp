#include "app/reconstruct/fake_programs.h"

#include <sys/stat.h>

#include <cstdlib>
#include <sstream>

#include "core/files/folders.h"
#include "scene/colmap/colmap.h"
#include "scene/images/image.h"
#include "support/files.h"

namespace b3dgs::test {
namespace {

namespace fs = std::filesystem;

// Lines as COLMAP 3.8 prints them.
constexpr const char* kColmap = R"sh(#!/bin/sh
here=$(dirname "$0")
if [ "$1" = -h ]; then
  echo "COLMAP $(cat "$here/version") -- Structure-from-Motion and Multi-View Stereo"
  echo "              (Commit Unknown on Unknown without CUDA)"
  echo
  echo "Usage:"
  cat "$here/commands"
  exit 0
fi
if [ "$2" = -h ]; then
  cat "$here/options"
  exit 0
fi
echo "$@" >> "$here/calls"
. "$here/prelude"
command=$1
while [ $# -gt 1 ]; do
  case $1 in
    --database_path) database=$2 ;;
    --image_list_path) list=$2 ;;
    --output_path) output=$2 ;;
  esac
  shift
done
case $command in
  feature_extractor)
    n=$(wc -l < "$list")
    i=0
    while read -r name; do
      i=$((i + 1))
      echo "Processed file [$i/$n]"
      echo "  Name:            $name"
      echo "  Camera:          #7 - OPENCV"
      echo "$name" >> "$database"
      [ ! -e "$here/slow" ] || sleep 0.2
    done < "$list" ;;
  sequential_matcher)
    echo "Matching image [1/10] in 0.1s"
    echo "Matching image [10/10] in 0.1s" ;;
  *_matcher)
    printf "Matching block [1/2, 1/2]"
    echo " in 0.1s"
    echo "Matching block [2/2, 2/2] in 0.1s" ;;
  mapper | global_mapper)
    echo "Registering image #3 (2)"
    if [ -z "$(ls "$here/models")" ]; then
      echo "  => No good initial image pair found."
      echo "ERROR: failed to create sparse model"
      exit 1
    fi
    cp -r "$here/models/." "$output" ;;
esac
)sh";

constexpr const char* kFfprobe = R"sh(#!/bin/sh
here=$(dirname "$0")
if [ ! -e "$here/video" ]; then
  echo "film.mp4: Invalid data found when processing input"
  exit 1
fi
echo "[mov,mp4] a warning about the file"
n=$(cat "$here/n_frames")
side=$(cat "$here/side")
cat << END
{ "streams": [ { "width": $side, "height": $side, "avg_frame_rate": "30/1", "nb_frames": "$n", "duration": "2.0" } ], "format": { "duration": "2.0" } }
END
)sh";

constexpr const char* kFfmpeg = R"sh(#!/bin/sh
here=$(dirname "$0")
echo "ffmpeg $@" >> "$here/calls"
for last; do :; done
if [ "$last" = - ]; then
  cat "$here/video"
  exit 0
fi
folder=$(dirname "${last#file:}" | sed "s/%%/%/g")
n=$(echo "$@" | grep -o "eq(n" | wc -l)
first=1
while [ $# -gt 1 ]; do
  [ "$1" != -start_number ] || first=$2
  shift
done
here=$(realpath "$here")
cd "$folder"
seq -f frame_%05.0f.jpg "$first" $((first + n - 1)) |
  xargs -d '\n' -n 500 sh -c 'frame=$1; shift; tee "$@" < "$frame" > /dev/null' sh "$here/frame"
)sh";

constexpr const char* kOptions[] = {
    "  --ImageReader.single_camera arg (=0)\n  --ImageReader.single_camera_per_folder arg (=0)\n"
    "  --ImageReader.single_camera_per_image arg (=0)\n  --ImageReader.existing_camera_id arg (=-1)\n"
    "  --ImageReader.camera_params arg\n  --SiftExtraction.max_num_features arg (=8192)\n"
    "  --ExhaustiveMatching.block_size arg (=50)\n  --SequentialMatching.overlap arg (=10)\n"
    "  --Mapper.num_threads arg (=-1)\n  --Mapper.ba_refine_focal_length arg (=1)\n"
    "  --Mapper.ba_refine_extra_params arg (=1)\n",
    "  --SiftExtraction.use_gpu arg (=1)\n  --SiftExtraction.num_threads arg (=-1)\n"
    "  --SiftMatching.use_gpu arg (=1)\n  --SiftMatching.num_threads arg (=-1)\n",
    "  --FeatureExtraction.use_gpu arg (=1)\n  --FeatureExtraction.num_threads arg (=-1)\n"
    "  --FeatureMatching.use_gpu arg (=1)\n  --FeatureMatching.num_threads arg (=-1)\n"};

void write_program(const fs::path& path, const std::string& text) {
  write_bytes(path, text);
  chmod(path.c_str(), 0755);
}

}  // namespace

FakePrograms::FakePrograms() : path_before_(std::getenv("PATH")) {
  write_program(folder_ / "colmap", kColmap);
  write_program(folder_ / "ffprobe", kFfprobe);
  write_program(folder_ / "ffmpeg", kFfmpeg);
  set_colmap_version("3.8");
  set_colmap_prelude("");
  write_bytes(folder_ / "commands", "  colmap mapper --image_path IMAGES\n\nAvailable commands:\n  mapper\n");
  set_models({});
  write_photographs(folder_ / "source", 1);
  write_image(folder_ / "frame.jpg", read_image(folder_ / "source/a.png", false));
  fs::rename(folder_ / "frame.jpg", folder_ / "frame");
  setenv("PATH", (folder_.path().string() + ":" + path_before_).c_str(), 1);
}

FakePrograms::~FakePrograms() {
  setenv("PATH", path_before_.c_str(), 1);
}

void FakePrograms::set_models(const std::vector<int>& sizes) const {
  remove_tree(folder_ / "models");
  fs::create_directories(folder_ / "models");
  for (std::size_t i = 0; i < sizes.size(); ++i) {
    ColmapModel model;
    model.cameras[1] = {1, CameraModel::kOpenCv, 8, 6, {10, 10, 4, 3, 0, 0, 0, 0}};
    for (int image = 0; image < sizes[i]; ++image) {
      ColmapImage row;
      row.id = static_cast<std::uint32_t>(image + 1);
      row.camera_id = 1;
      row.name = std::string(1, static_cast<char>('a' + image)) + ".png";
      model.images.push_back(row);
    }
    ColmapPoint point;
    point.id = 1;
    point.error = 0.5;
    model.points.push_back(point);
    write_colmap_model(folder_ / ("models/" + std::to_string(i)), model, ColmapFormat::kBinary);
  }
}

void FakePrograms::set_model(const ColmapModel& model) const {
  remove_tree(folder_ / "models");
  write_colmap_model(folder_ / "models/0", model, ColmapFormat::kText);
  std::ostringstream points;  // with tracks, which the program's own writer leaves empty
  for (const ColmapPoint& point : model.points) {
    points << point.id << " " << point.position[0] << " " << point.position[1] << " " << point.position[2] << " 0 0 0 "
           << point.error;
    for (const std::uint32_t image : point.image_ids) points << " " << image << " 0";
    points << "\n";
  }
  write_bytes(folder_ / "models/0/points3D.txt", points.str());
}

void FakePrograms::set_colmap_prelude(const std::string& commands) const {
  write_bytes(folder_ / "prelude", commands + "\n");
}

void FakePrograms::set_colmap_version(const std::string& version) const {
  write_bytes(folder_ / "version", version);
  write_bytes(folder_ / "options", std::string("  -h [ --help ]\n") + kOptions[0] + kOptions[version == "3.8" ? 1 : 2]);
}

void FakePrograms::add_colmap_help(const std::string& line) const {
  write_bytes(folder_ / "options", read_bytes(folder_ / "options") + line + "\n");
}

void FakePrograms::add_colmap_command(const std::string& command) const {
  write_bytes(folder_ / "commands", read_bytes(folder_ / "commands") + "  " + command + "\n");
}

void FakePrograms::slow_down() const {
  write_bytes(folder_ / "slow", "");
}

void FakePrograms::set_video(const std::string& bytes, int n_frames, int side) const {
  write_bytes(folder_ / "video", bytes);
  write_bytes(folder_ / "side", std::to_string(side));
  write_bytes(folder_ / "n_frames", std::to_string(n_frames));
}

void FakePrograms::hide(const std::string& program) const {
  fs::remove(folder_ / program);
  setenv("PATH", folder_.path().c_str(), 1);
}

std::vector<std::string> FakePrograms::calls() const {
  std::vector<std::string> lines;
  std::istringstream text(read_bytes(folder_ / "calls"));
  for (std::string line; std::getline(text, line);) lines.push_back(line);
  return lines;
}

void FakePrograms::forget_calls() const {
  fs::remove(folder_ / "calls");
}

void write_photographs(const fs::path& folder, int n, int width, int height) {
  fs::create_directories(folder);
  for (int i = 0; i < n; ++i) {
    Image8 image;
    image.width = width;
    image.height = height;
    image.channels = 3;
    image.pixels.assign(static_cast<std::size_t>(3 * width * height), static_cast<std::uint8_t>(10 * i));
    write_image(folder / (std::string(1, static_cast<char>('a' + i)) + ".png"), image);
  }
}

}  // namespace b3dgs::test
