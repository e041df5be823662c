// The report of one training.

/// Returns "1 h 2 min", "12 min 3 s" or "4.21 s".
function time_text(seconds) {
  if (seconds < 60) return seconds_text(seconds, seconds);
  const total = Math.round(seconds);
  return total < 3600 ? `${Math.floor(total / 60)} min ${total % 60} s`
                      : `${Math.floor(total / 3600)} h ${Math.floor(total / 60) % 60} min`;
}

/// Returns the quality on test views or, without these, on the training views shown. Returns "" if neither was
/// evaluated.
function reached_quality({runs: [{curves}], previews, held_out, measures_half}) {
  const at = curves.test_psnr.findLastIndex((psnr) => psnr !== null);
  if (at >= 0) {
    const views = measures_half ? "the right half of test views" : "test views";
    const when = at < curves.iteration.length - 1 ? ` at iteration ${count_text(curves.iteration[at])}` : "";
    return `, PSNR ${curves.test_psnr[at].toFixed(2)} dB on ${views}${when}`;
  }
  const shown = previews.flatMap((view) => view.renders.map((render) => render.psnr));
  if (held_out || shown.length === 0) return "";
  const mean = shown.reduce((sum, psnr) => sum + psnr / shown.length, 0);
  return `, PSNR ${mean.toFixed(2)} dB on ${shown.length} training ${shown.length === 1 ? "view" : "views"}`;
}

function training_headline(data) {
  const {iteration, elapsed_s, count} = data.runs[0].curves, last = iteration.length - 1;
  if (last < 0) return `${data.scene}: no iterations logged yet`;
  const progress = iteration[last] < data.iterations
      ? `not finished, ${count_text(iteration[last])} of ${count_text(data.iterations)} iterations in `
      : "trained in ";
  const size = count[last] === null ? "" : `, ${count_text(count[last])} Gaussians`;
  return `${data.scene}: ${progress}${time_text(elapsed_s[last])}${reached_quality(data)}${size}`;
}

function training_quality({runs, held_out, overfitting, limit, floaters, measures_half}) {
  const chart = (quantity) => curve_figure(quantity, runs.map((run) => ({...run, name: quantity.name, color: 0})));
  const has_psnr = runs[0].curves.test_psnr.some((psnr) => psnr !== null);
  return [
    has_psnr ? chart(kQuantities.psnr)
             : soft(held_out ? "The test views have not been evaluated yet."
                             : "No test views were held out (--eval does that), so there is no PSNR."),
    overfitting ? paragraph(`Overfitting: after iteration ${count_text(overfitting.iteration)}, PSNR on the test ` +
      `views was ${overfitting.lost.toFixed(2)} dB higher than at the last evaluation. With few photographs, a lower ` +
      "--max_epochs or fewer Gaussians (a lower --gaussians_per_pixel, or --max_gaussians) may help; if things move, " +
      "mask them. See docs/recipes.md, Few photographs.") : [],
    chart(kQuantities.ssim), chart(kQuantities.sharpness), chart(kQuantities.loss), chart(kQuantities.count),
    limit ? paragraph(`From iteration ${count_text(limit.iteration)} on, the number of Gaussians was limited to ` +
      `${count_text(limit.count)} (${limit.reason}).`) : [],
    floaters ? paragraph(`Gaussians that may be floaters: ${floaters}. See docs/recipes.md, Floaters.`) : [],
    measures_half ? soft(kMeasuredHalf) : [],
  ];
}

function training_time({runs, reading_s, output_s, gpu_peak_bytes}) {
  const elapsed_s = runs[0].curves.elapsed_s;
  const memory = ` GPU memory peaked at ${bytes_text(gpu_peak_bytes)}, not counting the CUDA context.`;
  return [
    paragraph(`Training took ${time_text(elapsed_s[elapsed_s.length - 1])}, including density control, the upload of ` +
      `photographs and timing checks of kernels. Reading the scene (${time_text(reading_s)}) and evaluation, saving ` +
      `and checkpoints (${time_text(output_s)}) are not included.${gpu_peak_bytes > 0 ? memory : ""}`),
    stage_section(runs),
  ];
}

function training_page(data) {
  const run = data.runs[0], is_empty = run.curves.iteration.length === 0;
  return [`Training of ${data.scene}`, training_headline(data), [
    section("Photographs and renders", preview_section(data)),
    is_empty ? paragraph("train.jsonl has no entries yet, so there are no curves.")
             : [section("Quality", training_quality(data)), section("Time and memory", training_time(data))],
    section("Scene, options and machine", settings_table(data)),
    folded("Load: Gaussians per tile and per pixel", load_section(run)),
    folded("Kernels: which were used, and why", kernel_section(run)),
    folded("Words", words_section()),
  ].flat()];
}
