#!/usr/bin/env python3
"""Copies a COLMAP scene and puts known faults into its training photographs, or into their poses.

The photographs that `b3dgs train --eval` holds out, every 8th by name from the first on, and their poses stay as they
are (but for --dim). So held-out PSNR says what a fault costs, and what an option against it wins back. The same seed
gives the same faults. Needs numpy and Pillow.
"""

import argparse
import math
import os
import shutil
import struct
import sys
import tempfile

try:
    import numpy as np
    from PIL import Image
except ImportError as error:
    print(f"disturb_scene.py: error: {error}; apt-get install python3-numpy python3-pil, or pip install numpy pillow",
          file=sys.stderr)
    sys.exit(2)

HOLD_OUT_EVERY = 8  # kTestEvery of src/scene


def fail(text):
    print(f"disturb_scene.py: error: {text}", file=sys.stderr)
    sys.exit(2)


class Pose:
    """A pose of images.bin or images.txt: world to camera, quaternion (w, x, y, z) and translation."""

    def __init__(self, name, values, place):
        self.name = name
        self.q = np.array(values[:4], dtype=float)
        self.t = np.array(values[4:], dtype=float)
        self.place = place  # byte offset in images.bin, or line number in images.txt
        if not np.all(np.isfinite(values)) or np.linalg.norm(self.q) == 0:
            fail(f"the pose of {name} is not finite or has no rotation: {values}")

    def rotation(self):
        w, x, y, z = self.q / np.linalg.norm(self.q)
        return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])

    def centre(self):
        return -self.rotation().T @ self.t

    def turn_and_move(self, axis, angle, step):
        """Turns the camera about its centre, `axis` in camera coordinates, and moves the centre by `step` (world)."""
        centre = self.centre() + step
        w, v = math.cos(angle / 2), math.sin(angle / 2) * axis
        q = self.q / np.linalg.norm(self.q)
        self.q = np.concatenate([[w * q[0] - v @ q[1:]], w * q[1:] + q[0] * v + np.cross(v, q[1:])])
        self.t = -self.rotation() @ centre


def read_binary(path, data):
    """The poses of an images.bin."""
    poses = []
    i = 0
    try:
        (count,) = struct.unpack_from("<Q", data, 0)
        offset = 8
        for i in range(count):
            values = struct.unpack_from("<7d", data, offset + 4)
            end = data.index(b"\0", offset + 64)
            poses.append(Pose(data[offset + 64:end].decode(), values, offset + 4))
            (n_points,) = struct.unpack_from("<Q", data, end + 1)
            offset = end + 9 + 24 * n_points
            if offset > len(data):
                raise struct.error
    except (struct.error, ValueError):
        fail(f"{path}: ends in image {i + 1}; is it complete?")
    return poses


def read_text(path, lines):
    """The poses of an images.txt: two lines for each image, the second with its points."""
    poses = []
    is_points = False
    for number, line in enumerate(lines):
        if not is_points and (not line.strip() or line.lstrip().startswith("#")):
            continue
        if not is_points:
            fields = line.replace(",", " ").split(maxsplit=9)
            try:
                poses.append(Pose(fields[9].strip(), [float(field) for field in fields[1:8]], number))
            except (IndexError, ValueError):
                fail(f"{path}:{number + 1}: expected ID QW QX QY QZ TX TY TZ CAMERA NAME, found \"{line.strip()[:60]}\"")
        is_points = not is_points
    return poses


class Model:
    """The COLMAP model of a scene, as far as it has poses."""

    def __init__(self, scene):
        self.folder = next((folder for folder in ("sparse/0", "sparse")
                            if any(os.path.isfile(os.path.join(scene, folder, "images" + extension))
                                   for extension in (".bin", ".txt"))), None)
        if self.folder is None:
            fail(f"{scene}: no images.bin or images.txt in sparse/0 or sparse")
        path = os.path.join(scene, self.folder, "images.bin")
        self.is_binary = os.path.isfile(path)
        if self.is_binary:
            self.data = open(path, "rb").read()
            self.poses = read_binary(path, self.data)
        else:
            path = os.path.join(scene, self.folder, "images.txt")
            try:
                self.lines = open(path, encoding="utf-8").read().split("\n")
            except UnicodeDecodeError:
                fail(f"{path}: is not text")
            self.poses = read_text(path, self.lines)
        self.poses.sort(key=lambda pose: pose.name)

    def write(self, folder):
        if self.is_binary:
            data = bytearray(self.data)
            for pose in self.poses:
                struct.pack_into("<7d", data, pose.place, *pose.q, *pose.t)
            with open(os.path.join(folder, "images.bin"), "wb") as file:
                file.write(data)
            return
        lines = list(self.lines)
        for pose in self.poses:
            fields = lines[pose.place].replace(",", " ").split(maxsplit=9)
            fields[1:8] = [repr(float(value)) for value in (*pose.q, *pose.t)]
            lines[pose.place] = " ".join(fields)
        with open(os.path.join(folder, "images.txt"), "w", encoding="utf-8") as file:
            file.write("\n".join(lines))


def gain_and_tint(pixels, strength, random):
    """The photograph times exp(strength (u + t / 2)): u is its own, t that of a channel, both uniform from -1 to 1."""
    factors = np.exp(strength * (random.uniform(-1, 1) + random.uniform(-1, 1, 3) / 2))
    return np.clip(np.rint(pixels * factors), 0, 255).astype(np.uint8)


def cover(pixels, random):
    """Opaque rectangles of random colours over 10 to 15 % of the photograph, and the mask that leaves them out."""
    height, width = pixels.shape[:2]
    mask = np.full((height, width), 255, np.uint8)
    while np.mean(mask == 0) < 0.1:
        # So large that what is covered ends below 15 %.
        area = random.uniform(0.02, 0.05) * width * height
        w = int(min(width, max(1, math.sqrt(area * random.uniform(0.5, 2)))))
        h = int(min(height, max(1, area / w)))
        x, y = random.integers(0, width - w + 1), random.integers(0, height - h + 1)
        pixels[y:y + h, x:x + w] = random.integers(0, 256, 3)
        mask[y:y + h, x:x + w] = 0
    return mask


def unit_vector(random):
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)


def disturb_poses(poses, degrees, share, random):
    """Turns each camera by `degrees` and moves it by `share` of the scene extent, both in random directions."""
    centres = np.array([pose.centre() for pose in poses])
    extent = 1.1 * np.max(np.linalg.norm(centres - centres.mean(axis=0), axis=1))
    for pose in poses:
        pose.turn_and_move(unit_vector(random), math.radians(degrees), share * extent * unit_vector(random))


def save(image, path):
    """Writes an image in the format of its name; JPEG at the highest useful quality, so that little is lost."""
    try:
        if path.lower().endswith((".jpg", ".jpeg")):
            image.save(path, quality=97, subsampling=0)
        else:
            image.save(path)
    except (OSError, ValueError) as error:
        fail(f"{path}: cannot be written: {error}")


def number(low, high):
    def parse(text):
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"expected a number from {low} to {high}, found {text}")
        return value
    return parse


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", help="folder with images/ and a COLMAP model in sparse/0 or sparse")
    parser.add_argument("output", help="new folder for the copy")
    parser.add_argument("--gains", metavar="X", type=number(0, 2), default=0,
                        help="multiply each channel by exp(X (u + t / 2)), u for each photograph and t for each of its "
                             "channels uniform from -1 to 1; what exceeds white is cut off")
    parser.add_argument("--dim", metavar="X", type=number(0.01, 1), default=1,
                        help="first multiply all photographs by X, also those that are held out, so that --gains cuts "
                             "nothing off")
    parser.add_argument("--cover", action="store_true",
                        help="cover 10 to 15 %% of each photograph with rectangles, and write masks that leave them out")
    parser.add_argument("--turn", metavar="DEGREES", type=number(0, 30), default=0, help="turn each camera so far")
    parser.add_argument("--move", metavar="SHARE", type=number(0, 1), default=0,
                        help="move each camera by this share of the scene extent")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.dim == 1 and not (arguments.gains or arguments.cover or arguments.turn or arguments.move):
        fail("no fault to make; give --gains, --dim, --cover, --turn or --move")
    if arguments.seed < 0:
        fail(f"--seed: expected 0 or more, found {arguments.seed}")
    return arguments


def write_scene(arguments, model, found, training, partial):
    """Writes the disturbed scene to the folder `partial`; returns what was done, in words."""
    scene = arguments.scene
    shutil.copytree(os.path.join(scene, model.folder), os.path.join(partial, model.folder))
    if os.path.isdir(os.path.join(scene, "masks")):
        shutil.copytree(os.path.join(scene, "masks"), os.path.join(partial, "masks"))
    random = np.random.default_rng(arguments.seed)
    cut_off = []
    for pose in found:
        source, target = os.path.join(scene, "images", pose.name), os.path.join(partial, "images", pose.name)
        os.makedirs(os.path.dirname(target), exist_ok=True)
        is_disturbed = pose in training and (arguments.gains or arguments.cover)
        if not is_disturbed and arguments.dim == 1:
            shutil.copyfile(source, target)
            continue
        try:
            pixels = np.array(Image.open(source).convert("RGB"))
        except (OSError, ValueError) as error:
            fail(f"{source}: {error}")
        if arguments.dim != 1:
            pixels = np.rint(arguments.dim * pixels).astype(np.uint8)
        if is_disturbed and arguments.gains:
            was_white = np.mean(pixels == 255)
            pixels = gain_and_tint(pixels, arguments.gains, random)
            cut_off.append(max(0.0, np.mean(pixels == 255) - was_white))
        if is_disturbed and arguments.cover:
            mask = os.path.join(partial, "masks", pose.name + ".png")
            os.makedirs(os.path.dirname(mask), exist_ok=True)
            save(Image.fromarray(cover(pixels, random)), mask)
        save(Image.fromarray(pixels), target)
    if arguments.turn or arguments.move:
        disturb_poses(training, arguments.turn, arguments.move, random)
        model.write(os.path.join(partial, model.folder))
    text = f"{len(training)} training photographs, {len(found) - len(training)} held out"
    if cut_off:
        text += f"; {100 * np.mean(cut_off):.1f} % of the training values cut off at white"
    return text


def main():
    arguments = parse_arguments()
    scene, output = arguments.scene, arguments.output
    if not os.path.isdir(os.path.join(scene, "images")):
        fail(f"{scene}: has no folder images")
    if os.path.exists(os.path.join(scene, "masks")) and arguments.cover:
        fail(f"{scene}: has masks already; --cover would need to join them")
    if os.path.exists(output):
        fail(f"{output}: exists; name a new folder")
    model = Model(scene)
    found = [pose for pose in model.poses if os.path.isfile(os.path.join(scene, "images", pose.name))]
    training = [pose for i, pose in enumerate(found) if i % HOLD_OUT_EVERY != 0]
    if not training:
        fail(f"{scene}: expected at least 2 photographs of the model in images/, found {len(found)}")

    # Written beside the output and renamed at the end, so that an output is always complete.
    output = os.path.abspath(output)
    os.makedirs(os.path.dirname(output), exist_ok=True)
    partial = tempfile.mkdtemp(prefix=os.path.basename(output) + ".", dir=os.path.dirname(output))
    try:
        text = write_scene(arguments, model, found, training, partial)
        os.chmod(partial, 0o755)
        os.rename(partial, output)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    print(f"{arguments.output}: {text}")


if __name__ == "__main__":
    main()
