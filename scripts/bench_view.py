#!/usr/bin/env python3
"""Times the frames of the live view as a browser receives them, with HTTP and JPEG, one request at a time.

Starts b3dgs view, asks for frames from cameras on a circle about the middle of the scene, and prints frames per second
and the time from request to answer. The first 20 frames are not counted. Needs the built program and python3, nothing
else.

  scripts/bench_view.py PROGRAM MODEL [--device cuda] [--width 1280] [--height 720] [--frames 300] [--min_fps 30]
      [--options "-s SCENE"]

MODEL is what b3dgs view takes: a model folder with cameras, or a file of Gaussians with -s SCENE among --options.
Exits with 1 if there are fewer frames per second than --min_fps.
"""
import argparse
import http.client
import json
import math
import re
import statistics
import subprocess
import sys
import time


def turned(camera_to_world, pivot, angle):
    """A camera turned about the vertical of its own picture through `pivot`. Row-major, as in the request."""
    up = [camera_to_world[row * 4 + 1] for row in range(3)]
    c, s = math.cos(angle), math.sin(angle)

    def rotate(v):
        dot = sum(a * b for a, b in zip(up, v))
        cross = [up[1] * v[2] - up[2] * v[1], up[2] * v[0] - up[0] * v[2], up[0] * v[1] - up[1] * v[0]]
        return [v[i] * c + cross[i] * s + up[i] * dot * (1 - c) for i in range(3)]

    columns = [rotate([camera_to_world[row * 4 + column] for row in range(3)]) for column in range(3)]
    center = rotate([camera_to_world[row * 4 + 3] - pivot[row] for row in range(3)])
    rows = []
    for row in range(3):
        rows += [columns[0][row], columns[1][row], columns[2][row], center[row] + pivot[row]]
    return rows + [0, 0, 0, 1]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="b3dgs")
    parser.add_argument("model")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, default=720)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--min_fps", type=float, default=0)
    parser.add_argument("--options", default="", help="more options of b3dgs view, as one quoted string")
    args = parser.parse_args()
    command = [args.program, "view", args.model, "--device", args.device, "--view", "0"] + args.options.split()
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        port = token = None
        for line in server.stdout:
            match = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\w+)", line)
            if match:
                port, token = int(match[1]), match[2]
                break
        if port is None:
            sys.exit(f"{' '.join(command)}: printed no address")
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        headers = {"X-Token": token, "Content-Type": "application/json"}

        def ask(method, path, body=None):
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            data = answer.read()
            if answer.status != 200:
                sys.exit(f"{path}: {answer.status} {data[:300]!r}")
            return answer, data

        scene = json.loads(ask("GET", "/cameras")[1])
        first = scene["views"][0]["camera_to_world"]
        pivot = scene["center"]
        times, sizes = [], []
        n_warm_up = 20
        for i in range(args.frames + n_warm_up):
            camera = {"camera_to_world": turned(first, pivot, 2 * math.pi * i / args.frames), "fov": 50}
            body = json.dumps({"width": args.width, "height": args.height, "mode": "render", "camera": camera})
            start = time.perf_counter()
            answer, data = ask("POST", "/frame", body)
            if i >= n_warm_up:
                times.append(time.perf_counter() - start)
                sizes.append(len(data))
            if i == 0:
                print(f"first frame: {answer.getheader('X-Frame')}")
    finally:
        server.terminate()
        server.wait()
    times.sort()
    fps = len(times) / sum(times)
    print(f"{args.width} x {args.height}, {len(times)} frames: {fps:.1f} frames a second; latency median "
          f"{1e3 * statistics.median(times):.1f} ms, 95 % {1e3 * times[int(0.95 * len(times))]:.1f} ms, "
          f"longest {1e3 * times[-1]:.1f} ms; JPEG {statistics.mean(sizes) / 1e3:.0f} kB")
    return 0 if fps >= args.min_fps else 1


if __name__ == "__main__":
    sys.exit(main())
