#!/usr/bin/env python3
"""Times training with few of the photographs in host memory against all of them there.

Makes a scene of many photographs whose files are links to those of a small scene, trains it with each limit in turns,
and prints the time of a step. Needs the built program and python3, nothing else.

  scripts/bench_host_memory.py PROGRAM WORK_FOLDER [--scene SCENE] [--views 3000] [--gb 2] [--iterations 3000]

Without --scene, b3dgs synth makes one of 1600 x 1067 px. SCENE is a COLMAP scene whose photographs are all on disk,
with a binary or text model in sparse/0. Exits with 1 if the ratio of the times is 1.1 or more.
"""
import argparse
import json
import os
import shutil
import statistics
import struct
import subprocess
import sys
from pathlib import Path


def read_binary_images(path):
    """(qw, qx, qy, qz, tx, ty, tz, camera id, name) of each image of images.bin."""
    data = path.read_bytes()
    (count,), at = struct.unpack_from("<Q", data), 8
    images = []
    for _ in range(count):
        fields = struct.unpack_from("<I7dI", data, at)
        at += struct.calcsize("<I7dI")
        end = data.index(b"\0", at)
        name = data[at:end].decode()
        (n_points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * n_points
        images.append(fields[1:] + (name,))
    return images


def read_text_images(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    images = []
    for line in lines[::2]:  # every second line lists 2D points
        if line.strip():
            parts = line.split()
            images.append(tuple(map(float, parts[1:8])) + (int(parts[8]), " ".join(parts[9:])))
    return images


def write_images(path, images):
    """In the format of the file whose place it takes."""
    if path.suffix == ".bin":
        with open(path, "wb") as out:
            out.write(struct.pack("<Q", len(images)))
            for number, image in enumerate(images, 1):
                out.write(struct.pack("<I7dI", number, *image[:8]) + image[8].encode() + b"\0" + struct.pack("<Q", 0))
    else:
        with open(path, "w") as out:
            for number, image in enumerate(images, 1):
                out.write(" ".join([str(number)] + [repr(v) for v in image[:8]] + [image[8]]) + "\n\n")


def make_linked_scene(source, target, n_views):
    """`source` with n_views photographs: link i has the file and pose of photograph i modulo their number."""
    shutil.rmtree(target, ignore_errors=True)
    (target / "images").mkdir(parents=True)
    shutil.copytree(source / "sparse" / "0", target / "sparse" / "0")
    model = target / "sparse" / "0"
    binary = (model / "images.bin").exists()
    images_file = model / ("images.bin" if binary else "images.txt")
    images = read_binary_images(images_file) if binary else read_text_images(images_file)
    images = [image for image in images if (source / "images" / image[8]).exists()]
    if not images:
        sys.exit(f"{source}/images: holds none of the photographs of its model")
    linked = []
    for i in range(n_views):
        image = images[i % len(images)]
        name = f"{i:06d}{Path(image[8]).suffix}"
        os.symlink((source / "images" / image[8]).resolve(), target / "images" / name)
        linked.append(image[:8] + (name,))
    write_images(images_file, linked)
    return len(images)


def train(program, scene, model, iterations, options):
    """Milliseconds of a step, without the first third of the training, and where the photographs were."""
    shutil.rmtree(model, ignore_errors=True)
    command = [program, "train", "-s", scene, "-m", model, "--preset", "inria", "--iterations", str(iterations)]
    command += options
    run = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\nended with {run.returncode}:\n{run.stderr}")
    places = [line[len("photographs "):] for line in run.stdout.splitlines() if line.startswith("photographs ")]
    times = {}
    for line in (model / "train.jsonl").read_text().splitlines():
        record = json.loads(line)
        if "event" not in record:
            times[record["iteration"]] = record["elapsed_s"]
    first = min(i for i in times if i >= iterations // 3)
    last = max(times)
    return 1e3 * (times[last] - times[first]) / (last - first), places[0] if places else "?"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path, help="b3dgs")
    parser.add_argument("work", type=Path, help="folder for scenes and models; scenes in it are replaced")
    parser.add_argument("--scene", type=Path, help="COLMAP scene whose photographs are linked to")
    parser.add_argument("--views", type=int, default=3000, help="photographs of the scene that is trained")
    parser.add_argument("--gb", type=float, default=2, help="--host_memory_gb of the limited training")
    parser.add_argument("--iterations", type=int, default=3000)
    parser.add_argument("--turns", type=int, default=2, help="times that each is trained, in alternation")
    parser.add_argument("--options", default="", help="more options of b3dgs train, in one word")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    source = args.scene
    if source is None:
        source = args.work / "source"
        subprocess.run([str(args.program), "synth", "orbit", str(source), "--views", "24", "--width", "1600", "--height",
                        "1067", "--points", "100000", "--image_format", "jpg", "--overwrite", "--quiet"], check=True)
    scene = args.work / "linked"
    n_files = make_linked_scene(source, scene, args.views)

    # At most 1 GB of photographs stays on a GPU, because otherwise the limit would not matter there. The kernel is
    # fixed, because one chosen by its time may differ.
    common = ["--gpu_memory_gb", "2", "--kernel", "segmented", "--test_iterations", str(args.iterations),
              "--save_iterations", str(args.iterations)] + args.options.split()
    cases = {"all": ["--host_memory_gb", "1000000"], f"{args.gb:g} GB": ["--host_memory_gb", str(args.gb)]}
    times, places = {name: [] for name in cases}, {}
    for turn in range(args.turns):
        for name in (list(cases) if turn % 2 == 0 else list(reversed(cases))):
            ms, places[name] = train(args.program, scene, args.work / "model", args.iterations, common + cases[name])
            times[name].append(ms)
    print(f"{args.views} photographs, links to {n_files} files of {source}; {args.iterations} iterations, "
          f"{args.turns} turns")
    print(f"{'in memory':<12}{'ms a step':>10}{'from':>9}{'to':>9}   photographs")
    for name, values in times.items():
        print(f"{name:<12}{statistics.median(values):>10.3f}{min(values):>9.3f}{max(values):>9.3f}   {places[name]}")
    every, limited = (statistics.median(values) for values in times.values())
    print(f"ratio       {limited / every:>10.3f}")
    return 0 if limited < 1.1 * every else 1


if __name__ == "__main__":
    sys.exit(main())
