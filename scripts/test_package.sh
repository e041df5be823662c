#!/usr/bin/env bash
# Makes bare Debian 12 and 13 systems with debootstrap, in a temporary folder, and tests the packages of cpack in each:
# without a network, trains a synthetic scene, renders and exports it. As root: scripts/test_package.sh [BUILD_FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."
packages=$(realpath "${1:-build/cpu}/packages")
deb=("$packages"/b3dgs_*.deb) tar=("$packages"/b3dgs-*.tar.gz)
for file in "${deb[@]}" "${tar[@]}"; do
  [[ -f $file ]] || { echo "test_package.sh: error: no $file; run cpack in the build folder first" >&2; exit 2; }
done
scripts/install_packages.sh debootstrap
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' 'Label: Debian' | head -n 1)
work=$(mktemp -d)
# debootstrap leaves mounts behind if it fails.
trap 'umount -q "$work"/*/{proc,sys} || true; rm -rf --one-file-system -- "$work"' EXIT

quietly() { "$@" > "$work/log" 2>&1 || { cat "$work/log"; exit 1; }; }
in_root() { quietly unshare --mount --pid --fork --net --root="$root" --mount-proc bash -euxc "$1"; }

test_program() {  # PACKAGE PROGRAM
  in_root "cd \$(mktemp -d)
    '$2' synth orbit scene --views 12 --width 96 --height 64
    '$2' train scene -m model --iterations 60 --device cpu
    '$2' render model
    '$2' export model model.spz
    test -s model/point_cloud/iteration_60/point_cloud.ply
    test -s model/train/ours_60/renders/00011.png
    test -s model.spz"
  echo "Debian $(cat "$root/etc/debian_version"), $(basename "$1"): trained, rendered and exported a scene"
}

for suite in bookworm trixie; do
  root=$work/$suite
  quietly debootstrap --variant=minbase "$suite" "$root" "$mirror"
  mkdir "$root/any folder"
  tar -xf "${tar[0]}" -C "$root/any folder" --strip-components 1
  test_program "${tar[0]}" "/any folder/bin/b3dgs"
  rm -r "$root/any folder"
  cp "${deb[0]}" "$root/b3dgs.deb"
  in_root 'dpkg --install /b3dgs.deb'
  test_program "${deb[0]}" b3dgs
done
