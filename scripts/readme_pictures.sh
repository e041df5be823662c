#!/usr/bin/env bash
# Makes pictures for README in docs/images: scene.webp (a held-out photograph beside its render), orbit.webp (an
# animation) and live_page.png (the page of `b3dgs view`). Renders the photographs of the scene `terrace` with Blender
# and trains on the CPU. Photographs, a model and frames that exist are used again.
# Needs blender, ffmpeg, chromium, node, npm and pngquant.
# Usage: scripts/readme_pictures.sh B3DGS [WORK_FOLDER [TRAIN_OPTIONS...]]    default: output/readme
set -euo pipefail
cd "$(dirname "$0")/.."
b3dgs=$(realpath "${1:?missing argument: path of the b3dgs program}")
work=${2:-output/readme}
shift $(($# < 2 ? $# : 2))
views=54 size=800 samples=24 iterations=3000 held_out=0008
max_animation_bytes=2000000 max_page_bytes=300000
model=$work/terrace_model

# small FILE MAX_BYTES: fails if a file is too large to be committed.
small() {
  local bytes
  bytes=$(stat -c %s "$1")
  if ((bytes > $2)); then
    echo "readme_pictures.sh: error: $1 has $bytes bytes (expected at most $2)" >&2
    exit 1
  fi
}

mkdir -p "$work" docs/images
blender -b -t "$(nproc)" -P scripts/make_scenes.py -- "$work" --scenes terrace --views "$views" --size "$size" \
  --samples "$samples" > "$work/blender.log"
if [[ ! -d $model/point_cloud/iteration_$iterations ]]; then
  "$b3dgs" train "$work/terrace" -m "$model" --eval --preset fast --iterations "$iterations" --device cpu "$@"
fi
"$b3dgs" eval "$model" --device cpu --save_images

# The left half of the photograph, a white line, and the right half of the render.
test_views=$model/test/ours_$iterations
name=$(python3 -c 'import json, sys
for image, view in json.load(open(sys.argv[1])).items():
    if sys.argv[2] in str(view): print(image)' "$test_views/views.json" "$held_out")
ffmpeg -nostdin -v error -y -i "$test_views/gt/$name" -i "$test_views/renders/$name" -filter_complex \
  '[0]crop=iw/2-1:ih:0:0,pad=iw+2:color=white[a];[1]crop=iw/2-1:ih:iw/2+1:0[b];[a][b]hstack' \
  -map_metadata -1 -c:v libwebp -quality 88 docs/images/scene.webp

if [[ ! -d $work/orbit/renders ]]; then
  "$b3dgs" render "$model" --device cpu --path orbit --frames 96 --width 480 --no_depth --no_alpha --output "$work/orbit"
fi
ffmpeg -nostdin -v error -y -framerate 16 -pattern_type glob -i "$work/orbit/renders/*.png" -map_metadata -1 \
  -c:v libwebp_anim -loop 0 -quality 50 -compression_level 6 docs/images/orbit.webp
small docs/images/orbit.webp "$max_animation_bytes"

if [[ ! -d $work/browser/node_modules/playwright-core ]]; then
  npm install --silent --no-audit --no-fund --prefix "$work/browser" playwright-core@1
fi
script=$PWD/scripts/picture_view.cjs
(cd "$work" && NODE_PATH=$PWD/browser/node_modules node "$script" "$b3dgs" "$(basename "$model")" page.png)
pngquant --force --strip --output docs/images/live_page.png 128 "$work/page.png"
small docs/images/live_page.png "$max_page_bytes"
