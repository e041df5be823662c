#!/usr/bin/env bash
# Makes a .deb and a .tar.gz of b3dgs for NVIDIA GPUs of compute capability 7.5 to 10.0, with all libraries but the
# driver, in build/package/packages, prints what makes up their size, and tries the .tar.gz. If LibTorch makes it larger
# than 3 GB, makes smaller ones, too, which use an installed PyTorch. Needs no GPU to build, but one to try all of it.
#
#   scripts/package_gpu.sh [--libtorch FOLDER] [--architectures LIST] [--with-pytorch] [-- CMAKE_ARGUMENT...]
#   scripts/package_gpu.sh --try FILE.tar.gz [--hide FOLDER]...
#     --libtorch FOLDER     a LibTorch with CUDA; otherwise that of python3
#     --architectures LIST  as CMake writes them (default: 75-real;80-real;86-real;89-real;90-real;100)
#     --with-pytorch        makes only the small package, which uses an installed PyTorch of the same version
#     --try FILE.tar.gz     only tries a package, with an empty environment, in another folder
#     --hide FOLDER         is empty for the program during the trial (needs root)
set -euo pipefail
cd "$(dirname "$0")/.."

fail() {
  echo "package_gpu.sh: error: $1" >&2
  exit "${2:-2}"
}

# Trains, evaluates, exports and shows a page from the unpacked package. Without a GPU, requires one clear line of
# --device cuda, and trains on the CPU.
try_package() {  # FILE.tar.gz HIDDEN...
  local work file
  file=$(realpath "$1")
  shift
  work=$(mktemp -d)
  trap 'rm -rf -- "$work"' RETURN
  mkdir "$work/unpacked here" "$work/empty"
  tar -xf "$file" -C "$work/unpacked here" --strip-components 1
  cat >"$work/trial.sh" <<'END'
set -euo pipefail
b3dgs=$1 work=$2
shift 2
for folder in "$@"; do mount --bind "$work/empty" "$folder"; done
cd "$work"
"$b3dgs" --version
"$b3dgs" synth orbit scene --views 12 --width 96 --height 64 --quiet
device=cuda
if ! "$b3dgs" train scene -m model --eval --iterations 60 --device cuda --quiet >train.log 2>&1; then
  cat train.log
  [[ $(wc -l <train.log) == 1 ]] && grep -q '^error: --device cuda: ' train.log || exit 1
  device=cpu
  "$b3dgs" train scene -m model --eval --iterations 60 --quiet
fi
"$b3dgs" eval model --device "$device" --quiet
"$b3dgs" export model model.spz --device "$device" --quiet
"$b3dgs" view model --view 0 --device "$device" >view.log 2>&1 &
page=$!
for ((i = 0; i < 100; ++i)); do
  if grep -q http view.log; then break; fi
  sleep 0.2
done
address=$(sed -n 's|.*http://127.0.0.1:\([0-9]*\)/?token=\(.*\)|\1 \2|p' view.log)
read -r port token <<<"$address"
exec 3<>"/dev/tcp/127.0.0.1/$port"
printf 'GET /?token=%s HTTP/1.1\r\nHost: 127.0.0.1:%s\r\nConnection: close\r\n\r\n' "$token" "$port" >&3
grep -q '<title>b3dgs</title>' <&3
kill -INT "$page"
wait "$page"
echo "trained, evaluated, exported and shown on: $device"
END
  local -a apart=(env -i PATH=/usr/bin:/bin HOME="$work")
  if (($# > 0)); then apart=(unshare --mount "${apart[@]}"); fi
  "${apart[@]}" bash "$work/trial.sh" "$work/unpacked here/bin/b3dgs" "$work" "$@"
}

libtorch='' architectures='75-real;80-real;86-real;89-real;90-real;100' only_small=false tried='' hidden=()
while (($# > 0)); do
  case $1 in
    --libtorch | --architectures | --try | --hide)
      [[ -n ${2:-} ]] || fail "missing value: $1"
      case $1 in
        --libtorch) libtorch=$2 ;;
        --architectures) architectures=$2 ;;
        --try) tried=$2 ;;
        --hide) hidden+=("$(realpath "$2")") ;;
      esac
      shift
      ;;
    --with-pytorch) only_small=true ;;
    --)
      shift
      break
      ;;
    -h | --help)
      sed -n '2,/^set /{/^set /d; s/^# \{0,1\}//; p}' "$0"
      exit 0
      ;;
    *) fail "unknown option: $1 (see --help; arguments for CMake go after --)" ;;
  esac
  shift
done
if [[ -n $tried ]]; then
  [[ -f $tried ]] || fail "no such package: $tried"
  try_package "$tried" "${hidden[@]}"
  exit 0
fi

nvcc=$(command -v nvcc || ls -1 "${CUDA_HOME:-/usr/local/cuda}/bin/nvcc" 2>/dev/null || true)
[[ -n $nvcc ]] || fail "nvcc was not found; install the CUDA toolkit, or set CUDA_HOME" 1
if [[ -z $libtorch ]]; then
  libtorch=$(python3 -c 'import os, torch; print(os.path.dirname(torch.__file__))' 2>/dev/null || true)
fi
[[ -e $libtorch/lib/libtorch_cuda.so ]] ||
  fail "no LibTorch with CUDA in '${libtorch}'; name the folder that contains lib/libtorch_cuda.so: --libtorch FOLDER" 1
libtorch=$(realpath "$libtorch")

build=build/package
cmake_arguments=(-DCMAKE_CUDA_COMPILER="$nvcc" -DCMAKE_CUDA_ARCHITECTURES="$architectures"
  -DCMAKE_PREFIX_PATH="$libtorch" "$@")

make_packages() {  # BUNDLE_TORCH; sets `tar`, the package
  if [[ $1 == OFF ]]; then build=build/package-pytorch; fi
  cmake --preset gpu -B "$build" -DB3DGS_BUNDLE_TORCH="$1" "${cmake_arguments[@]}"
  cmake --build "$build" --target b3dgs
  (cd "$build" && cpack)
  tar=$(echo "$build"/packages/*.tar.gz)
  ls -l --block-size=MB "$build"/packages/*.deb "$tar"
  echo "largest files of $tar, unpacked:"
  tar -tvf "$tar" | sort -k3 -rn | head -n 15 | awk '{printf "%8.1f MB  %s\n", $3 / 1e6, $6}'
}

if ! $only_small; then
  make_packages ON
  try_package "$tar" "$libtorch"
fi
if $only_small || (($(stat -c %s "$tar") > 3000000000)); then
  make_packages OFF
  try_package "$tar"
fi
