// Vectors are arrays of 3. Rotations are three column vectors [right, up, back] (OpenGL's camera axes in the world).
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const mul = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const unit = (a) => mul(a, 1 / (norm(a) || 1));

/// Rotates v about a unit axis by an angle (rad).
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(mul(v, c), mul(cross(axis, v), s)), mul(axis, dot(axis, v) * (1 - c)));
}

/// Returns orthonormal axes with the same back axis, to remove accumulated rounding errors.
function straightened(axes) {
  const back = unit(axes[2]), right = unit(cross(axes[1], back));
  return [right, cross(back, right), back];
}

/// Returns the rotation of a camera at `from` that looks at `to`.
function looking(from, to, up) {
  const back = unit(sub(from, to));
  let right = cross(up, back);
  if (norm(right) < 1e-6) right = cross([0, 0, 1], back);
  if (norm(right) < 1e-6) right = cross([0, 1, 0], back);
  right = unit(right);
  return [right, cross(back, right), back];
}

/// Converts a rotation to a unit quaternion [w, x, y, z], and back.
function quaternion(axes) {
  const m = (r, c) => axes[c][r], t = m(0, 0) + m(1, 1) + m(2, 2);
  let q;
  if (t > 0) {
    q = [1 + t, m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1)];
  } else if (m(0, 0) > m(1, 1) && m(0, 0) > m(2, 2)) {
    q = [m(2, 1) - m(1, 2), 1 + m(0, 0) - m(1, 1) - m(2, 2), m(0, 1) + m(1, 0), m(0, 2) + m(2, 0)];
  } else if (m(1, 1) > m(2, 2)) {
    q = [m(0, 2) - m(2, 0), m(0, 1) + m(1, 0), 1 + m(1, 1) - m(0, 0) - m(2, 2), m(1, 2) + m(2, 1)];
  } else {
    q = [m(1, 0) - m(0, 1), m(0, 2) + m(2, 0), m(1, 2) + m(2, 1), 1 + m(2, 2) - m(0, 0) - m(1, 1)];
  }
  const length = Math.hypot(...q);
  return q.map((x) => x / length);
}

function rotation([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/// Interpolates two rotations given as quaternions spherically, the shorter way.
function slerp(a, b, t) {
  let d = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  const to = d < 0 ? b.map((x) => -x) : b;
  d = Math.min(1, Math.abs(d));
  const angle = Math.acos(d);
  if (angle < 1e-6) return a;
  const s = Math.sin(angle), u = Math.sin((1 - t) * angle) / s, v = Math.sin(t * angle) / s;
  return a.map((x, i) => u * x + v * to[i]);
}
