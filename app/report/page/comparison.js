// The report of a comparison: compare.json's "summary", and the runs of all configurations.

/// Grey for the baseline, colours for the others.
const color_of = (configuration) => (configuration === 0 ? 9 : (configuration - 1) % 8);

/// Returns the runs of the first seed, which the charts show.
function first_runs({runs, seeds, summary}) {
  return summary.results.map(({name}, i) => ({...runs[i * seeds.length], name, color: color_of(i)}));
}

/// Shows a table of the terminal: its first row is the head.
const terminal_table = ([head, ...rows], options) => table(head, rows, options);

/// Returns "28.90", with several seeds "28.90 (28.81 to 28.97)".
const spread_cell = ({mean, min, max, n}, text) => text(mean) + (n > 1 ? ` (${text(min)} to ${text(max)})` : "");

// --- Results

function results_section({summary: {results, ours, baseline}, tables}, is_of_one_length) {
  const dots = results.map((own, i) => ({own, color: color_of(i)})).filter(({own}) => own.seconds && own.psnr)
                   .map(({own, color}) => {
    const {seconds, psnr, gaussians} = own;
    return {name: own.name, color, x: seconds.mean, y: psnr.mean, low: psnr.min, high: psnr.max,
            size: gaussians ? gaussians.mean : 0,
            note: `${psnr.mean.toFixed(2)} dB in ${seconds.mean.toFixed(1)} s` +
                  (gaussians ? `, ${count_text(gaussians.mean)} Gaussians` : "")};
  });
  const chart = dots.length === 0 ? [] : Charts.figure("scatter", {
    title: "Quality over training time", x_label: "training time, s", y_label: "PSNR of the test views, dB",
    size_label: "Gaussians", dots,
  }, "Up and to the left is better. The area of a dot is its number of Gaussians; a vertical line is the range over " +
     "seeds; the dashed line joins configurations that no other one beats in both time and PSNR.");
  return [chart, terminal_table(tables.results, {marked: results.findIndex((own) => own.name === ours)}),
          soft(is_of_one_length ? `Means over seeds. Time saved is a share of ${baseline}'s training time.`
                                : "Means over the seeds that are complete, at the end of each training.")];
}

// --- Quality

const measure_text = (measure) => (measure === "Gaussians" ? count_text
                                   : (x) => x.toFixed(measure === "SSIM" ? 4 : 2));

function quality_section({summary, measures_half}, runs) {
  const rows = summary.compared.flatMap(({name, quality}) => quality.map((own) => {
    const text = measure_text(own.measure), signed = (x) => (x < 0 ? text(x) : `+${text(x)}`);
    const {n} = own.baseline, n_seeds = summary.done_by_seed.length;
    return [name, own.measure + (n < n_seeds ? ` (${n} of ${n_seeds} seeds)` : ""), count_text(own.iteration),
            spread_cell(own.baseline, text), spread_cell(own.ours, text), signed(own.difference),
            own.interval ? own.interval.map(signed).join(" to ") : "-", text(own.tolerance), own.finding];
  }));
  if (rows.length === 0) return soft("Quality has not been measured yet.");
  const n_values = runs[0].curves.test_psnr.filter((psnr) => psnr !== null).length;
  return [table(["configuration", "measure", "at iteration", summary.baseline, "own", "difference", "95 % interval",
                 "limit", "finding"], rows),
          measures_half ? soft(kMeasuredHalf) : [],
          n_values === 0 ? soft(summary.holds_out_views ? "PSNR has not been measured yet."
                                : "No test views were held out (--no_eval), so there is no PSNR.")
          : n_values > 1 ? curve_figure(kQuantities.psnr, runs) : []];  // the table has a single value
}

// --- Training time

function time_charts({summary, seeds}, runs) {
  const baseline = runs[0].curves;
  const curve = ({name, color, curves}, value) =>
      ({name, color, points: [[0, 0], ...curves.iteration.map((x, i) => [x, value(x, curves.elapsed_s[i])])]});
  const ours = runs.find((run) => run.name === summary.ours);
  const changed = ours.kernel_checks.find(has_changed);
  const seed = seeds.length > 1 ? `seed ${seeds[0]}` : "";
  const events = !changed ? [] : [{x: changed.iteration, label: `kernel switch at ${count_text(changed.iteration)}` +
                                                                (seed ? ` (${seed})` : "")}];
  const note = seed ? ` Shown for ${seed}.` : "";
  const chart = (name, height, series, caption) =>
      series_figure({name, unit: "s", height, caption: caption + note}, series, events);
  const baseline_s = new Map(baseline.iteration.map((x, i) => [x, baseline.elapsed_s[i]]));
  const difference = runs.slice(1).map((run) => {
    const own = curve(run, (x, seconds) => baseline_s.get(x) - seconds);
    return {...own, points: own.points.filter(([x]) => x === 0 || baseline_s.has(x))};
  });
  return [chart("Training time", 280, runs.map((run) => curve(run, (_, seconds) => seconds)),
                "Training time of each configuration."),
          chart("Time saved", 220, difference, `Time saved compared with ${summary.baseline}: while a curve rises, ` +
                                               "its configuration is faster.")];
}

function time_section({reading_s, output_s, summary, seeds, tables}, runs) {
  const balancing = tables.balancing.length === 0 ? []
      : [terminal_table(tables.balancing), soft("Load balancing is compared with the fastest kernel without it, as a " +
             "share of that kernel's time. The two configurations differ in nothing but the kernel.")];
  return [
    balancing, time_charts({summary, seeds}, runs),
    soft("Times include rendering, gradients, loss, optimizer, density control, uploads and timing checks of " +
         `kernels. Reading the scene (${seconds_text(reading_s, 0)}, once for all configurations) and evaluation, ` +
         `saving and checkpoints (${seconds_text(output_s, 0)} in total) are not included.`),
  ];
}

// --- Kernels, load, published results

/// Calls `make` for each run, under a heading.
const of_runs = (runs, make) => runs.map((run) => [element("h3", {}, `${run.name}, seed ${run.seed}`), make(run)]);

/// Returns the first run with timing checks of each configuration.
function compared_kernels({runs}) {
  const checked = runs.filter((run) => run.kernel_checks.length > 0);
  const first = checked.filter((run, i) => checked.findIndex((own) => own.name === run.name) === i);
  return first.length > 0 ? of_runs(first, kernel_section) : soft("No kernels were timed.");
}

/// Shows the load of one configuration. It depends almost only on the scene and on the size of tiles.
function compared_load({runs, summary}) {
  const logged = runs.filter((run) => run.load_statistics.length > 0);
  const shown = logged.find((run) => run.name === summary.ours) ?? logged[0];
  return shown ? of_runs([shown], load_section) : load_section({load_statistics: []});
}

/// Shows published results beside those of configurations that repeat the published comparison.
function paper_section({tables}) {
  const published = "The Balanced 3DGS paper (arXiv 2412.17378) compares the kernel naive with a choice between the " +
      "kernels combined (load-balanced) and shared-memory, both with the backward pass and optimizer of the original " +
      "3DGS trainer, on an A100 with its own scene at 960 x 540 px. It reports 8.5 % of training time saved in " +
      "total: 19.6 % up to the inflection at about iteration 2,000, where it switches from combined to " +
      "shared-memory, and 7.9 % from there on.";
  if (tables.paper.length === 0) {
    return soft(`${published} No configurations here repeat that comparison; --configs paper does.`);
  }
  return [terminal_table(tables.paper),
          soft(`${published} Here, both sides use this program's loss, optimizer and projection, which are faster ` +
               "than the original ones, so the forward pass is a larger share of a step.")];
}

// --- The page

/// Explains the findings in the tables.
function findings_section({tables, summary: {compared: [{saved_overall: saved}]}}) {
  const has = (column) => tables.results[0].includes(column);
  const several = '"Faster", "slower" and "differs" mean that the 95 % interval of the mean difference over the seeds ' +
      "(Student's t, the runs of a seed paired) excludes 0, and that the mean is at least the limit" +
      (saved?.interval ? `, which is ${percent_text(saved.limit)} of the time` : "") +
      '. "Equal" means that the interval lies within the limits. "Unclear" is everything else. ';
  const one = 'With one seed, differences below the limit may be chance ("unclear"), and only values that hardly ' +
      "differ are equal. This assumes that times vary between runs as between turns, and PSNR by at most 0.2 dB. " +
      "--seeds 0,1,2 tells more. ";
  return soft((has("95 % interval") ? several : "") + (has("one-seed limit") ? one : "") +
              'Times are "too short" to judge with fewer than 10 turns, or less than 10 s of a configuration.');
}

function options_table({options, summary}) {
  if (options.length === 0) return soft("The configurations have the same options.");
  return table(["option", ...summary.results.map((own) => own.name)], options, {words: true});
}

function what_was_compared({scene, seeds, chunk, summary}, is_of_one_length) {
  const n = seeds.length, started = summary.done_by_seed.filter((done) => done > 0).length;
  return paragraph(`Scene ${scene}, ` +
    (is_of_one_length ? `${count_text(summary.done)} iterations of each configuration, `
                      : "each configuration for its own number of iterations, ") +
    `${started < n ? `${started} of ` : ""}${n} ${n === 1 ? "seed" : "seeds"}. All configurations trained on the ` +
    `same views in the same order, in turns of ${chunk} iterations, so that changes in the speed of the machine ` +
    "affect all of them alike.");
}

function comparison_page(data) {
  const {scene, summary, tables} = data, runs = first_runs(data);
  const is_of_one_length = summary.results.every((own) => own.iterations === summary.results[0].iterations);
  const note = () => (is_of_one_length ? [] : soft(`Compared over the first ${count_text(summary.done)} iterations, ` +
    "which all configurations have done, and so not at the end of the longer ones."));
  return [`Comparison on ${scene}`, summary.verdict, [
    what_was_compared(data, is_of_one_length),
    section("Results", results_section(data, is_of_one_length), findings_section(data)),
    section("Photographs and renders", preview_section(data)),
    section("Quality", note(), quality_section(data, runs)),
    section("Training time", note(), time_section(data, runs)),
    (tables.paper.length > 0 ? section : folded)("Published results", paper_section(data)),
    section("Scene, options and machine", settings_table(data), options_table(data)),
    folded("Time by stage of the training step", stage_section(runs)),
    folded("Kernels: which were used, and why", compared_kernels(data)),
    folded("Load: Gaussians per tile and per pixel", compared_load(data)),
    folded("Words", words_section()),
  ]];
}
