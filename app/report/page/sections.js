// Sections shared by the reports of a training and of a comparison. Where data is missing, a sentence reports it.
// `element`, `table` and `Charts` are in app/common/page.

const paragraph = (text) => element("p", {}, text);
const soft = (text) => element("p", {class: "soft"}, text);
const section = (heading, ...content) =>
    element("section", {}, element("h2", {}, heading), ...content.flat(Infinity));
/// A section that is closed until its heading is clicked, and printed in full.
const folded = (heading, ...content) =>
    element("details", {class: "folded"}, element("summary", {}, heading), ...content.flat(Infinity));

/// Uses 2 decimals if `smallest`, the smallest of the times shown together, is below 10 s, otherwise 1.
const seconds_text = (seconds, smallest) => `${seconds.toFixed(smallest < 10 ? 2 : 1)} s`;
const bytes_text = (n) => (n >= 1e9 ? `${(n / 1e9).toFixed(2)} GB` : n >= 1e6 ? `${(n / 1e6).toFixed(1)} MB`
                                                                            : `${(n / 1e3).toFixed(1)} kB`);

const kMeasuredHalf = "PSNR and SSIM are those of the right half of each test view, with colours fitted to its left " +
    "half (--train_test_exp).";

/// Quantities to draw over the iterations. `key` names a curve.
const kQuantities = {
  psnr: {key: "test_psnr", name: "PSNR", unit: "dB", caption: "PSNR, mean over the test views.", from_zero: false,
         format: (x) => x.toFixed(2)},
  ssim: {key: "test_ssim", name: "SSIM", caption: "SSIM, mean over the test views.", from_zero: false,
         format: (x) => x.toFixed(4)},
  sharpness: {key: "test_sharpness", name: "Sharpness", from_zero: false, format: (x) => x.toFixed(3),
              caption: "Sharpness of the renders of the test views relative to their photographs."},
  loss: {key: "loss", name: "Loss", caption: "Training loss, running average over steps."},
  count: {key: "count", name: "Gaussians", caption: "Number of Gaussians.", format: count_text},
};

/// "PSNR: naive 21.5 dB, adaptive 21.6 dB (iteration 60)."
function curve_sentence({name, unit, format = figure_text}, series) {
  const values = series.map((own) => (series.length > 1 ? `${own.name} ` : "") + format(own.points[0][1]) +
                                     (unit ? ` ${unit}` : ""));
  const iterations = new Set(series.map((own) => own.points[0][0]));
  return paragraph(`${name}: ${values.join(", ")}` +
                   (iterations.size === 1 ? ` (iteration ${count_text([...iterations][0])}).` : "."));
}

/// Returns a chart of series [{name, color, points}], a sentence if none has two points, or nothing if there is no
/// point.
function series_figure(quantity, all, events = []) {
  const series = all.filter((own) => own.points.length > 0);
  if (series.length === 0) return [];
  if (series.every((own) => own.points.length < 2)) return curve_sentence(quantity, series);
  const {name, unit, caption, from_zero, height, format} = quantity;
  return Charts.figure("lines", {title: `${name} over the iterations`, y_label: name + (unit ? `, ${unit}` : ""),
                                 series, events, from_zero, height, format}, caption);
}

/// Does the same for a curve of each run.
function curve_figure(quantity, runs) {
  return series_figure(quantity, runs.map(({name, color, curves}) => {
    const points = curves.iteration.map((x, i) => [x, curves[quantity.key][i]]).filter((point) => point[1] !== null);
    return {name, color, points, markers: points.length <= 20};
  }));
}

const kStages = {upload: "upload of the photograph", project: "projection", bin: "tile lists",
                 blend_forward: "forward blending", loss: "loss", blend_backward: "backward blending",
                 project_backward: "backward projection", optimizer: "optimizer", densify: "density control",
                 host: "remaining CPU time"};

function stage_section(runs) {
  const timed = runs.filter((run) => Object.keys(run.stages_ms).length > 0);
  if (timed.length === 0) return soft("Stages of the training step were not timed.");
  const all = new Set(timed.flatMap((run) => Object.keys(run.stages_ms)));
  const names = [...Object.keys(kStages).filter((name) => all.has(name)),
                 ...[...all].filter((name) => !(name in kStages))];
  const spec = {title: "Mean time of a step by stage", unit: "ms",
                parts: names.map((name) => kStages[name] || name.replaceAll("_", " ")),
                rows: timed.map((run) => ({name: run.name, values: names.map((name) => run.stages_ms[name] || 0)}))};
  return Charts.figure("bars", spec,
                       "Mean time of a training step by stage, over all steps that were timed by stage.");
}

function preview_section({previews, held_out}) {
  if (previews.length === 0) return soft("No views have been rendered yet.");
  const picture = (src, alt, caption) => (src ? [element("div", {}, element("img", {src, alt}), caption)] : []);
  const has_ages = new Set(previews[0].renders.map((own) => own.iteration)).size > 1;
  const rows = previews.map(({view, photograph, renders}) => element(
    "div", {class: "pictures", style: `--columns: ${renders.length + 1}`},
    ...picture(photograph, `photograph ${view}`, `photograph ${view}`),
    ...renders.flatMap(({name, iteration, psnr, image}) => picture(image, `render of ${view} by ${name}`,
      (renders.length > 1 ? name : "render") + (has_ages ? `, iteration ${count_text(iteration)}` : "") +
      `, PSNR ${psnr === null ? "-" : figure_text(psnr)} dB`))));
  return [rows, soft(held_out ? "These are test views: they were held out from training."
                              : "These views were trained on; no test views were held out (--eval does that).")];
}

// --- Kernels

const has_changed = (check) => check.after !== "" && check.before !== check.after;

/// Draws the times of both kernels over the training, with every switch.
function kernel_figure(checks) {
  const series = new Map();
  for (const {iteration, times_ms} of checks) {
    for (const [name, ms] of Object.entries(times_ms)) {
      if (!series.has(name)) series.set(name, {name, color: series.size, points: [], markers: true});
      series.get(name).points.push([iteration, ms]);
    }
  }
  const events = checks.filter(has_changed).map((check) => ({x: check.iteration, label: `to ${check.after}`}));
  return series_figure({name: "Blending time of both kernels", unit: "ms per view", height: 280, caption:
    "Blending time of both kernels over the training, measured on the same views. A dashed line marks an inflection: " +
    "from there on, the other kernel is used."}, [...series.values()], events);
}

/// Lists which kernel ran in which iterations.
function kernels_in_use({kernel_periods: periods, kernel_checks}) {
  if (periods.length === 0) return [];
  if (periods.length === 1) return paragraph(`All iterations used the kernel ${periods[0].kernel}.`);
  const rows = periods.map(({kernel, from, until}, i) => {
    const is_by_check = kernel_checks.some((check) => check.iteration === from + 1 && check.after === kernel);
    return [kernel, `${count_text(from + 1)} to ${count_text(until)}`,
            is_by_check ? "timing check" : i === 0 ? "start of the training" : "resumed with another --kernel"];
  });
  return table(["kernel", "iterations", "selected by"], rows, {words: true});
}

/// Lists the timing checks, and the kernels that changed because training was resumed with other options.
function check_table({kernel_checks, resumes}) {
  const events = [...resumes.map((own) => ({...own, at: own.iteration + 0.5})),
                  ...kernel_checks.map((own) => ({...own, at: own.iteration}))].sort((a, b) => a.at - b.at);
  const rows = [];
  let in_use = "";
  for (const own of events) {
    if (own.times_ms) {
      in_use = own.after;
      const times = Object.entries(own.times_ms).map(([name, ms]) => `${name} ${ms.toFixed(3)}`);
      rows.push([count_text(own.iteration), times.join(", ") || "-",
                 own.error_ms === null ? "-" : own.error_ms.toFixed(3), String(own.views ?? "-"),
                 has_changed(own) ? `from ${own.before} to ${own.after}` : own.after, own.reason]);
      continue;
    }
    const before = in_use;
    in_use = own.kernel;
    if (!before || !own.kernel || before === own.kernel) continue;
    rows.push([count_text(own.iteration + 1), "-", "-", "-", `from ${before} to ${own.kernel}`,
               `resumed${own.changed_options.length > 0 ? " with " : ""}${own.changed_options.join(", ")}`]);
  }
  return table(["iteration", "mean time per view, ms", "standard error of the difference, ms", "views", "kernel",
                "reason"], rows, {words: true});
}

function check_cost({kernel_checks: checks, curves: {elapsed_s}}) {
  const last_s = elapsed_s[elapsed_s.length - 1] || 0;
  if (last_s <= 0 || checks.every((check) => check.cost_ms === null)) return [];
  const cost_ms = checks.reduce((sum, check) => sum + (check.cost_ms || 0), 0);
  return paragraph(`${checks.length} timing ${checks.length === 1 ? "check" : "checks"} took ` +
    `${figure_text(cost_ms)} ms, ${figure_text(0.1 * cost_ms / last_s)} % of the training time, which includes them.`);
}

function kernel_section(run) {
  const checks = run.kernel_checks;
  if (checks.length === 0) {
    return [kernels_in_use(run), soft("No kernels were timed: an option fixed the kernel, or training was too short.")];
  }
  return [kernels_in_use(run), kernel_figure(checks), check_cost(run), check_table(run)];
}

// --- Load

function load_figure(events, field, name, caption) {
  if (events.length === 0) return [];
  const gini = (event) => `${figure_text(event[field].gini)} at iteration ${count_text(event.iteration)}`;
  const ginis = ` Gini coefficient (0 = evenly distributed, 1 = maximally uneven): ${gini(events[0])}` +
      (events.length > 1 ? `, ${gini(events[events.length - 1])}.` : ".");
  if (events.length === 1) {
    const load = events[0][field], text = (key) => figure_text(load[key]);
    return paragraph(`${name} at iteration ${count_text(events[0].iteration)}: median ${text("median")}, 90th ` +
      `percentile ${text("p90")}, 99th percentile ${text("p99")}, maximum ${text("max")}.${ginis}`);
  }
  const quantile = (name, key, color, own) =>
      ({name, color, points: events.map((event) => [event.iteration, event[field][key]]), ...own});
  return Charts.figure("lines", {
    title: `${name} over the iterations`, y_label: name, log: true, height: 280,
    series: [quantile("maximum", "max", 0, {band: "33"}), quantile("99th percentile", "p99", 0, {band: "66"}),
             quantile("90th percentile", "p90", 0, {band: "99"}),
             quantile("median", "median", 0, {markers: events.length <= 40}), quantile("minimum", "min", 8)],
  }, caption + ginis);
}

/// Draws up to four measurements, evenly spaced over the training.
function load_histograms(events, field, name, counted, caption) {
  const filled = events.filter((event) => event[field].log2_bins.length > 0), n = Math.min(4, filled.length);
  if (n === 0) return [];
  const chosen = Array.from({length: n}, (_, i) => filled[n > 1 ? Math.floor(i * (filled.length - 1) / (n - 1)) : 0]);
  return Charts.figure("histograms", {
    title: `Distribution of ${name}`, x_label: name, item: "Gaussians",
    panels: chosen.map((event) => ({name: `iteration ${count_text(event.iteration)}`, counts: event[field].log2_bins})),
  }, `Share of ${counted} ${caption} Each bin is twice as wide as the one before.`);
}

function load_section({load_statistics: loads}) {
  const tiles = loads.filter((event) => event.tile_lists), pixels = loads.filter((event) => event.pixel_processed);
  if (tiles.length === 0 && pixels.length === 0) return soft("Load statistics were not recorded.");
  const per_tile = "Gaussians per tile", per_pixel = "Gaussians processed per pixel", views = loads[0].views;
  return [
    views === null ? [] : soft(`Measured over all tiles and pixels of ${views} training ` +
                               `${views === 1 ? "view" : "views"} together.`),
    load_figure(tiles, "tile_lists", per_tile, "Number of Gaussians in a tile's list: quantiles over all tiles."),
    load_figure(pixels, "pixel_processed", per_pixel, "Number of Gaussians that a pixel processes before it is " +
      "saturated or its tile's list ends: quantiles over all pixels."),
    load_histograms(tiles, "tile_lists", per_tile, "tiles", "by the length of their list. A kernel that assigns one " +
      "thread block to each tile waits for the longest lists."),
    load_histograms(pixels, "pixel_processed", per_pixel, "pixels", "by the number of Gaussians that they process. A " +
      "kernel that assigns one thread to each pixel leaves threads idle while others of their warp continue."),
  ];
}

// --- Settings and words

const kMachine = {cpu: "CPU", cores: "logical cores", memory_gb: "host memory, GB", device: "trained on", gpu: "GPU",
                  gpu_memory_gb: "GPU memory, GB", cuda: "CUDA", libtorch: "LibTorch"};

function settings_table({settings, machine}) {
  const text = (value) => (typeof value === "number" ? figure_text(value)
                           : typeof value === "string" ? value : JSON.stringify(value));
  return table([], [...settings, ...Object.entries(machine).map(([key, value]) =>
      [kMachine[key] || key.replaceAll("_", " "), text(value)])], {words: true});
}

const words_section = () => table([], [
  ["PSNR, SSIM", "Quality of a render against its photograph; higher is better."],
  ["sharpness", "Sum of |Laplacian| of a render divided by that of its photograph; below 1: softer."],
  ["percentile", "90 % of the values are at or below the 90th percentile; half of them at or below the median."],
  ["tile", "16 x 16 px, or 16 x 8 px with the paper's kernels; has a list of the Gaussians that touch it, sorted by " +
   "depth."],
  ["saturated pixel", "So opaque that the Gaussians further behind are not processed: they would not be seen."],
  ["Gini coefficient", "How uneven the work is: 0 if all tiles or pixels have the same, 1 if one has it all."],
  ["forward, backward pass", "From Gaussians to an image; from the error of the image to their gradients."],
  ["kernel", "Combines the Gaussians of a tile into pixels. All kernels compute the same image, but they divide the " +
   "work differently, so their times differ."],
  ["timing check", "At the start of the training and at every interval, two kernels blend the same views and are " +
   "timed. Training switches to the other one if it is faster."],
  ["inflection", "The iteration from which the other kernel is used (a word of the paper)."],
  ["warp, thread block", "Groups of GPU threads: the 32 threads of a warp run in step; a block is 1 to 32 warps."],
  ["density control", "Adding Gaussians where detail is missing, and removing transparent ones."],
  ["session", "The part of a training that one run of the program did; each resume begins another."],
], {words: true});
