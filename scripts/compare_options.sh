#!/usr/bin/env bash
# Measures options of docs/recipes.md on a CPU, in short trainings on small photographs: on scenes as they are, and on
# copies with the fault that an option is meant for, which scripts/disturb_scene.py makes (gains and tints, covered
# parts, inexact poses). scripts/compare_presets.sh trains; this script says what, and prints a Markdown table for each
# block.
#
# It can be stopped and run again. Trainings use one thread; to use more cores, run it twice at a time with different
# blocks. Needs numpy and Pillow.
#
# Usage: scripts/compare_options.sh B3DGS OUTPUT DATA [BLOCK...]     DATA: folder with fox, bonsai and kitti_street
# Blocks: appearance grid dim rates masks segment poses depths mcmc balanced; default: all. "tables" only
# prints.
# Environment:
#   SEEDS    default "0 1 2"
#   SCENES   trains only on these scenes of a block; default: all of them
#   LIMIT_S  for each scene of a block: starts no further training once so many seconds have passed; default: none
# Example: scripts/compare_options.sh build/cpu/app/b3dgs output/options data appearance
set -euo pipefail
shopt -s inherit_errexit
usage='scripts/compare_options.sh B3DGS OUTPUT DATA [BLOCK...]'
b3dgs=$(realpath -- "${1:?the program is missing: $usage}")
output=${2:?the output folder is missing: $usage}
data=$(realpath -- "${3:?the folder of the real scenes is missing: $usage}")
shift 3
all_blocks=(appearance grid dim rates masks segment poses depths mcmc balanced)
blocks=("${@:-${all_blocks[@]}}")
for block in "${blocks[@]}"; do
  if [[ " ${all_blocks[*]} tables " != *" $block "* ]]; then
    echo "compare_options.sh: error: there is no block $block; blocks: ${all_blocks[*]} tables" >&2
    exit 2
  fi
done
for scene in fox bonsai kitti_street; do
  if [[ ! -d $data/$scene ]]; then
    echo "compare_options.sh: error: $data: has no folder $scene" >&2
    exit 2
  fi
done
scripts=$(realpath -- "$(dirname "$0")")
scenes=$output/scenes
mkdir -p -- "$scenes"
is_left=0

# A fixed kernel, so that no choice by time makes two trainings differ; and as many iterations for every scene.
common='--device cpu --threads 1 --kernel shared-memory --max_epochs 0'
short="$common --preset original --strategy balanced --steps_scaler 0.05"
# The size of the photographs of a scene; disturbed copies are named SCENE_FAULT.
size_of() {
  case $1 in
    orbit* | few*) echo '-r 4' ;;
    *) echo '-r 8' ;;
  esac
}

# scene NAME: its folder, which is made if need be. Two runs of this script may ask for it at the same time.
scene() {
  local name=$1 folder=$scenes/$1
  (
    flock 9
    [[ ! -d $folder ]] || exit 0
    case $name in
      fox | bonsai | kitti_street) ln -s -- "$data/$name" "$folder" ;;
      orbit) "$b3dgs" synth orbit "$folder" --quiet ;;
      few_*) few_views "$folder" "${name#few_}" ;;
      orbit_object) object_masks "$folder" ;;
      *_gains) disturb "$name" --gains 0.3 ;;
      *_dim) disturb "$name" --dim 0.6 ;;
      *_dimgains) disturb "$name" --dim 0.6 --gains 0.3 ;;
      *_covered) disturb "$name" --cover ;;
      *_turned) disturb "$name" --turn 0.3 --move 0.003 ;;
    esac
  ) 9> "$scenes/.lock" >&2
  echo "$folder"
}

disturb() {
  local from
  from=$(unlocked_scene "${1%_*}")
  "$scripts/disturb_scene.py" "$from" "$scenes/$1" "${@:2}"
}

# The folder of an undisturbed scene, within the lock.
unlocked_scene() {
  if [[ $1 == orbit ]]; then
    [[ -d $scenes/orbit ]] || "$b3dgs" synth orbit "$scenes/orbit" --quiet >&2
    echo "$scenes/orbit"
  else
    echo "$data/$1"
  fi
}

# few_views SCENE SEED: an orbit of nine photographs, with their true inverse depth in SCENE/depths, and tracks that say
# which points each shows: those within 2 % of its depth.
few_views() {
  local renders=$scenes/.renders scene=$scenes/.few
  rm -rf -- "$renders" "$scene"
  "$b3dgs" synth orbit "$scene" --views 9 --seed "$2" --format text --quiet
  "$b3dgs" render "$scene/truth.ply" -s "$scene" --path train --depth_format png16 --output "$renders" --quiet \
    --device cpu
  python3 - "$scene/sparse/0" "$renders" << 'PYTHON'
import json, sys
import numpy as np
from PIL import Image
model, renders = sys.argv[1:]
lines = lambda name: [line.split() for line in open(f"{model}/{name}.txt") if line.strip() and line[0] != "#"]
scale = json.load(open(f"{renders}/depth.json"))["scale"]
(camera,) = lines("cameras")
fx, fy, cx, cy = map(float, camera[4:8])
points = lines("points3D")
xyz = np.array([point[1:4] for point in points], float)
tracks = [[] for _ in points]
for image in (line for line in lines("images") if line[-1].endswith(".png")):
    (w, x, y, z), t = map(float, image[1:5]), np.array(image[5:8], float)
    rotation = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
    at = xyz @ rotation.T + t
    inverse = np.array(Image.open(f"{renders}/depth/{image[-1]}"), float) / scale
    column = np.floor(fx * at[:, 0] / at[:, 2] + cx).astype(int)
    row = np.floor(fy * at[:, 1] / at[:, 2] + cy).astype(int)
    is_inside = (at[:, 2] > 0) & (column >= 0) & (column < inverse.shape[1]) & (row >= 0) & (row < inverse.shape[0])
    for i in np.flatnonzero(is_inside):
        if abs(inverse[row[i], column[i]] * at[i, 2] - 1) < 0.02:
            tracks[i] += [image[0], str(len(tracks[i]) // 2)]
with open(f"{model}/points3D.txt", "w") as file:
    for point, track in zip(points, tracks):
        file.write(" ".join(point[:8] + track) + "\n")
PYTHON
  mv -- "$renders/depth" "$scene/depths"
  mv -- "$scene" "$1"
  rm -rf -- "$renders"
}

# object_masks SCENE: orbit with masks that show the solids without the plane below them and the sky: what of the truth
# is above the plane, where it is opaque.
object_masks() {
  local renders=$scenes/.renders from
  from=$(unlocked_scene orbit)
  "$b3dgs" export "$from/truth.ply" "$scenes/.solids.ply" --overwrite --quiet \
    --crop=-9,-9,0.02,9,9,9 --compare_views 0 --device cpu
  "$b3dgs" render "$scenes/.solids.ply" -s "$from" --path train --output "$renders" --quiet --device cpu
  rm -rf -- "$1.partial"
  cp -r -- "$from" "$1.partial"
  mv -- "$renders/alpha" "$1.partial/masks"
  mv -- "$1.partial" "$1"
  rm -rf -- "$renders" "$scenes/.solids.ply"
}

# compare BLOCK OPTIONS CONFIGS SCENE...
compare() {
  local name folder status
  for name in "${@:4}"; do
    [[ " ${SCENES:-$name} " == *" $name "* ]] || continue
    status=0
    folder=$(scene "$name")
    OPTIONS="$2 $(size_of "$name")" CONFIGS=$3 SEEDS=${SEEDS:-0 1 2} \
      "$scripts/compare_presets.sh" "$b3dgs" "$output/$1" "$folder" > "$output/$1.log" || status=$?
    if ((status == 3)); then is_left=1; elif ((status)); then exit "$status"; fi
  done
}

# alpha_left: for each model of the block "segment", the mean alpha of test views over the pixels that masks leave out.
alpha_left() {
  local model renders=$output/segment.renders
  printf '\n| configuration | seed | alpha left |\n|---|---|---|\n'
  for model in "$output"/segment/orbit_object/*/seed_*; do
    [[ -d $model/point_cloud ]] || continue  # the training did not end
    "$b3dgs" render "$model" --path test --output "$renders" --quiet --device cpu > "$output/segment.log"
    python3 - "$model" "$renders" "$scenes/orbit_object/masks" << 'PYTHON'
import json, sys
import numpy as np
from PIL import Image
model, renders, masks = sys.argv[1:]
pixels = []
for image, view in json.load(open(f"{renders}/views.json")).items():
    alpha = Image.open(f"{renders}/alpha/{image}").convert("L")
    mask = Image.open(f"{masks}/{view}").convert("L").resize(alpha.size, Image.BOX)
    pixels.append(np.array(alpha)[np.array(mask) == 0] / 255)
configuration, seed = model.split("/")[-2:]
print(f"| {configuration} | {seed[5:]} | {np.mean(np.concatenate(pixels)):.4f} |")
PYTHON
    rm -rf -- "$renders"
  done
}

run_block() {
  local base
  case $1 in
    # Gains and tints, with and without what learns them.
    appearance)
      compare appearance "$short --train_test_exp" 'none=;--exposure=--exposure --exposure_lr_init 0.01 --exposure_lr_final 0.0001' \
        orbit orbit_gains fox fox_gains bonsai bonsai_gains
      ;;
    grid)
      base='--bilateral_grid=--bilateral_grid'
      compare grid "$short --train_test_exp" "$base" orbit orbit_gains fox fox_gains bonsai bonsai_gains
      base='--bilateral_grid_lr 0.0005=--bilateral_grid --bilateral_grid_lr 0.0005'
      base+=';--bilateral_grid_lr 0.008=--bilateral_grid --bilateral_grid_lr 0.008'
      base+=';--bilateral_grid_tv 1=--bilateral_grid --bilateral_grid_tv 1'
      base+=';--bilateral_grid_tv 100=--bilateral_grid --bilateral_grid_tv 100'
      compare grid "$short --train_test_exp" "$base" orbit_gains
      ;;
    # Photographs so dark that gains cut nothing off; and five times as many iterations.
    dim)
      base='--exposure --exposure_lr_init 0.01 --exposure_lr_final 0.0001'
      compare dim "$short --train_test_exp" "none=;--exposure=$base" orbit_dim orbit_dimgains
      compare dim "$common --preset original --strategy balanced --steps_scaler 0.25 --train_test_exp" \
        "none, 7500=;--exposure, 7500=$base" orbit_dim orbit_dimgains orbit orbit_gains
      ;;
    # Other learning rates of --exposure than 0.01 to 0.0001; 0.003 to 0.00003 is the default.
    rates)
      base='0.003 to 0.00003=--exposure --exposure_lr_init 0.003 --exposure_lr_final 0.00003'
      compare rates "$short --train_test_exp" "$base" orbit orbit_gains fox fox_gains bonsai bonsai_gains \
        orbit_dim orbit_dimgains
      compare rates "$common --preset original --strategy balanced --steps_scaler 0.25 --train_test_exp" "${base/=/, 7500=}" \
        orbit_dim orbit_dimgains
      base='0.001 to 0.0001=--exposure --exposure_lr_init 0.001 --exposure_lr_final 0.0001'
      base+=';0.01 to 0.00001=--exposure --exposure_lr_init 0.01 --exposure_lr_final 0.00001'
      compare rates "$short --train_test_exp" "$base" orbit orbit_gains
      ;;
    masks)
      compare masks "$short" 'none=' orbit fox
      compare masks "$short" 'none=--masks none;masks=' orbit_covered fox_covered
      ;;
    # Masks that show the solids of orbit only. PSNR is over what test masks show.
    segment)
      base='ignore=;segment=--mask_mode segment;weight 0.1=--mask_mode segment --mask_alpha_weight 0.1'
      KEEP=1 compare segment "$short" "$base" orbit_object
      ;;
    poses)
      compare poses "$short" '--pose_opt=--pose_opt;--pose_opt_lr 0.00015=--pose_opt --pose_opt_lr 0.00015' orbit fox
      base='none=;--pose_opt=--pose_opt'
      base+=';--pose_opt_lr 0.00015=--pose_opt --pose_opt_lr 0.00015'
      base+=';--pose_opt_lr 0.0015=--pose_opt --pose_opt_lr 0.0015'
      base+=';--pose_opt_from_iter 0=--pose_opt --pose_opt_from_iter 0'
      base+=';--pose_opt_from_iter 5000=--pose_opt --pose_opt_from_iter 5000'
      compare poses "$short" "$base" orbit_turned fox_turned
      ;;
    # Seven training photographs of three scenes, with true depth maps.
    depths)
      base='none=;--depths=--depths depths'
      base+=';--depth_l1_weight_init 0.1=--depths depths --depth_l1_weight_init 0.1 --depth_l1_weight_final 0.001'
      base+=';--depth_l1_weight_init 10=--depths depths --depth_l1_weight_init 10 --depth_l1_weight_final 0.1'
      base+=';--depth_l1_weight_final 1=--depths depths --depth_l1_weight_final 1'
      SEEDS=0 compare depths "$short" "$base" few_0 few_1 few_2
      ;;
    mcmc)
      base='none=;--growth 0.01=--growth 0.01;--growth 0.1=--growth 0.1'
      base+=';--noise_from_iter 5000=--noise_from_iter 5000;--noise_from_iter 15000=--noise_from_iter 15000'
      compare mcmc "$common --strategy mcmc --steps_scaler 0.05 --max_gaussians 12000" "$base" orbit
      compare mcmc "$common --strategy mcmc --steps_scaler 0.05 --max_gaussians 24000" "$base" fox
      ;;
    # With the default limit, the count would be the number of points at this size.
    balanced)
      base='none=;--opacity_decay 0.99=--opacity_decay 0.99;--opacity_decay 0.98=--opacity_decay 0.98'
      base+=';--reg_from_iter 5000=--reg_from_iter 5000;--reg_from_iter 15000=--reg_from_iter 15000'
      compare balanced "$short --max_gaussians 24000" "$base" orbit fox
      ;;
  esac
}

for block in "${blocks[@]}"; do
  [[ $block == tables ]] || run_block "$block"
done
for block in "${all_blocks[@]}"; do
  [[ -s $output/$block/results.jsonl ]] || continue
  [[ " ${blocks[*]} " == *" $block "* || " ${blocks[*]} " == *" tables "* ]] || continue
  printf '\n### %s\n\n' "$block"
  "$scripts/compare_presets.sh" "$b3dgs" "$output/$block"
  [[ $block != segment ]] || alpha_left
done
if ((is_left)); then exit 3; fi
