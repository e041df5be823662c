// Controls that move the camera and choose the display: the panel, mouse, touch and keys on the picture, and playback
// of a path. The page's state is in page.js.

// --- The panel

function choose(group, key, value) {
  for (const button of $(group).children) button.setAttribute("aria-pressed", button.dataset[key] === value);
}

/// Marks the mode of the picture and, while its picture is awaited, the one that was chosen.
function show_modes() {
  choose("modes", "mode", shown_mode);
  for (const button of $("modes").children) {
    button.setAttribute("aria-busy", mode !== shown_mode && button.dataset.mode === mode && !state?.ended);
  }
}

function has_photograph() { return view >= 0 && scene.views[view].photograph; }

function select_mode(name) {
  mode = name;
  show_modes();
  renew();
}

function select_view(index) {
  view = index;
  $("camera").value = String(index);
  for (const button of $("modes").children) {
    const needs_one = ["photograph", "difference"].includes(button.dataset.mode);
    button.disabled = needs_one && !has_photograph();
    button.title = button.disabled ? "needs a camera of the scene: choose one below" : "";
  }
  if (["photograph", "difference"].includes(mode) && !has_photograph()) select_mode("render");
  renew();
}

function jump(index) {
  const n = scene.views.length;
  if (n === 0) return;
  const to = (index + n) % n;
  play(false);
  camera.jump(scene.views[to]);
  show_fov();
  select_view(to);
}

/// Restores the initial view of the page.
function reset_view() {
  play(false);
  camera.begin(scene);
  show_fov();
  select_view(scene.views.length > 0 ? 0 : -1);
}

function show_fov() {
  $("fov").value = String(camera.fov);
  $("fov_value").textContent = `${camera.fov.toFixed(0)}\u00b0`;
}

function key_seconds() {
  const seconds = $("key_seconds").valueAsNumber;
  return Number.isNaN(seconds) ? 2 : Math.min(60, Math.max(0.1, seconds));
}

/// Starts or stops playback of the path.
function play(is_on) {
  playing = is_on ? {start: performance.now(), between: key_seconds()} : null;
  $("path_play").textContent = is_on ? "Stop" : "Play";
}

function show_keys() {
  const n = path.keys.length, seconds = path.seconds(key_seconds());
  play(false);
  $("keys").textContent = n < 2 ? `${n}` : `${n}, ${seconds.toFixed(1)} s`;
  $("key_drop").disabled = n === 0;
  $("path_play").disabled = n < 2;
  $("path_save").disabled = n === 0;
}

function listen_to_panel() {
  for (const button of $("modes").children) button.onclick = () => select_mode(button.dataset.mode);
  for (const button of $("ways").children) {
    button.onclick = () => {
      way = button.dataset.way;
      choose("ways", "way", way);
    };
  }
  $("camera").onchange = () => {
    const index = Number($("camera").value);
    if (index >= 0) jump(index);
    else select_view(-1);
  };
  $("reset").onclick = reset_view;
  $("before").onclick = () => jump(view >= 0 ? view - 1 : 0);
  $("after").onclick = () => jump(view + 1);
  $("fov").oninput = () => {
    camera.fov = Number($("fov").value);
    show_fov();
    touch();
  };
  $("pause").onclick = () => command(state && state.paused ? "resume" : "pause");
  $("save").onclick = () => command("save");
  $("stop").onclick = () => {
    if (confirm("Stop the training? It writes a checkpoint that it can be resumed from.")) command("stop");
  };
  $("fold").onclick = () => {
    const is_folded = $("panel").classList.toggle("folded");
    $("fold").setAttribute("aria-expanded", String(!is_folded));
  };
  $("key_add").onclick = () => { path.add(camera); show_keys(); };
  $("key_drop").onclick = () => { path.drop(); show_keys(); };
  $("key_seconds").oninput = show_keys;
  $("true_distance").oninput = () => { if (picks.length > 0) show_picks(); };
  $("path_play").onclick = () => play(!playing);
  $("path_save").onclick = save_path;
}

function save_path() {
  const [width, height] = $("path_size").value.split("x").map(Number);
  const file = path.file(key_seconds(), width, height, 30, scene.origin, scene.unit);
  download("camera_path.json", JSON.stringify(file, null, 1), "application/json");
}

function download(name, text, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], {type}));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// --- Mouse, touch, keys

function listen_to_picture() {
  const pointers = new Map();
  let pressed = null;
  const middle = () => {
    const all = [...pointers.values()];
    const x = all.reduce((s, p) => s + p.x, 0) / all.length, y = all.reduce((s, p) => s + p.y, 0) / all.length;
    return {x, y, spread: all.length > 1 ? Math.hypot(all[0].x - all[1].x, all[0].y - all[1].y) : 0};
  };
  const shift = (dx, dy) => {
    const unit_px = 2 * camera.distance * Math.tan(camera.fov * Math.PI / 360) / picture.clientHeight;
    camera.move(-dx * unit_px, dy * unit_px, 0);
  };
  picture.addEventListener("pointerdown", (event) => {
    picture.setPointerCapture(event.pointerId);
    picture.focus({preventScroll: true});
    picture.classList.add("held");
    pointers.set(event.pointerId, {x: event.clientX, y: event.clientY, button: event.button});
    pressed = pointers.size === 1 && event.button === 0 ? event : null;
    play(false);
  });
  const release = (event) => {
    const is_click = pressed && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 4;
    if (is_click && event.type === "pointerup") pick_at(event);
    pressed = null;
    pointers.delete(event.pointerId);
    if (pointers.size === 0) picture.classList.remove("held");
  };
  picture.addEventListener("pointerup", release);
  picture.addEventListener("pointercancel", release);
  picture.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return;
    const before = middle();
    pointer.x = event.clientX;
    pointer.y = event.clientY;
    const now = middle(), dx = now.x - before.x, dy = now.y - before.y;
    if (pointers.size > 1) {
      shift(dx, dy);
      if (before.spread > 0 && now.spread > 0) camera.approach(before.spread / now.spread, way);
    } else if (pointer.button === 2 || pointer.button === 1 || event.shiftKey) {
      shift(dx, dy);
    } else {
      const angle = Math.PI / Math.max(300, picture.clientHeight) * (way === "fly" ? 0.5 : 1);
      camera.turn(dx * angle, dy * angle, way);
    }
    touch();
  });
  picture.addEventListener("contextmenu", (event) => event.preventDefault());
  picture.addEventListener("wheel", (event) => {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : 1);
    camera.approach(Math.exp(Math.max(-200, Math.min(200, pixels)) * 0.0015), way);
    touch();
  }, {passive: false});
}

const kMoves = {w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], q: [0, -1, 0], e: [0, 1, 0]};
const kTurns = {arrowleft: [1, 0], arrowright: [-1, 0], arrowup: [0, 1], arrowdown: [0, -1]};  // as if dragged

function listen_to_keys() {
  window.addEventListener("keydown", (event) => {
    const key = event.key.toLowerCase(), is_own = ["INPUT", "SELECT"].includes(event.target.tagName);
    if (event.ctrlKey || event.metaKey || event.altKey || is_own || state?.ended) return;
    if (key === "escape") play(false);
    if (kMoves[key] || kTurns[key]) {
      held_keys.add(key);
      play(false);
      event.preventDefault();
    }
    if (key === "]") jump(view + 1);
    if (key === "[") jump(view >= 0 ? view - 1 : 0);
  });
  window.addEventListener("keyup", (event) => held_keys.delete(event.key.toLowerCase()));
  window.addEventListener("blur", () => held_keys.clear());
}

/// Continues movements: pressed keys, and playback of a path.
function move_on(now, before) {
  const seconds = Math.min(0.1, (now - before) / 1000);
  for (const key of held_keys) {
    const move = kMoves[key], step = 0.6 * Math.max(camera.distance, 0.05 * camera.radius) * seconds;
    if (move) camera.move(...move.map((x) => x * step));
    if (kTurns[key]) camera.turn(1.2 * kTurns[key][0] * seconds, 1.2 * kTurns[key][1] * seconds, way);
    touch();
  }
  if (playing) {
    const t = (now - playing.start) / 1000 / playing.between;
    Object.assign(camera, path.at(Math.min(t, path.keys.length - 1)));
    if (t >= path.keys.length - 1) play(false);
    show_fov();
    touch();
  }
  requestAnimationFrame((next) => move_on(next, now));
}
