// A camera path through keyframes, for playback and as a file for `b3dgs render --cameras`.
class CameraPath {
  constructor() { this.keys = []; }

  add(camera) {
    this.keys.push({position: camera.position, quaternion: quaternion(camera.axes), fov: camera.fov});
  }

  drop() { this.keys.pop(); }

  /// Returns the camera at keyframe number `t`. It is smooth between keyframes: Catmull-Rom positions, slerped
  /// rotations.
  at(t) {
    const last = this.keys.length - 1;
    const i = Math.min(Math.max(0, Math.floor(t)), Math.max(0, last - 1)), u = Math.min(1, t - i);
    const key = (k) => this.keys[Math.min(last, Math.max(0, k))];
    const [a, b, c, d] = [key(i - 1), key(i), key(i + 1), key(i + 2)].map((k) => k.position);
    const position = [0, 1, 2].map((k) => 0.5 * (2 * b[k] + (c[k] - a[k]) * u +
        (2 * a[k] - 5 * b[k] + 4 * c[k] - d[k]) * u * u + (3 * b[k] - a[k] - 3 * c[k] + d[k]) * u * u * u));
    const turn = slerp(key(i).quaternion, key(i + 1).quaternion, u);
    return {position, axes: straightened(rotation(turn)), fov: key(i).fov + (key(i + 1).fov - key(i).fov) * u};
  }

  seconds(between) { return Math.max(0, this.keys.length - 1) * between; }

  /// Returns the path in the format of nerfstudio's camera paths, in world coordinates: origin + unit * page
  /// coordinates.
  file(between, width, height, fps, origin, unit) {
    const seconds = this.seconds(between), n = Math.max(1, Math.round(seconds * fps) + 1);
    const frames = [];
    for (let i = 0; i < n; ++i) {
      const camera = Object.assign(new PageCamera(), this.at(n > 1 ? i / (n - 1) * (this.keys.length - 1) : 0));
      camera.position = add(origin, mul(camera.position, unit));
      frames.push({camera_to_world: camera.matrix(), fov: camera.fov, aspect: width / height});
    }
    return {camera_type: "perspective", render_width: width, render_height: height, fps, seconds: n / fps,
            camera_path: frames};
  }
}
