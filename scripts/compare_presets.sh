#!/usr/bin/env bash
# Trains every SCENE with every preset and strategy and several seeds, and prints a Markdown table of time, count, PSNR
# and SSIM (mean, and half the range over seeds), and how far the PSNR is below that of the best configuration of the
# scene. Above the table are the program, the machine, and the commit of this script's repository. Colour-corrected PSNR
# has a column if a training measured it. After trainings with --train_test_exp, whole test views are also measured.
#
# Results are added to OUTPUT/results.jsonl, a line for each training. Trainings listed there are not repeated, so the
# script can be stopped and run again, also with other scenes, configurations and seeds. The table has all results.
# Models that this script trained are deleted after they are measured, but logs and reports stay. OUTPUT must be new,
# empty, or from an earlier run of this script.
#
# Usage: scripts/compare_presets.sh B3DGS OUTPUT [SCENE[::OPTIONS]...]      without scenes: only prints the table
#   OPTIONS  of the trainings of this scene, such as data/lego::-w
# Environment:
#   CONFIGS  configurations NAME=OPTIONS, separated by semicolons; default: see below
#   SEEDS    default "0 1 2"
#   OPTIONS  options of all trainings; default "--device cuda"
#   LIMIT_S  starts no further training once so many seconds have passed, and exits with 3 if any is left; default: none
#   JOBS     how many trainings run at a time; default 1. Several slow each other down: the table has the times of
#            trainings with JOBS=1, or, if there are none, of all, marked "N at once"
#   KEEP     1: keeps the models
# Example: LIMIT_S=500 SEEDS=0 CONFIGS='fast=--preset fast;mine=--preset fast --max_gaussians 200000' \
#   scripts/compare_presets.sh build/gpu/app/b3dgs output/presets data/bonsai data/fox
set -euo pipefail
usage='scripts/compare_presets.sh B3DGS OUTPUT [SCENE...]'
b3dgs=${1:?the program is missing: $usage}
output=${2:?the output folder is missing: $usage}
shift 2
configs=${CONFIGS:-inria=--preset inria;fast=--preset fast;quality=--preset quality;best=--preset best;mcmc=--strategy mcmc}
read -ra seeds <<< "${SEEDS:-0 1 2}"
read -ra options <<< "${OPTIONS:---device cuda}"
results=$output/results.jsonl
mark=$output/.made_by_compare_presets
if [[ -e $output && ! -f $mark ]] && ! { [[ -d $output ]] && [[ -z $(ls -A -- "$output") ]]; }; then
  echo "compare_presets.sh: error: $output: holds something that this script did not make; name another folder" >&2
  exit 2
fi
mkdir -p -- "$output"
touch -- "$mark" "$results"
jobs_at_once=${JOBS:-1}
if ! [[ $jobs_at_once =~ ^[1-9][0-9]*$ ]]; then
  echo "compare_presets.sh: error: JOBS: \"$jobs_at_once\" is no number of trainings; give 1 or more" >&2
  exit 2
fi

# is_known SCENE NAME SEED OPTIONS PATH: whether results.jsonl has this training. Fails if it is listed with other
# options, or if the scene's name belongs to a scene in another folder.
is_known() {
  python3 - "$results" "$@" << 'PYTHON'
import json, sys
path, scene, name, seed, options, scene_path = sys.argv[1:]
for line in open(path):
    run = json.loads(line)
    if run["scene"] == scene and run["scene_path"] != scene_path:
        sys.exit(f'compare_presets.sh: error: {path} has a scene {scene} in {run["scene_path"]}, not {scene_path}; '
                 f'use another OUTPUT, or rename the folder')
    if (run["scene"], run["configuration"], run["seed"]) != (scene, name, int(seed)):
        continue
    if run["options"] != options:
        sys.exit(f'compare_presets.sh: error: {path} has {name} of {scene} with the options "{run["options"]}", '
                 f'not "{options}"; give the configuration another name')
    print("yes")
PYTHON
}

# The commit that this script is in, as git describe names it; empty without git or outside a repository.
commit=$(git -C "$(dirname "$0")" describe --always --dirty=+changes 2> /dev/null || true)

# whole_psnr SCENE MODEL: after a training with --train_test_exp, the PSNR of whole test views without fitted colours.
whole_psnr() {
  python3 - "$b3dgs" "$@" << 'PYTHON'
import json, re, subprocess, sys
b3dgs, scene, model = sys.argv[1:]
config = json.load(open(model + "/config.json"))
if config.get("train_test_exp"):
    file = f'{model}/point_cloud/iteration_{config["iterations"]}/point_cloud.ply'
    command = [b3dgs, "eval", file, "-s", scene, "--split", "test", "--quiet", "-r", str(config["resolution"]),
               "--device", config["device"], "--threads", str(config["threads"])]
    out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    mean = re.search(r"^mean of \d+ +([0-9.]+)", out, re.MULTILINE)
    if not mean:
        sys.exit(f"compare_presets.sh: error: no mean in what b3dgs eval {file} printed")
    print(mean.group(1))
PYTHON
}

# record SCENE NAME SEED OPTIONS PATH MODEL WHOLE_PSNR: adds the training's end to results.jsonl.
record() {
  python3 - "$results" "$commit" "$jobs_at_once" "$@" << 'PYTHON'
import json, sys
path, commit, jobs, scene, name, seed, options, scene_path, model, whole_psnr = sys.argv[1:]
points = [json.loads(line) for line in open(model + "/train.jsonl")]
last = [point for point in points if "event" not in point][-1]
iterations = json.load(open(model + "/config.json"))["iterations"]
if last["iteration"] != iterations:
    sys.exit(f"compare_presets.sh: error: {model} ended at iteration {last['iteration']} of {iterations}")
run = {"scene": scene, "scene_path": scene_path, "configuration": name, "seed": int(seed), "options": options,
       "iterations": iterations, "seconds": last["elapsed_s"], "gaussians": last["count"], "psnr": last.get("test_psnr"),
       "ssim": last.get("test_ssim")}
try:
    machine = json.load(open(model + "/report/run.json"))["machine"]
except (OSError, ValueError, KeyError):
    machine = {}
if last.get("test_cc_psnr") is not None:
    run["cc_psnr"] = last["test_cc_psnr"]
if whole_psnr:
    run["whole_psnr"] = float(whole_psnr)
run["program"] = machine.get("program")
run["machine"] = machine.get("gpu") or machine.get("cpu")
run["commit"] = commit or None
run["at_once"] = int(jobs)
with open(path, "a") as file:
    file.write(json.dumps(run) + "\n")
PYTHON
}

# train_one SCENE NAME SEED OPTIONS PATH MODEL
train_one() {
  local options whole
  if [[ -n ${LIMIT_S:-} ]] && (($(date +%s) - started >= LIMIT_S)); then
    return 0
  fi
  read -ra options <<< "$4"
  echo "== $1, $2, seed $3" >&2
  "$b3dgs" train "$5" -m "$6" --eval --overwrite --quiet --seed "$3" --checkpoint_minutes 0 "${options[@]}" >&2
  whole=$(whole_psnr "$5" "$6")
  record "$1" "$2" "$3" "$4" "$5" "$6" "$whole"
  if [[ ${KEEP:-0} != 1 ]]; then
    rm -rf -- "$6/point_cloud" "$6/checkpoints"
  fi
}

# list_trainings SCENE...: the arguments of train_one for every training that is not in results.jsonl. Fails if two
# different ones would have the same folder.
list_trainings() {
  local scene scene_path scene_name seed config name own of_scene all known model
  local -A listed=()
  for scene in "$@"; do
    of_scene=()
    [[ $scene != *::* ]] || read -ra of_scene <<< "${scene#*::}"
    scene_path=$(realpath -- "${scene%%::*}")
    scene_name=$(basename "$scene_path")
    for seed in "${seeds[@]}"; do
      while IFS= read -r -d ';' config; do
        name=${config%%=*}
        if [[ $config != *=* || -z $name || $name == */* ]]; then
          echo "compare_presets.sh: error: CONFIGS: \"$config\" is not NAME=OPTIONS" >&2
          exit 2
        fi
        read -ra own <<< "${config#*=}"
        all="${options[*]} ${own[*]}${of_scene[*]:+ ${of_scene[*]}}"
        known=$(is_known "$scene_name" "$name" "$seed" "$all" "$scene_path")
        [[ -z $known ]] || continue
        model=$output/$scene_name/$name/seed_$seed
        if [[ -n ${listed[$model]:-} ]]; then
          [[ ${listed[$model]} != "$scene_path $all" ]] || continue
          echo "compare_presets.sh: error: two trainings would write $model: that of ${listed[$model]}, and that of" \
            "$scene_path $all; give each configuration and each scene's folder a name of its own" >&2
          exit 2
        fi
        listed[$model]="$scene_path $all"
        printf '%s\0' "$scene_name" "$name" "$seed" "$all" "$scene_path" "$model"
      done <<< "$configs;"
    done
  done
}

# If a training fails, its shell exits with 255, and xargs starts no more.
list=$(mktemp)
trap 'rm -f -- "$list"' EXIT
list_trainings "$@" > "$list"
started=$(date +%s)
export b3dgs results commit jobs_at_once started
export -f train_one whole_psnr record
xargs -0 -r -n 6 -P "$jobs_at_once" \
  bash -euo pipefail -c 'trap "[[ \$? == 0 ]] || exit 255" EXIT; train_one "$@"' compare_presets.sh < "$list" || exit 1
list_trainings "$@" > "$list"

python3 - "$results" << 'PYTHON'
import json, sys
runs = [json.loads(line) for line in open(sys.argv[1])]
if not runs:
    sys.exit(0)

def spread(values, digits):
    """Mean, and half the range if there are several; "-" if a value is not known."""
    if any(value is None for value in values):
        return "-"
    text = f"{sum(values) / len(values):,.{digits}f}"
    return text if len(values) == 1 else text + f" ± {(max(values) - min(values)) / 2:,.{digits}f}"

def times(group):
    """Times of the trainings that ran alone; of all, with a remark, if none did."""
    alone = [run["seconds"] for run in group if run.get("at_once", 1) == 1]
    if alone:
        return spread(alone, 2)
    return spread([run["seconds"] for run in group], 2) + f', {max(run["at_once"] for run in group)} at once'

def listed(key):
    """The values of all lines, in order; lines of earlier versions of this script have none."""
    values = []
    for run in runs:
        value = run.get(key) or "unknown"
        if value not in values:
            values.append(value)
    return ", ".join(values)

print(f'Program: {listed("program")}. Machine: {listed("machine")}. Commit: {listed("commit")}.\n')
# Columns of quantities that only some trainings measure.
titles = (("cc_psnr", "colour-corrected PSNR, dB"), ("whole_psnr", "PSNR of whole views, dB"))
further = [(key, title) for key, title in titles
           if any(run.get(key) is not None for run in runs)]
print("| scene | configuration | iterations | seeds | training, s | Gaussians | PSNR, dB | below the best, dB | SSIM |"
      + "".join(f" {title} |" for _, title in further))
print("|---|---|---|---|---|---|---|---|---|" + "---|" * len(further))

def psnr_of(scene, configuration):
    """The mean; None if a training has not measured it."""
    values = [run.get("psnr") for run in runs if (run["scene"], run["configuration"]) == (scene, configuration)]
    return None if None in values else sum(values) / len(values)

def below_best(scene, configuration):
    all_of_scene = [psnr_of(scene, name) for name in {run["configuration"] for run in runs if run["scene"] == scene}]
    own, known = psnr_of(scene, configuration), [value for value in all_of_scene if value is not None]
    return "-" if own is None else f"{max(known) - own:.2f}"

done = set()
for first in runs:
    key = (first["scene"], first["configuration"])
    if key in done:
        continue
    done.add(key)
    group = [run for run in runs if (run["scene"], run["configuration"]) == key]
    column = lambda name: [run.get(name) for run in group]
    print(f'| {key[0]} | {key[1]} | {first["iterations"]:,} | {len(group)} | {times(group)} | '
          f'{spread(column("gaussians"), 0)} | {spread(column("psnr"), 2)} | {below_best(*key)} | '
          f'{spread(column("ssim"), 4)} |'
          + "".join(f' {spread(column(key), 2)} |' for key, _ in further))
PYTHON
if [[ -s $list ]]; then
  echo "compare_presets.sh: the time limit is reached; run it again for the rest" >&2
  exit 3
fi
