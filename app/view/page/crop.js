// The region of --crop: a box or a sphere over the picture with handles to drag, as an option, and as a file.
const kCropColor = "#ffb020", kHandlePx = 6, kGrabPx = 14;

const crop = {
  kind: "none", center: [0, 0, 0], half: [1, 1, 1],  // page coordinates; all of `half` are the radius of a sphere
  held: null,  // {handle, x, y} while a handle is dragged

  /// Returns the handles: 0 moves the region, and 1 to 6 move its sides.
  handles() {
    const sides = [0, 1, 2].flatMap((k) => [-1, 1].map((sign) => ({
      axis: k, sign, at: this.center.map((x, i) => x + (i === k ? sign * this.half[k] : 0))})));
    return [{axis: -1, sign: 0, at: this.center}, ...sides];
  },

  move(handle, dx, dy) {
    const {axis, sign, at} = this.handles()[handle], lens = picture_lens(), depth = depth_of(at);
    if (axis < 0) {
      const right = mul(camera.axes[0], dx * depth / lens.focal), up = mul(camera.axes[1], -dy * depth / lens.focal);
      this.center = add(this.center, add(right, up));
      return;
    }
    const step = 0.01 * this.half[axis], a = on_screen(at, lens);
    const b = on_screen(at.map((x, i) => x + (i === axis ? step : 0)), lens);
    if (!a || !b) return;
    const gx = (b[0] - a[0]) / step, gy = (b[1] - a[1]) / step;  // px per unit along the axis
    const least = 0.1 * lens.focal / depth;  // an axis that points at the camera
    const amount = sign * (dx * gx + dy * gy) / Math.max(least * least, gx * gx + gy * gy);
    if (this.kind === "sphere") {
      this.half = this.half.map((r) => Math.max(0.02 * r, r + amount));
    } else {
      const before = this.half[axis], after = Math.max(0.02 * before, before + amount / 2);
      this.half = this.half.map((h, i) => (i === axis ? after : h));
      this.center = this.center.map((c, i) => (i === axis ? c + sign * (after - before) : c));
    }
  },

  /// Returns the numbers of --crop, in world units.
  text() {
    if (this.kind === "none") return "";
    const size = Math.min(...this.half) * scene.unit;
    const digits = Math.min(12, Math.max(0, Math.ceil(3 - Math.log10(size))));
    const world = (at) => add(scene.origin, mul(at, scene.unit));
    const numbers = this.kind === "sphere" ? [...world(this.center), size]
        : [...world(sub(this.center, this.half)), ...world(add(this.center, this.half))];
    return numbers.map((x) => x.toFixed(digits)).join(",");
  },

  /// Sets the region from such numbers. Returns whether they are a region.
  parse(text) {
    const n = text.replace(/^--crop[= ]/, "").split(/[\s,]+/).filter(Boolean).map(Number);
    const page = (at) => mul(sub(at, scene.origin), 1 / scene.unit);
    if (!n.every(Number.isFinite)) return false;
    if (n.length === 4 && n[3] > 0) {
      Object.assign(this, {kind: "sphere", center: page(n.slice(0, 3)), half: Array(3).fill(n[3] / scene.unit)});
      return true;
    }
    const a = page(n.slice(0, 3)), b = page(n.slice(3)), half = a.map((x, i) => Math.abs(b[i] - x) / 2);
    if (n.length !== 6 || !half.every((x) => x > 0)) return false;
    Object.assign(this, {kind: "box", center: mul(add(a, b), 0.5), half});
    return true;
  },

  /// Draws the region. The context is in CSS pixels.
  draw(context) {
    if (this.kind === "none" || mode === "photograph") return;
    const lens = picture_lens();
    context.strokeStyle = context.fillStyle = kCropColor;
    context.beginPath();
    for (const points of this.lines()) {
      points.forEach((to, i) => { if (i > 0) draw_line(context, points[i - 1], to, lens); });
    }
    context.stroke();
    for (const {at} of this.handles()) {
      const xy = on_screen(at, lens);
      if (!xy) continue;
      context.beginPath();
      context.arc(xy[0], xy[1], kHandlePx, 0, 2 * Math.PI);
      context.fill();
    }
  },

  /// Returns the edges of the box, or three circles.
  lines() {
    const at = (u) => u.map((x, i) => this.center[i] + x * this.half[i]);
    const others = (k) => [(k + 1) % 3, (k + 2) % 3];
    const point = (k, own, a, b) => {
      const u = [0, 0, 0], [i, j] = others(k);
      [u[k], u[i], u[j]] = [own, a, b];
      return at(u);
    };
    if (this.kind === "box") {
      return [0, 1, 2].flatMap((k) => [-1, 1].flatMap((a) => [-1, 1].map((b) => [point(k, -1, a, b), point(k, 1, a, b)])));
    }
    const angles = Array.from({length: 49}, (_, i) => i * Math.PI / 24);
    return [0, 1, 2].map((k) => angles.map((t) => point(k, 0, Math.cos(t), Math.sin(t))));
  },
};

const depth_of = (at) => dot(sub(camera.position, at), camera.axes[2]);

/// Returns the middle of the picture and the focal length of the camera that shows it, CSS px.
function picture_lens() {
  const width = picture.clientWidth, height = picture.clientHeight;
  const shown = image ? image.height * Math.min(width / image.width, height / image.height) : height;
  return {x: width / 2, y: height / 2, focal: shown / 2 / Math.tan(camera.fov * Math.PI / 360)};
}

/// Returns the position in the picture, or null for a point behind the camera.
function on_screen(at, {x, y, focal}) {
  const d = sub(at, camera.position), depth = depth_of(at);
  if (depth <= 1e-3 * camera.distance) return null;
  return [x + focal * dot(d, camera.axes[0]) / depth, y - focal * dot(d, camera.axes[1]) / depth];
}

/// Draws the part of a line that is in front of the camera.
function draw_line(context, from, to, lens) {
  const near = 2e-3 * camera.distance, a = depth_of(from), b = depth_of(to);
  if (a <= near && b <= near) return;
  const cut = (near - a) / (b - a), middle = add(from, mul(sub(to, from), cut));
  context.moveTo(...on_screen(a <= near ? middle : from, lens));
  context.lineTo(...on_screen(b <= near ? middle : to, lens));
}

function show_crop() {
  choose("crops", "crop", crop.kind);
  $("crop_text").value = crop.kind === "none" ? "" : `--crop=${crop.text()}`;
  $("crop_save").disabled = crop.kind === "none";
  draw();
}

function listen_to_crop() {
  for (const button of $("crops").children) {
    button.onclick = () => {
      if (crop.kind === "none") {
        Object.assign(crop, {center: camera.pivot(), half: Array(3).fill(0.3 * camera.distance)});
      }
      crop.kind = button.dataset.crop;
      if (crop.kind === "sphere") crop.half = crop.half.map(() => Math.max(...crop.half));
      show_crop();
    };
  }
  $("crop_text").onchange = () => {
    say(crop.parse($("crop_text").value) ? "" : "expected x0,y0,z0,x1,y1,z1 or x,y,z,radius");
    show_crop();
  };
  $("crop_text").onfocus = () => $("crop_text").select();
  $("crop_save").onclick = () => {
    download("crop.txt", `# A region for b3dgs: --crop crop.txt\n${crop.text()}\n`, "text/plain");
  };
  picture.addEventListener("pointerdown", (event) => {
    if (crop.kind === "none" || mode === "photograph" || event.button !== 0) return;
    const lens = picture_lens(), away = crop.handles().map(({at}) => {
      const xy = on_screen(at, lens);
      return xy ? Math.hypot(xy[0] - event.offsetX, xy[1] - event.offsetY) : Infinity;
    });
    const nearest = Math.min(...away);
    if (nearest > kGrabPx) return;
    crop.held = {handle: away.indexOf(nearest), x: event.clientX, y: event.clientY};
    picture.setPointerCapture(event.pointerId);
    event.stopImmediatePropagation();
  });
  picture.addEventListener("pointermove", (event) => {
    if (!crop.held) return;
    crop.move(crop.held.handle, event.clientX - crop.held.x, event.clientY - crop.held.y);
    Object.assign(crop.held, {x: event.clientX, y: event.clientY});
    event.stopImmediatePropagation();
    show_crop();
  });
  for (const end of ["pointerup", "pointercancel"]) picture.addEventListener(end, () => { crop.held = null; });
  show_crop();
}
