#!/usr/bin/env python3
"""Prints the names of an eighth of the photographs of a COLMAP scene whose cameras are neighbours.

Usage: scripts/hold_out_arc.py SCENE [START] > SCENE/sparse/0/test.txt

With this list, --eval holds out one arc instead of every 8th photograph, so that PSNR and SSIM are those of views away
from the photographs. The cameras are ordered by azimuth about the point that they look at, from START degrees
(default 0). SCENE/sparse/0/images.bin is read. Needs python3-numpy.
"""
import struct
import sys

import numpy as np


def read_images(path):
    """Returns the names, the rotations [N, 3, 3] (world to camera) and the camera centres [N, 3]."""
    data = open(path, "rb").read()
    (count,), at = struct.unpack_from("<Q", data), 8
    names, rotations, centres = [], [], []
    for _ in range(count):
        _, w, x, y, z, *translation, _ = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        names.append(data[at + 64 : end].decode())
        (n_features,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * n_features
        rotations.append([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                          [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                          [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])
        centres.append(-np.array(rotations[-1]).T @ np.array(translation))
    return names, np.array(rotations), np.array(centres)


def azimuths(rotations, centres):
    """Returns degrees about the point nearest to all optical axes, around the mean up direction."""
    axes = rotations[:, 2]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    focus = np.linalg.lstsq(across.sum(0), np.einsum("nij,nj->i", across, centres), rcond=None)[0]
    up = -rotations[:, 1].mean(0)
    first = np.cross(up, [1, 0, 0] if abs(up[0]) < 0.9 * np.linalg.norm(up) else [0, 1, 0])
    second = np.cross(up, first) / np.linalg.norm(up)
    return np.degrees(np.arctan2((centres - focus) @ second, (centres - focus) @ first))


if len(sys.argv) not in (2, 3):
    sys.exit(__doc__)
names, rotations, centres = read_images(sys.argv[1] + "/sparse/0/images.bin")
from_start = (azimuths(rotations, centres) - float(sys.argv[2] if len(sys.argv) > 2 else 0)) % 360
for i in np.argsort(from_start, kind="stable")[: (len(names) + 7) // 8]:
    print(names[i])
