// The report of a comparison: compare.json's "summary", and the runs of all configurations.

/// Grey for the baseline, colours for the others.
const color_of = (configuration) => (configuration === 0 ? 9 : (configuration - 1) % 8);

/// Returns the runs of the first seed, which the charts show.
function first_runs({runs, seeds, summary}) {
  return summary.results.map(({name}, i) => ({...runs[i * seeds.length], name, color: color_of(i)}));
}

const seeds_started = (summary) => summary.done_by_seed.filter((done) => done > 0).length;
const in_seeds = (n, all) => (n === all ? "" : ` in ${n} of ${all} seeds`);

/// Returns "28.90", with several seeds "28.90 (28.81 to 28.97)"; "-" if unknown.
function spread_cell(spread, text) {
  if (!spread) return "-";
  return text(spread.mean) + (spread.n > 1 ? ` (${text(spread.min)} to ${text(spread.max)})` : "");
}

// --- Results

function results_section({summary: {results}}) {
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
  const fixed = (digits) => (value) => value.toFixed(digits);
  const rows = results.map((own) => [
    own.name, count_text(own.iterations), spread_cell(own.seconds, fixed(2)), spread_cell(own.gaussians, count_text),
    spread_cell(own.psnr, fixed(2)), spread_cell(own.ssim, fixed(4))]);
  return [chart, table(["configuration", "iterations", "training time, s", "Gaussians", "PSNR, dB", "SSIM"], rows),
          soft(results.some((own) => own.complete_seeds > 1)
                   ? "At the end of each training: mean over the seeds that are complete, and range."
                   : "At the end of each training; - is not known yet.")];
}

// --- Quality

const measure_text = (measure) => (measure === "Gaussians" ? count_text
                                   : (x) => x.toFixed(measure === "SSIM" ? 4 : 2));

function quality_section(data) {
  const {summary, measures_half} = data;
  const tables = summary.compared.filter((own) => own.quality.length > 0).map(({name, quality}) => {
    const rows = quality.map((own) => {
      const text = measure_text(own.measure);
      const signed = (x) => (x < 0 ? text(x) : `+${text(x)}`);
      return [own.measure + in_seeds(own.baseline.n, seeds_started(summary)), count_text(own.iteration),
              spread_cell(own.baseline, text), spread_cell(own.ours, text),
              signed(own.difference) + (own.machine_spread === null ? "" : ` ± ${text(own.machine_spread)}`) +
                  (own.interval ? ` (95 %: ${signed(own.interval[0])} to ${signed(own.interval[1])})` : ""),
              own.finding];
    });
    return table(["measure", "at iteration", summary.baseline, name, "difference", ""], rows);
  });
  if (tables.length === 0) return soft("Quality has not been measured yet.");
  const runs = first_runs(data), n_values = runs[0].curves.test_psnr.filter((psnr) => psnr !== null).length;
  return [tables, measures_half ? soft(kMeasuredHalf) : [],
          n_values === 0 ? soft(summary.holds_out_views ? "PSNR has not been measured yet."
                                : "No test views were held out (--no_eval), so there is no PSNR.")
          : n_values > 1 ? curve_figure(kQuantities.psnr, runs) : []];  // the tables have a single value
}

// --- Training time

/// Returns "18.3 %", with the run-to-run variation "18.3 % ± 0.4 %". With several seeds also the range or, if the share
/// has one, the 95 % interval of the mean. Adds the finding unless `has_word`.
function share_cell(share, noise, n_seeds, has_word = true) {
  if (!share) return "-";
  const {mean, min, max, n, interval, finding} = share;
  const range = (low, high) => `${(100 * low).toFixed(1)} to ${(100 * high).toFixed(1)}`;
  return percent_text(mean) + (noise === null ? "" : ` ± ${percent_text(noise)}`) +
         (n === 1 ? "" : interval ? ` (95 %: ${range(...interval)} %)` : ` (${range(min, max)})`) +
         (has_word || finding === "differs" ? "" : `, ${finding}`) + in_seeds(n, n_seeds);
}

const time_word = (share) => (share.finding !== "differs" ? share.finding : share.mean > 0 ? "faster" : "slower");

const kSavedHead = ["time saved: total", "", "up to the inflection", "from it", "inflection at iteration"];

function saved_cells(own, n_seeds) {
  const {saved_overall: total, machine_spread: noise, inflection: at} = own;
  const when = at && count_text(at.min) + (at.max > at.min ? ` to ${count_text(at.max)}` : "");
  return [share_cell(total, noise.overall, n_seeds), total ? time_word(total) : "-",
          share_cell(own.saved_before_inflection, noise.before, n_seeds),
          share_cell(own.saved_after_inflection, noise.after, n_seeds),
          at ? when + in_seeds(at.n, n_seeds) : "none"];
}

/// Returns "40.1 s", with several seeds "40.1 s (39.8 to 40.4)".
function seconds_cell({by_seed}, key) {
  const all = by_seed.map((seed) => seed[key]);
  if (all.length === 0) return "-";
  const mean = all.reduce((sum, s) => sum + s, 0) / all.length, low = Math.min(...all), high = Math.max(...all);
  const text = (seconds) => seconds_text(seconds, low).replace(" s", "");
  return `${text(mean)} s` + (all.length > 1 ? ` (${text(low)} to ${text(high)})` : "");
}

/// Returns "lambda_dssim 0.2 → 0.4" for few options, and the number of options for more.
function differences_cell({options}, own, i) {
  const kernel = own.has_own_kernel ? ["kernel"] : [], names = own.differs_in;
  if (names.length > 3) return [...kernel, `${names.length} options (see below)`].join(", ");
  const text = (name) => {
    const row = options.find((option) => option[0] === name);
    return row ? `${name} ${row[1]} → ${row[i + 2]}` : name;
  };
  return [...kernel, ...names.map(text)].join(", ") || "nothing";
}

function time_table(data) {
  const {summary} = data, compared = summary.compared;
  const has_switch = compared.some((own) => own.inflection);
  const shown = (cells) => (has_switch ? cells : cells.slice(0, 2));
  const rows = [[`${summary.baseline} (baseline)`, seconds_cell(compared[0], "baseline_s"),
                 ...shown(kSavedHead.map(() => "-")), "-"],
                ...compared.map((own, i) => [own.name, seconds_cell(own, "ours_s"),
                                             ...shown(saved_cells(own, own.by_seed.length)),
                                             differences_cell(data, own, i)])];
  return [table(["configuration", "training time", ...shown(kSavedHead), "differs in"], rows,
                {marked: 1 + compared.findIndex((own) => own.name === summary.ours)}),
          soft(`Time saved is a share of ${summary.baseline}'s training time.` +
               (has_switch ? " The inflection is the first iteration with another kernel; the shares up to it and " +
                             "from it are means over the seeds that have both." : ""))];
}

/// The time that load balancing alone saves.
function balancing_table({summary}) {
  const {balancing: gains, missing_kernels} = summary;
  if (gains.length === 0) {
    return missing_kernels.length === 0 ? [] : paragraph("How much load balancing alone saves is unknown: these " +
      `kernels without load balancing were not trained with the options of ${summary.ours}: ` +
      `${missing_kernels.join(", ")}.`);
  }
  const rows = gains.map((gain) => {
    const cell = (saved) => share_cell(saved, gain.machine_spread, saved.n, /*has_word=*/ false);
    return [gain.name, gain.naive, cell(gain.saved_naive_to_unbalanced), gain.unbalanced,
            cell(gain.saved_by_balancing), cell(gain.saved_whole)];
  });
  return [table(["configuration", "compared with", "saved without load balancing", "by", "saved by load balancing",
                 "saved in total"], rows, {marked: gains.findIndex((gain) => gain.name === summary.ours)}),
          soft("The configurations of a row differ only in the kernel. Load balancing is compared with the " +
               "fastest kernel without it, as a share of that kernel's time; the other two columns are shares of " +
               "naive's time.")];
}

function time_charts(data) {
  const {summary, seeds} = data, runs = first_runs(data), baseline = runs[0].curves;
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

function noise_sentence({repetition, machine_spread, baseline, compared}) {
  if (!repetition) return "The run-to-run variation of times was not measured (--noise does that).";
  if (machine_spread === null) return `${baseline} has not been trained twice yet: the run-to-run variation is unknown.`;
  const again = compared.find((own) => own.name === repetition).quality.map((own) =>
      `, ${own.measure.split(",")[0]} ${measure_text(own.measure)(own.machine_spread)}`);
  return `Run-to-run variation of ${baseline}: time ${percent_text(machine_spread)}${again.join("")}. Values after ± ` +
         "are the run-to-run variation over the same iterations, the largest of all seeds.";
}

function time_section(data) {
  const {reading_s, output_s, summary} = data;
  return [
    time_table(data), balancing_table(data), soft(noise_sentence(summary)), time_charts(data),
    soft("Times include rendering, gradients, loss, optimizer, density control, uploads and timing checks of " +
         `kernels. Reading the scene (${seconds_text(reading_s, 0)}, once for all configurations) and evaluation, ` +
         `saving and checkpoints (${seconds_text(output_s, 0)} in total) are not included.`),
  ];
}

// --- Kernels, load, published results

/// Calls `make` for each run, under a heading.
const of_runs = (runs, make) => runs.map((run) => [element("h3", {}, `${run.name}, seed ${run.seed}`), make(run)]);

/// Among the runs for which `has` is true, returns the first of the configuration that the verdict is about, else the
/// first.
function one_run({runs, summary}, has) {
  const found = runs.filter(has);
  return [...found.filter((run) => run.name === summary.ours), ...found].slice(0, 1);
}

/// Returns the first run with timing checks of each configuration.
function compared_kernels({runs}) {
  const checked = runs.filter((run) => run.kernel_checks.length > 0);
  const first = checked.filter((run, i) => checked.findIndex((own) => own.name === run.name) === i);
  return first.length > 0 ? of_runs(first, kernel_section) : soft("No kernels were timed.");
}

/// Shows the load of one configuration. It depends almost only on the scene and on the size of tiles.
function compared_load(data) {
  const one = one_run(data, (run) => run.load_statistics.length > 0);
  return one.length > 0 ? of_runs(one, load_section) : load_section({load_statistics: []});
}

/// Shows published results beside those of configurations that repeat the published comparison.
function paper_section({summary}) {
  const published = "The Balanced 3DGS paper (arXiv 2412.17378) compares the kernel naive with a choice between the " +
      "kernels combined (load-balanced) and shared-memory, both with the backward pass and optimizer of the original " +
      "3DGS trainer, on an A100 with its own scene at 960 x 540 px. It reports 8.5 % of training time saved in " +
      "total: 19.6 % up to the inflection at about iteration 2,000, where it switches from combined to " +
      "shared-memory, and 7.9 % from there on.";
  if (summary.beside_paper.length === 0) {
    return soft(`${published} No configurations here repeat that comparison; --configs paper does.`);
  }
  const rows = summary.beside_paper.map((own) => {
    const cells = saved_cells(own, seeds_started(summary));
    if (!own.inflection && own.by_seed.length > 0) cells.splice(2, 3, "no switch", "no switch", "-");
    return [`${own.name} against ${own.baseline}`, ...cells];
  });
  const in_paper = ["in the paper", "8.5 %", "", "19.6 %", "7.9 %", "about 2,000"];
  return [table(["comparison", ...kSavedHead], [...rows, in_paper]),
          soft(`${published} Here, both sides use this program's loss, optimizer and projection, which are faster ` +
               "than the original ones, so the forward pass is a larger share of a step.")];
}

// --- The page

/// Explains when a difference is more than chance, with the limits of the measured quantities.
function criterion({compared, machine_spread, done_by_seed}) {
  const {saved_overall: saved, quality} = compared[0];
  if (!saved) return [];
  const judged = compared.map((own) => own.saved_overall).filter((own) => own.finding !== "too short");
  const largest = Math.max(...judged.map((own) => own.limit));  // turns vary more in some than in others
  const times = judged.length === 0 ? [] : [{...saved, text: `${percent_text(largest)} of the time`}];
  const limits = [...times, ...quality.map((own) => ({...own, text:
      own.measure === "Gaussians" ? `${percent_text(own.tolerance / own.baseline.mean)} of the Gaussians`
                                  : `${Number(own.tolerance.toPrecision(3))} ${own.measure.split(", ").pop()}`}))];
  const text = (has_interval) =>
      limits.filter((own) => (own.interval !== null) === has_interval).map((own) => own.text).join(", ");
  const of_seeds = text(true), of_one_seed = text(false);
  return soft(
      (judged.length === compared.length ? ""
          : '"Too short": to judge times takes at least 10 turns and 10 s of training in each configuration. ') +
      (of_seeds &&
          "95 %: the interval of the mean difference over the seeds (Student's t, the runs of a seed paired; of " +
          'times, at least as wide as the spread of the turns suggests). "Differs", "faster", "slower": it excludes ' +
          `0, and the mean is at least the limit (${of_seeds}). "Equal": it lies within the limits. "Unclear": ` +
          "neither. ") +
      (of_one_seed &&
          `With one seed, smaller differences than these may be chance ("unclear"): ${of_one_seed}. Only values that ` +
          'hardly differ are "equal". ' +
          (judged.length === 0 ? "" : "The limit of times assumes that runs differ no more than the spread of their " +
                                      "turns suggests. ") +
          (machine_spread === null ? "" : "Limits are at least 12.7 times the run-to-run variation. ") +
          (done_by_seed.length > 1 ? "" : "--seeds 0,1,2 tells more.")));
}

function options_table({options, summary}) {
  if (options.length === 0) return soft("The configurations have the same options.");
  return table(["option", ...summary.results.map((own) => own.name)], options, {words: true});
}

function what_was_compared({scene, seeds, chunk, summary}, is_of_one_length) {
  const n = seeds.length, started = seeds_started(summary);
  return paragraph(`Scene ${scene}, ` +
    (is_of_one_length ? `${count_text(summary.done)} iterations of each configuration, `
                      : "each configuration for its own number of iterations, ") +
    `${started < n ? `${started} of ` : ""}${n} ${n === 1 ? "seed" : "seeds"}. All configurations trained on the ` +
    `same views in the same order, in turns of ${chunk} iterations, so that changes in the speed of the machine ` +
    "affect all of them alike.");
}

function comparison_page(data) {
  const {scene, summary} = data, runs = first_runs(data);
  const is_of_one_length = summary.results.every((own) => own.iterations === summary.results[0].iterations);
  const note = () => (is_of_one_length ? [] : soft(`Compared over the first ${count_text(summary.done)} iterations, ` +
    "which all configurations have done, and so not at the end of the longer ones."));
  return [`Comparison on ${scene}`, summary.verdict, [
    what_was_compared(data, is_of_one_length), criterion(summary),
    section("Results", results_section(data)),
    section("Photographs and renders", preview_section(data)),
    section("Quality", note(), quality_section(data)),
    section("Training time", note(), time_section(data)),
    (summary.beside_paper.length > 0 ? section : folded)("Published results", paper_section(data)),
    section("Scene, options and machine", settings_table(data), options_table(data)),
    folded("Time by stage of the training step", stage_section(runs)),
    folded("Kernels: which were used, and why", compared_kernels(data)),
    folded("Load: Gaussians per tile and per pixel", compared_load(data)),
    folded("Words", words_section()),
  ]];
}
