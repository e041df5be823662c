// Uses the live view like a person. Started by check_view.sh. Arguments: the program, a folder for pictures.
const assert = require("node:assert");
const {execFileSync, spawn} = require("node:child_process");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const {chromium} = require("playwright-core");

const [program, pictures] = process.argv.slice(2);
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "b3dgs-check-view-"));
const kPatience = {timeout: 60000};
const errors = [];

/// Starts a command and waits for the address that it prints.
async function start(words) {
  const child = spawn(program, words, {stdio: ["ignore", "pipe", "pipe"]});
  child.text = "";
  const ended = new Promise((resolve) => child.on("exit", (code, signal) => resolve(signal || code)));
  const url = await new Promise((resolve, reject) => {
    const read = (data) => {
      child.text += data;
      const found = child.text.match(/http:\/\/\S+/);
      if (found) resolve(found[0]);
    };
    child.stdout.on("data", read);
    child.stderr.on("data", (data) => { child.text += data; });
    ended.then(() => reject(new Error(`${words.join(" ")} ended: ${child.text}`)));
  });
  return {child, url, ended};
}

/// `is_busy`: the server refuses the page's first request.
async function open(browser, url, viewport, {is_busy = false, ...options} = {}) {
  const page = await browser.newPage({viewport, ...options});
  page.on("console", (message) => {
    const is_own = is_busy && /status of 503/.test(message.text());
    if (message.type() === "error" && !is_own) errors.push(message.text());
  });
  page.on("pageerror", (error) => errors.push(String(error)));
  if (is_busy) await page.route("**/cameras", (route) => route.fulfill({status: 503, body: "busy\n"}), {times: 1});
  await page.goto(url);
  await has_full_frame(page);
  return page;
}

/// Waits for the picture that follows the last input.
async function has_full_frame(page) {
  await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
  await page.waitForFunction(() => image !== null && shown_full && !wanted && !is_moving(), null, kPatience);
}

const iteration = (page) => page.evaluate(() => state.iteration);

/// Returns the content of the canvas, as small grey values.
const look = (page) => page.evaluate(() => {
  const small = document.createElement("canvas");
  small.width = small.height = 64;
  const context = small.getContext("2d");
  context.drawImage(picture, 0, 0, 64, 64);
  const data = context.getImageData(0, 0, 64, 64).data;
  return Array.from({length: 64 * 64}, (_, i) => (data[4 * i] + data[4 * i + 1] + data[4 * i + 2]) / 3);
});
const difference = (a, b) => a.reduce((sum, x, i) => sum + Math.abs(x - b[i]), 0) / a.length;
const spread = (a) => difference(a, a.map(() => a.reduce((sum, x) => sum + x, 0) / a.length));

/// Ignores errors of a page that was open when its program ended, and is closed now, because it could no longer reach
/// the program. A frame gets 503 if training has no time for it, and the page asks again, or if the program ends
/// meanwhile.
function forgive_the_end() {
  const is_expected = (text) => /ERR_CONNECTION|Failed to fetch|status of 503/.test(text);
  errors.splice(0, errors.length, ...errors.filter((text) => !is_expected(text)));
}

async function picture_of(page, name) {
  await page.screenshot({path: path.join(pictures, `${name}.png`)});
}

const modes = (page, attribute) => page.evaluate((name) => [...document.querySelectorAll(`#modes [${name}=true]`)]
  .map((button) => button.dataset.mode), attribute);

/// The buttons and the legend name the picture that is shown, also while another one is awaited.
async function check_pending_mode(page) {
  assert.deepEqual(await modes(page, "aria-pressed"), ["render"]);
  let let_go = null;
  const is_held = new Promise((resolve) => { let_go = resolve; });
  await page.route("**/frame", async (route) => {
    if (/"mode":"depth"/.test(route.request().postData())) await is_held;
    await route.continue();
  });
  const asked = page.waitForRequest((request) => /"mode":"depth"/.test(request.postData()), kPatience);
  await page.click("[data-mode=depth]");
  await asked;
  assert.deepEqual(await modes(page, "aria-pressed"), ["render"]);
  assert.deepEqual(await modes(page, "aria-busy"), ["depth"]);
  assert.equal(await page.locator("#legend").textContent(), "");
  await picture_of(page, "pending");
  let_go();
  await has_full_frame(page);
  assert.deepEqual(await modes(page, "aria-pressed"), ["depth"]);
  assert.deepEqual(await modes(page, "aria-busy"), []);
  assert.match(await page.locator("#legend").textContent(), /inverse depth/);
  await page.unroute("**/frame");
  await page.click("[data-mode=render]");
  await has_full_frame(page);
}

/// Heights in px of the small curve of these values.
const curve_heights = (page, values) => page.evaluate(async (ys) => {
  const holder = document.createElement("div");
  document.body.append(holder);
  Charts.show(holder, "lines", {title: "n", small: true, height: 64, format: count_text,
                                series: [{name: "n", color: 0, points: ys.map((y, i) => [i, y])}]});
  await null;  // uPlot scales a chart after the call that made it
  const [plot] = Charts.plots(holder), heights = ys.map((y) => plot.valToPos(y, "y"));
  holder.remove();
  return heights;
}, values);

/// Number of columns of pixels of a chart in which something has the colour of its curve.
const drawn_columns = (page, id) => page.evaluate((holder_id) => {
  const {ctx, series} = Charts.plots($(holder_id))[0], {width, height} = ctx.canvas;
  const rgb = series[1].mark.match(/\w\w/g).map((digits) => parseInt(digits, 16));
  const {data} = ctx.getImageData(0, 0, width, height);
  const is_curve = (x, y) => rgb.every((value, i) => Math.abs(data[4 * (y * width + x) + i] - value) < 9);
  return [...Array(width).keys()].filter((x) => [...Array(height).keys()].some((y) => is_curve(x, y))).length;
}, id);

async function drag(page, dx, dy) {
  const box = await page.locator("#picture").boundingBox();
  const x = box.x + box.width / 2, y = box.y + box.height / 2;
  await page.mouse.move(x, y);
  await page.mouse.down();
  for (let i = 1; i <= 8; ++i) await page.mouse.move(x + dx * i / 8, y + dy * i / 8);
  await page.mouse.up();
}

async function check_training(browser) {
  const training = await start(["train", "--view", "0", path.join(folder, "scene"), "-m", path.join(folder, "model"),
    "--iterations", "100000", "--eval", "--test_iterations", "50", "100", "--device", "cpu", "--overwrite"]);
  const page = await open(browser, training.url, {width: 1280, height: 800}, {is_busy: true});
  const first = await iteration(page);
  await page.waitForFunction((before) => state.iteration > Math.max(before, 110) && shown_iteration > before, first,
    kPatience);
  await picture_of(page, "training");

  await page.click("#pause");
  await page.waitForFunction(() => state.paused, null, kPatience);
  await page.waitForTimeout(2500);  // the current step may end, and its state arrives once per second
  const paused_at = await iteration(page);
  await page.waitForTimeout(1500);
  assert.equal(await iteration(page), paused_at, "a paused training does not move on");
  await page.waitForFunction((at) => shown_iteration === at && shown_full, paused_at, kPatience);
  const before = await look(page);
  assert(spread(before) > 5, "the picture shows something");
  await drag(page, 150, 40);
  await has_full_frame(page);
  const after = await look(page);
  assert(difference(before, after) > 2, `a drag changes the picture (by ${difference(before, after)})`);
  await picture_of(page, "dragged");
  await page.mouse.wheel(0, -600);
  await has_full_frame(page);
  assert(difference(after, await look(page)) > 1, "the wheel changes the picture");
  await page.keyboard.down("d");
  await page.waitForTimeout(500);
  await page.keyboard.up("d");
  await has_full_frame(page);

  await page.selectOption("#camera", "3");
  await has_full_frame(page);
  await check_pending_mode(page);
  for (const mode of ["photograph", "difference", "depth", "alpha", "load", "render"]) {
    const shown = await look(page);
    await page.click(`[data-mode=${mode}]`);
    await has_full_frame(page);
    assert(mode === "photograph" || difference(shown, await look(page)) > 1, `${mode} changes the picture`);
    await picture_of(page, mode);
  }

  for (const dx of [0, 120, 120]) {
    if (dx) await drag(page, dx, 0);
    await page.click("#key_add");
  }
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#path_save")]);
  const file = path.join(folder, "camera_path.json");
  await download.saveAs(file);
  const saved = JSON.parse(fs.readFileSync(file));
  assert.equal(saved.camera_path.length, 121);
  assert.equal(saved.render_width, 1920);
  for (const {camera_to_world: matrix, fov} of saved.camera_path) {
    assert(matrix.length === 16 && matrix.every(Number.isFinite) && fov > 0);
  }
  await page.click("#path_play");
  await page.waitForFunction(() => playing === null, null, kPatience);
  await has_full_frame(page);

  await page.click("#save");
  await page.waitForFunction(() => /saved iteration_\d+/.test(state.notice), null, kPatience);
  assert(fs.existsSync(path.join(folder, "model", "checkpoints")));
  for (const name of ["loss", "psnr", "count"]) {
    const n_drawn = await drawn_columns(page, `${name}_curve`);
    assert(n_drawn > 100, `the curve of ${name} is drawn (in ${n_drawn} columns of pixels)`);
    assert.match(await page.locator(`#${name}_now`).textContent(), /\d/);
  }
  const [first_y, last_y] = await curve_heights(page, [8811, 8812]);
  assert(first_y - last_y < 2, `a curve that hardly rises looks so (${first_y - last_y} px)`);
  const [low, high] = await curve_heights(page, [8811, 17622]);
  assert(low - high > 40, "a curve that doubles fills the height");
  await page.locator("#psnr_curve").scrollIntoViewIfNeeded();
  await picture_of(page, "curves");

  const phone = await open(browser, training.url, {width: 390, height: 844},
    {hasTouch: true, deviceScaleFactor: 2, colorScheme: "dark"});
  assert.equal(await phone.evaluate(() => document.documentElement.scrollWidth), 390, "fits a phone");
  assert((await phone.locator("#picture").boundingBox()).height > 300, "there is room for the picture");
  await picture_of(phone, "phone");
  await phone.click("#fold");
  await has_full_frame(phone);
  await picture_of(phone, "phone_folded");
  await phone.close();

  await page.click("#pause");
  await page.waitForFunction((at) => state.iteration > at, paused_at, kPatience);
  page.on("dialog", (dialog) => dialog.accept());
  await page.click("#stop");
  assert.equal(await training.ended, 130, training.child.text);
  assert.match(training.child.text, /resume with/);
  await page.waitForFunction(() => state.ended, null, kPatience);
  assert.equal(await page.locator("#activity").textContent(), "stopped");
  assert(await page.locator("#message").isHidden(), "a training that was stopped is no failure");
  assert.match(await page.locator("#notice").textContent(), /b3dgs view /);
  assert(await page.locator("[data-mode=depth]").isDisabled(), "the picture cannot change any more");
  assert.match(await page.locator("#legend").textContent(), /^last picture, iteration \d/);
  assert.deepEqual(await modes(page, "aria-busy"), []);
  assert(spread(await look(page)) > 5, "the last picture stays");
  await page.setViewportSize({width: 1000, height: 700});
  assert(spread(await look(page)) > 5, "also in a window of another size");
  await picture_of(page, "ended");
  await page.close();
  forgive_the_end();
}

/// Chooses a box, drags its handles, and exports with the file that the page saves.
async function check_crop(page) {
  await page.click("[data-crop=box]");
  const text = () => page.inputValue("#crop_text");
  const numbers = async () => (await text()).replace("--crop=", "").split(",").map(Number);
  const handle = (index) => page.evaluate((i) => {
    const area = picture.getBoundingClientRect(), [x, y] = on_screen(crop.handles()[i].at, picture_lens());
    return [area.x + x, area.y + y];
  }, index);
  const pull = async (index, dx, dy) => {
    const [x, y] = await handle(index);
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + dx, y + dy, {steps: 5});
    await page.mouse.up();
  };
  const first = await numbers(), matrix = await page.evaluate(() => camera.matrix());
  assert.equal(first.length, 6);
  const [x0, y0] = await handle(6);
  await pull(6, 0, -30);  // the upper side, because z is up
  const higher = await numbers(), [x1, y1] = await handle(6);
  assert(higher[5] > first[5] + 0.01, `the upper side moves: ${first} -> ${higher}`);
  assert.deepEqual([...higher.slice(0, 5)], [...first.slice(0, 5)], "the other sides stay");
  assert(Math.hypot(x1 - x0, y1 - (y0 - 30)) < 6, "the handle follows the pointer");
  await pull(0, 40, 0);
  const moved = await numbers();
  assert(Math.abs((moved[3] - moved[0]) - (higher[3] - higher[0])) < 2e-3, "the size stays");
  assert.notDeepEqual(moved, higher, "the box moves");
  assert.deepEqual(await page.evaluate(() => camera.matrix()), matrix, "the camera stays");
  await picture_of(page, "crop_box");
  await page.click("[data-crop=sphere]");
  await pull(2, 0, 0);
  await picture_of(page, "crop_sphere");
  assert.equal((await numbers()).length, 4);
  await page.fill("#crop_text", "--crop=-1,-1,-1,1,1,0.5");
  await page.press("#crop_text", "Enter");
  assert.deepEqual(await numbers(), [-1, -1, -1, 1, 1, 0.5]);
  await page.fill("#crop_text", "1,2");
  await page.press("#crop_text", "Enter");
  assert.match(await page.locator("#message").textContent(), /expected x0,y0,z0/);
  assert.deepEqual(await numbers(), [-1, -1, -1, 1, 1, 0.5], "a text that is no region changes nothing");
  const [saved] = await Promise.all([page.waitForEvent("download"), page.click("#crop_save")]);
  const file = path.join(folder, "crop.txt");
  await saved.saveAs(file);
  const exported = (name, ...words) => execFileSync(program, ["export", path.join(folder, "done"),
    path.join(folder, name), "--compare_views", "0", "--device", "cpu", "--quiet", ...words]).toString();
  assert.match(exported("by_file.ply", "--crop", file), /outside of --crop/);
  exported("by_text.ply", await text());
  assert(fs.readFileSync(path.join(folder, "by_file.ply")).equals(fs.readFileSync(path.join(folder, "by_text.ply"))));
  await page.click("[data-crop=none]");
  assert(await page.locator("#crop_save").isDisabled());
}

async function check_model(browser) {
  execFileSync(program, ["train", path.join(folder, "scene"), "-m", path.join(folder, "done"), "--iterations", "100",
    "--device", "cpu", "--quiet"]);
  // `b3dgs render` accepts the shortened path that the page saved.
  const file = path.join(folder, "camera_path.json");
  const saved = JSON.parse(fs.readFileSync(file));
  const short = {...saved, render_width: 96, render_height: 54, camera_path: saved.camera_path.slice(0, 3)};
  fs.writeFileSync(file, JSON.stringify(short));
  execFileSync(program, ["render", path.join(folder, "done"), "--cameras", file, "--output", path.join(folder, "path"),
    "--device", "cpu", "--quiet"]);
  assert.equal(fs.readdirSync(path.join(folder, "path", "renders")).length, 3);

  const view = await start(["view", path.join(folder, "done"), "--view", "0", "--device", "cpu"]);
  const page = await open(browser, view.url, {width: 1280, height: 800});
  assert(spread(await look(page)) > 5, "the picture shows something");
  assert(await page.evaluate(() => image.height === picture.height || image.width === picture.width),
    "the first picture has the size of the window, not that of the photograph");
  assert(await page.locator("#pause").isHidden(), "there is no training to pause");
  await check_crop(page);
  await page.click("[data-way=fly]");
  const before = await look(page);
  await drag(page, 60, 0);
  await has_full_frame(page);
  assert(difference(before, await look(page)) > 1, "a drag changes the picture");
  await picture_of(page, "model");
  view.child.kill("SIGINT");
  assert.equal(await view.ended, 0, view.child.text);
  await page.close();
  forgive_the_end();
}

async function main() {
  execFileSync(program, ["synth", "orbit", path.join(folder, "scene"), "--points", "3000", "--views", "16",
    "--width", "240", "--height", "180", "--quiet"]);
  const browser = await chromium.launch({executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--disable-gpu",
    "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync"]});
  try {
    await check_training(browser);
    await check_model(browser);
    assert.equal(errors.length, 0, `errors on the console: ${errors.join("; ")}`);
  } finally {
    await browser.close();
    fs.rmSync(folder, {recursive: true, force: true});
  }
  console.log(`check_view: passed; pictures in ${pictures}`);
}

main().catch((error) => {
  console.error(`check_view: failed: ${error.stack}`);
  process.exit(1);
});
