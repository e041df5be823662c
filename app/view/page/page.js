// The page's state; asks for frames and progress. One frame is asked for at a time: a draft while the camera moves, and
// one of the window's size once it rests. A training reduces frames to the time that it has for them, and says when to
// ask for a larger or newer one.
const token = new URLSearchParams(location.search).get("token") || "";
const client = Array.from(crypto.getRandomValues(new Uint8Array(8)), (x) => x.toString(16).padStart(2, "0")).join("");
const $ = (id) => document.getElementById(id);
const picture = $("picture");
const kMaxPixels = 4000000;
const kDraftMs = 80;  // what a draft should take, by its size; a training that is not paused chooses the size itself

const camera = new PageCamera(), path = new CameraPath();
let scene = null, state = null;
let trouble = "";  // with the connection
let mode = "render", shown_mode = "", way = "orbit";
let view = -1;  // the camera of the scene that is shown exactly; -1 once moved
let moved_at = -1e9;  // ms
let draft_scale = 0.5;
let wanted = true;  // a frame newer than the one shown
let shown_full = false, shown_iteration = -1;
let next_at = 0;  // ms; a frame that shows nothing new is not asked for earlier
let image = null;  // the bitmap that is shown
let legend = "";   // what its colours mean
let curve = [];
let playing = null;
const held_keys = new Set();

async function ask(address, options = {}) {
  const limit_ms = /frame|photograph/.test(address) ? 30000 : 5000;  // a picture may wait for 20 s before it is begun
  const response = await fetch(address, {
    ...options, signal: AbortSignal.timeout(limit_ms),
    headers: {"X-Token": token, "X-Client": client, ...(options.headers || {})}}).catch(() => {
    throw new Error("No connection: the program has ended or does not answer.");
  });
  if (response.ok) return response;
  const error = new Error((await response.text()).trim());
  error.status = response.status;
  throw error;
}

function post(address, body) {
  return ask(address, {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(body)});
}

/// Sets a text if it has changed, because screen readers read every new text aloud.
function show_text(id, text) {
  if ($(id).textContent !== text) $(id).textContent = text;
}

const say = (text) => show_text("message", text);
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// --- Frames: one at a time, small ones while the camera moves.

function is_moving() {
  return performance.now() - moved_at < 250 || playing !== null || held_keys.size > 0;
}

/// The picture is not the one that is wanted: asks for another one at once.
function renew() {
  wanted = true;
  shown_full = false;
}

function touch() {
  moved_at = performance.now();
  wanted = true;
  if (view >= 0) select_view(-1);
}

function frame_size(scale) {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  let width = picture.clientWidth * ratio * scale, height = picture.clientHeight * ratio * scale;
  const shrink = Math.min(1, Math.sqrt(kMaxPixels / (width * height)));
  return [Math.max(16, Math.floor(width * shrink)), Math.max(16, Math.floor(height * shrink))];
}

const is_training = () => scene.training && state !== null && !state.paused;

async function fetch_picture(is_draft, asked_pick) {
  const [width, height] = frame_size(is_draft && !is_training() ? draft_scale : 1);
  if (mode === "photograph") {
    return [await ask(`/photograph?view=${view}&width=${width}&height=${height}`), null];
  }
  const request = {width, height, mode, quality: is_draft ? 70 : 90, draft: is_draft};
  if (view >= 0) request.view = view;
  else request.camera = {camera_to_world: camera.matrix(), fov: camera.fov};
  if (asked_pick) request.pick = asked_pick;
  const response = await post("/frame", request);
  return [response, JSON.parse(response.headers.get("X-Frame"))];
}

async function frames() {
  for (;;) {
    const is_draft = is_moving(), asked_at = performance.now(), asked_mode = mode;
    const is_new = state !== null && state.iteration !== shown_iteration && mode !== "photograph";
    const has_work = wanted || (!is_draft && asked_at >= next_at && (!shown_full || is_new));
    if (state?.ended) return;
    if (!has_work || document.hidden || trouble) {
      await sleep(15);
      continue;
    }
    wanted = false;
    const asked_pick = pick;
    try {
      const [response, about] = await fetch_picture(is_draft, asked_pick);
      const bitmap = await createImageBitmap(await response.blob());
      if (image) image.close();
      image = bitmap;
      shown_mode = asked_mode;
      shown_full = !is_draft;
      next_at = 0;
      draw();
      show_modes();
      if (about) {
        const now = performance.now();
        next_at = now + about.wait_ms;
        if (is_draft && !is_training()) {
          const scale = draft_scale * Math.sqrt(kDraftMs / Math.max(1, now - asked_at));
          draft_scale = Math.min(1, Math.max(0.12, scale));
        }
        shown_iteration = about.iteration;
        $("frame").textContent = `${bitmap.width} x ${bitmap.height}, ${about.ms.toFixed(1)} ms` +
            (state && state.iterations > 0 && scene.training ? `, iteration ${about.iteration}` : "");
      }
      if (about && asked_pick) {
        if (pick === asked_pick) pick = null;
        add_pick(about.point);
      }
      legend = about ? about.legend : "";
      show_legend();
      say("");
    } catch (error) {
      wanted = true;
      if (!state?.ended) say(error.message);
      await sleep(500);
    }
  }
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(picture.clientWidth * ratio), height = Math.round(picture.clientHeight * ratio);
  if (picture.width !== width || picture.height !== height) {
    picture.width = width;
    picture.height = height;
  }
  const context = picture.getContext("2d");
  context.fillStyle = "#0e0f10";
  context.fillRect(0, 0, width, height);
  if (!image) return;
  const scale = Math.min(width / image.width, height / image.height);
  const w = image.width * scale, h = image.height * scale;
  context.imageSmoothingEnabled = shown_mode !== "load";
  context.drawImage(image, (width - w) / 2, (height - h) / 2, w, h);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  crop.draw(context);
  context.setTransform(1, 0, 0, 1, 0, 0);
}

function show_legend() {
  const is_last = state?.ended && image && shown_mode !== "photograph";
  const last = is_last ? `last picture, iteration ${count_text(shown_iteration)}` : "";
  show_text("legend", [last, legend].filter(Boolean).join("; "));
}

// --- Progress

function duration(seconds) {
  const s = Math.round(seconds), two = (n) => String(n).padStart(2, "0");
  return s >= 3600 ? `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`
                   : `${Math.floor(s / 60)}:${two(s % 60)}`;
}

async function follow() {
  for (;;) {
    if (!document.hidden) {
      try {
        const since = curve.length > 0 ? curve[curve.length - 1][0] : 0;
        state = await (await ask(`/state?since=${since}`)).json();
        curve = curve.concat(state.curve);
        if (trouble) say("");
        trouble = "";
      } catch (error) {
        const is_other = error.status === 401;  // the token belongs to another program
        trouble = error.status && !is_other ? "waiting" : "no connection";
        say(error.message);
        if (is_other) return show_state();
      }
      show_state();
      if (state?.ended) return end();
    }
    await sleep(1000);
  }
}

/// The last picture stays, marked as the last. Turns off what would change it.
function end() {
  say("");
  show_modes();
  show_legend();
  play(false);
  held_keys.clear();
  picture.style.pointerEvents = "none";
  for (const own of document.querySelectorAll("#panel :is(button, select, input):not(#fold, #path_save, #path_size, #crop_save)")) {
    own.disabled = true;
  }
}

function show_state() {
  if (!state) return;
  const is_live = !trouble && !state.ended;  // otherwise, the last values stay
  $("iteration").textContent = scene.training ? `${count_text(state.iteration)} / ${count_text(state.iterations)}`
                                              : state.iteration > 0 ? count_text(state.iteration) : "-";
  $("count").textContent = count_text(state.count);
  $("loss").textContent = state.loss > 0 ? state.loss.toFixed(4) : "-";
  $("eta").textContent = state.eta_s === null || state.ended ? "-" : duration(state.eta_s);
  $("activity").textContent = trouble || state.activity +
      (state.activity === "training" && state.per_second > 0 ? `, ${state.per_second.toFixed(1)}/s` : "");
  $("kernel").textContent = state.kernel || "-";
  $("done").style.width = `${100 * state.iteration / Math.max(1, state.iterations)}%`;
  if (state.paused !== ($("pause").textContent === "Resume")) renew();  // a pause has time for a larger one
  $("pause").textContent = state.paused ? "Resume" : "Pause";
  for (const id of ["pause", "save", "stop"]) $(id).disabled = !is_live;
  show_text("notice", state.notice);
  $("notice").classList.toggle("warning", state.warning);
  if (scene.training) show_curves();
}

function show_curves() {
  const chart = (name, title, points, format) => {
    $(`${name}_now`).textContent = points.length > 0 ? format(points[points.length - 1][1]) : "no values yet";
    if (points.length < 2) return;
    Charts.show($(`${name}_curve`), "lines",
                {title, small: true, height: 64, format, series: [{name: title, color: 0, points}]});
  };
  chart("loss", "loss", curve.map(([i, loss]) => [i, loss]), (x) => x.toFixed(4));
  chart("count", "Gaussians", curve.map(([i, , n]) => [i, n]), count_text);
  $("psnr_curve").parentElement.hidden = state.psnr.length === 0;
  chart("psnr", "PSNR", state.psnr, (x) => `${x.toFixed(2)} dB`);
}

async function command(name) {
  try {
    await post("/command", {command: name});
    say("");
  } catch (error) {
    say(error.message);
  }
}

/// A server that is busy, or has too many pages open, may answer later.
async function load_scene() {
  for (;;) {
    try {
      return await (await ask("/cameras")).json();
    } catch (error) {
      if (error.status !== 503) throw error;
      say(error.message);
      await sleep(1000);
    }
  }
}

async function begin() {
  scene = await load_scene();
  say("");
  document.title = `${scene.title} - b3dgs`;
  $("title").textContent = scene.title;
  document.body.classList.toggle("rest", !scene.training);
  $("camera").add(new Option(scene.views.length > 0 ? "free camera" : "no cameras", "-1"));
  scene.views.forEach((v, i) => $("camera").add(new Option(`${v.name}${v.test ? " (test)" : ""}`, String(i))));
  $("cameras").hidden = scene.views.length === 0;
  listen_to_panel();
  listen_to_crop();  // before those of the picture, so that a handle is not also the camera
  listen_to_picture();
  listen_to_keys();
  choose("ways", "way", way);
  select_mode("render");
  reset_view();
  show_keys();
  new ResizeObserver(() => { draw(); renew(); show_state(); }).observe(picture);
  requestAnimationFrame((now) => move_on(now, now));
  follow();
  frames();
}

begin().catch((error) => say(error.message || String(error)));
