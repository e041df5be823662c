// The camera that the page moves: position, axes, field of view, and the pivot that it orbits.
class PageCamera {
  constructor() {
    this.position = [0, 0, 0];
    this.axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    this.fov = 50;  // vertical, degrees
    this.distance = 1;  // to the pivot in front of the camera
    this.up = [0, -1, 0];  // of the world
    this.center = [0, 0, 0];
    this.radius = 1;
  }

  /// Sets the initial camera for a scene: its first camera or, without cameras, a view of its centre.
  begin(scene) {
    this.center = scene.center;
    this.radius = scene.radius;
    if (scene.up) this.up = scene.up;
    const cameras = scene.views.map((view) => PageCamera.parse(view));
    if (cameras.length === 0) {
      this.position = add(scene.center, mul(unit([0.6, -0.5, -1]), 3 * scene.radius));
      this.axes = looking(this.position, scene.center, this.up);
      this.fov = 50;
      this.distance = 3 * scene.radius;
      return;
    }
    this.center = PageCamera.meeting_point(cameras) || scene.center;
    this.jump(scene.views[0]);
  }

  static parse(view) {
    const m = view.camera_to_world;
    const column = (c) => [m[c], m[4 + c], m[8 + c]];
    return {position: column(3), axes: [column(0), column(1), column(2)], fov: view.fov};
  }

  /// Returns the point nearest to all optical axes; null if these are parallel.
  static meeting_point(cameras) {
    const a = [[0, 0, 0], [0, 0, 0], [0, 0, 0]], b = [0, 0, 0];
    for (const {position, axes} of cameras) {
      const d = axes[2];
      for (let i = 0; i < 3; ++i) {
        for (let j = 0; j < 3; ++j) {
          const p = (i === j ? 1 : 0) - d[i] * d[j];
          a[i][j] += p;
          b[i] += p * position[j];
        }
      }
    }
    const det = (c) => dot(c[0], cross(c[1], c[2]));
    const whole = det(a);
    if (!(Math.abs(whole) > 1e-4 * cameras.length ** 3)) return null;
    return [0, 1, 2].map((k) => det(a.map((row, i) => row.map((x, j) => (j === k ? b[i] : x)))) / whole);
  }

  jump(view) {
    Object.assign(this, PageCamera.parse(view));
    const ahead = dot(sub(this.center, this.position), mul(this.axes[2], -1));
    this.distance = ahead > 0 ? ahead : this.radius;
  }

  pivot() { return sub(this.position, mul(this.axes[2], this.distance)); }

  /// Rotates so that the picture follows a drag by these angles (rad), to the right and down. Orbit turns about the
  /// pivot, fly about the camera.
  turn(right, down, way) {
    const pivot = this.pivot();
    const sign = way === "orbit" ? -1 : 1;
    const axis = dot(this.axes[1], this.up) < 0 ? mul(this.up, -1) : this.up;
    let axes = this.axes.map((v) => turned(v, axis, sign * right));
    const tilt = sign * down;
    const tilted = axes.map((v) => turned(v, axes[0], tilt));
    const steep = Math.abs(dot(tilted[2], this.up));  // not across the poles, where up would flip
    if (steep < 0.995 || steep < Math.abs(dot(axes[2], this.up))) axes = tilted;
    this.axes = straightened(axes);
    if (way === "orbit") this.position = add(pivot, mul(this.axes[2], this.distance));
  }

  /// Moves by world units along the camera's axes.
  move(right, up, forward) {
    const farthest = Math.max(100 * this.radius, norm(sub(this.position, this.center)));
    this.position = add(this.position, add(add(mul(this.axes[0], right), mul(this.axes[1], up)),
                                           mul(this.axes[2], -forward)));
    const away = sub(this.position, this.center);
    if (norm(away) > farthest) this.position = add(this.center, mul(unit(away), farthest));
  }

  /// Approaches the pivot by a factor below 1. In fly mode, moves forward instead.
  approach(factor, way) {
    if (way === "fly") return this.move(0, 0, (1 - factor) * this.distance);
    const pivot = this.pivot();
    const farthest = Math.max(100 * this.radius, this.distance);
    this.distance = Math.min(farthest, Math.max(1e-4 * this.radius, this.distance * factor));
    this.position = add(pivot, mul(this.axes[2], this.distance));
  }

  matrix() {
    const [r, u, b] = this.axes, p = this.position;
    return [r[0], u[0], b[0], p[0], r[1], u[1], b[1], p[1], r[2], u[2], b[2], p[2], 0, 0, 0, 1];
  }
}
