// Charts for reports and the live view. uPlot (third_party/uplot) draws them, except bars, which are HTML. Colours are
// --c0 to --c9 of style.css.
//   lines:      {title, y_label, series: [{name, color, points: [[x, y]], markers, band}], events: [{x, label}], log,
//               from_zero, height, format}; x is the iteration. A series with `band`, the opacity as two hexadecimal
//               digits, is the area down to the next series. With `small`: no axes, only the range, which is at least
//               2 % of the largest value
//   bars:       {title, unit, parts: [name], rows: [{name, values}]}: stacked, one bar for each row
//   histograms: {title, x_label, item, panels: [{name, counts}]}: bin 0 is the value 0, bin k 2^(k-1) to 2^k - 1
//   scatter:    {title, x_label, y_label, size_label, dots: [{name, color, x, y, low, high, size, note}]}: areas stand
//               for sizes; the dashed line joins dots that no other one beats in both (less x, more y)
// Each kind has a function that draws it (kKinds) and one that lists its values (kValues).
const Charts = (() => {
  const specs = new Map();  // charts by element: {kind, spec, width, plots}
  const kPrintWidth = 660;  // px, fits A4 and letter
  let ratio = 1;            // canvas px by px of the page: 3 in print, which has more dots per inch than a screen

  const is_number = (value) => typeof value === "number" && Number.isFinite(value);
  const sum = (values) => values.reduce((total, value) => total + value, 0);
  const tone = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
  const color_of = (number) => tone(`c${number % 10}`);

  /// Formats a number of an axis with the digits of the step between numbers.
  function tick_text(value, step) {
    if (Math.abs(value) >= 1e6) return `${Number((value / 1e6).toFixed(3))} M`;
    const digits = value === 0 ? 0 : Math.min(9, (String(Number(step.toPrecision(2))).split(".")[1] || "").length);
    return value.toLocaleString("en-US", {minimumFractionDigits: digits, maximumFractionDigits: digits});
  }

  const whole_steps = Array.from({length: 27}, (_, i) => [1, 2, 5][i % 3] * 10 ** Math.floor(i / 3));
  const legend = {markers: {width: 0, fill: (u, i) => u.series[i].mark}};

  /// Draws with uPlot. `options` are uPlot's, and those of `axes` are added to ours.
  function plot(holder, {width, height = 220, axes, ...options}, data) {
    const font = `${12 * ratio}px ${getComputedStyle(document.documentElement).fontFamily}`;
    const filter = (u, splits, i, ...more) => u.axes[i].filter(u, splits, i, ...more);  // no line without a number
    const values = (u, splits, i, space, step) => splits.map((at) =>
        (at === null ? "" : tick_text(at, u.scales[u.axes[i].scale].distr === 3 ? at : step)));
    const axis = {font, labelFont: font, stroke: tone("soft"), gap: 6 * ratio, labelSize: 16 * ratio,
                  ticks: {show: false}, grid: {stroke: tone("grid"), width: ratio, filter}, values};
    const left = (u, texts) => ratio * (14 + 7 * Math.max(1, ...(texts || []).map((text) => text.length)));
    const made = new uPlot({
      width: width * ratio, height: height * ratio, padding: [8, 20, 4, 0].map((px) => px * ratio), pxAlign: 0,
      axes: [{...axis, size: 24 * ratio, space: 90 * ratio, grid: {show: false}, ...axes[0]},
             {...axis, size: left, space: 36 * ratio, ...axes[1]}],
      cursor: {y: false, drag: {x: false}}, legend, ...options,
    }, data, holder);
    specs.get(holder).plots.push(made);
  }

  const curve = (color, own) =>
      ({stroke: color, mark: color, width: 2 * ratio, spanGaps: true, points: {show: false}, ...own});
  const markers = (color, size, own) => ({show: true, size: size * ratio, fill: color, width: 0, ...own});

  /// Formats a value of the legend: that at the pointer or, if there is none, that at the index `rest(u)`.
  const readout = (format, rest) => (u, value, i, at) => {
    const shown = at === null ? u.data[i][rest(u)] : value;
    return is_number(shown) ? format(shown) : "";
  };
  const last = (u) => u.data[0].length - 1;

  /// Returns a range with a margin, also around equal values.
  const padded = (from_zero) => (u, low, high) => {
    const part = from_zero ? {pad: 0.05, soft: 0, mode: 1} : {pad: 0.05};
    const around = from_zero || low < high ? 0 : 0.01 * Math.abs(low) || 1;
    return uPlot.rangeNum((low ?? 0) - around, (high ?? 1) + around, {min: part, max: part});
  };

  function lines(holder, spec, width) {
    const all = spec.series.map((own) => ({...own, points: own.points.filter((point) => point.every(is_number))}));
    const data = uPlot.join(all.map(({points}) => [points.map((p) => p[0]), points.map((p) => p[1])]));
    const format = spec.format || figure_text;
    const series = all.map(({name, color, points, band, markers: has_markers}) => {
      const own = color_of(color), show = has_markers || points.length === 1;
      return curve(own, {label: name, value: readout(format, last), ...(band ? {width: 0, mark: own + band} : {}),
                         points: show ? markers(own, 7) : {show}});
    });
    const iteration = {label: "iteration", value: readout(count_text, last)};
    const options = {width, height: spec.height, series: [iteration, ...series]};
    if (spec.small) return small_lines(holder, options, data, format);
    const log_scale = {distr: 3, range: (u, low, high) => uPlot.rangeLog(low ?? 1, high ?? 10, 10, false),
                       clamp: (u, value, low) => low};  // 0 is at the lower edge
    plot(holder, {
      ...options, title: spec.y_label, axes: [{label: "iteration", incrs: whole_steps}],
      scales: {x: {time: false, range: (u, low, high) => [0, Math.max(1, high)]},
               y: spec.log ? log_scale : {range: padded(spec.from_zero !== false)}},
      bands: all.flatMap(({band}, i) => (band ? [{series: [i + 1, i + 2], fill: series[i].mark}] : [])),
      hooks: {ready: [(u) => show_events(u, spec.events || [])]},
    }, data);
  }

  /// Draws curves without axes. A first loss, which may be far above all others, is cut off.
  function small_lines(holder, options, data, format) {
    const sorted = [...data[1]].sort((a, b) => a - b), high = sorted[Math.ceil(0.99 * (sorted.length - 1))];
    const room = Math.max(0, 0.02 * Math.abs(high) - (high - sorted[0])) / 2 || 1e-9;
    const range = [sorted[0] - room, high + room], hidden = {show: false};
    plot(holder, {
      ...options, padding: [7, 4, 7, 1], scales: {x: {time: false}, y: {range: () => range}},
      axes: [hidden, {side: 1, size: 56, grid: hidden, splits: () => range, values: () => range.map(format)}],
    }, data);
  }

  /// Marks events with vertical lines. Their labels are at the bottom, where there are rarely curves.
  function show_events(u, events) {
    const width = u.over.clientWidth;
    events.forEach(({x, label}, i) => {
      const at = u.valToPos(x, "x"), is_right = at > width / 2, note = element("span", {}, label);
      const mark = element("div", {class: is_right ? "event right" : "event"}, note);
      mark.style.left = `${at}px`;
      note.style.maxWidth = `${is_right ? at : width - at}px`;
      note.style.bottom = `${14 * ratio * (i % 4)}px`;
      if (at <= width) u.over.append(mark);
    });
  }

  function bars(holder, {parts, rows, unit}) {
    const longest = Math.max(...rows.map((row) => sum(row.values)));
    holder.append(...parts.map((name, i) => element("span", {class: `key c${i % 10}`}, name)));
    for (const {name, values} of rows) {
      if (rows.length > 1) holder.append(element("div", {}, name));
      const texts = [...values, sum(values)].map(figure_text);
      const bar = values.map((value, i) => element("span", {
        class: `c${i % 10}`, style: `width: ${84 * value / longest}%`,
        title: `${name}, ${parts[i]}: ${texts[i]} ${unit}`,
      }, element("span", {}, texts[i])));
      holder.append(element("div", {class: "stack"}, ...bar, `${texts[values.length]} ${unit}`));
    }
  }

  const bin_start = (bin) => (bin === 0 ? 0 : 2 ** (bin - 1));
  const bin_text = (bin) => figure_text(bin_start(bin)) + (bin < 2 ? "" : ` to ${figure_text(2 ** bin - 1)}`);

  /// Returns the percentages of all panels, up to the last bin that any of them fills.
  function percentages({panels}) {
    const n = Math.max(1, ...panels.map(({counts}) => counts.findLastIndex((count) => count > 0) + 1));
    return panels.map(({counts}) => Array.from({length: n}, (_, bin) => 100 * (counts[bin] || 0) / (sum(counts) || 1)));
  }

  function histograms(holder, spec, width) {
    const all = percentages(spec), bins = [...all[0].keys()], color = color_of(0);
    const highest = Math.max(1, ...all.flat()), columns = Math.min(all.length, width > 560 ? 4 : 2);  // as in style.css
    const most = ({data: [, values]}) => values.indexOf(Math.max(...values));
    all.forEach((values, i) => plot(holder, {
      width: width / columns - 12, height: 150, title: spec.panels[i].name,
      scales: {x: {time: false, range: [0, bins.length]}, y: {range: [0, 1.05 * highest]}},
      axes: [{splits: () => bins.filter((bin) => bin % Math.ceil(bins.length / 4) === 1),
              values: (u, at) => at.map((bin) => figure_text(bin_start(bin)))}],
      series: [{label: spec.x_label, value: readout(bin_text, most)},
               curve(color, {label: "share", fill: color, paths: uPlot.paths.bars({size: [1], align: 1}), width: 0,
                             value: readout((value) => `${figure_text(value)} %`, most)})],
    }, [bins, values]));
  }

  function scatter(holder, spec, width) {
    const dots = [...spec.dots].sort((a, b) => b.size - a.size);  // small ones last, so that none is hidden
    const rows = dots.flatMap((dot) => [dot.low, dot.y, dot.high].map((y, i) => ({dot, y, is_dot: i === 1})))
                     .sort((a, b) => a.dot.x - b.dot.x);
    const values = (has) => rows.map((row) => (has(row) ? row.y : undefined));
    const is_beaten = ({x, y}) => dots.some((own) => (own.x < x && own.y >= y) || (own.x <= x && own.y > y));
    const size = (dot) => Math.max(8, 36 * Math.sqrt(dot.size / (dots[0].size || Infinity)));
    const series = dots.map((dot) => {
      const filter = () => rows.flatMap((row, i) => (row.dot === dot && row.is_dot ? [i] : []));
      const color = color_of(dot.color);
      return curve(color, {label: `${dot.name}: ${dot.note}`, points: markers(`${color}bf`, size(dot), {filter})});
    });
    plot(holder, {
      width, height: 320, title: spec.y_label, cursor: {show: false}, legend: {...legend, live: false},
      scales: {x: {time: false, range: (u, low, high) => [0, 1.08 * high || 1]}, y: {range: padded(false)}},
      axes: [{label: spec.x_label, grid: {}}],
      series: [{}, curve(tone("c9"), {dash: [4 * ratio, 4 * ratio]}), ...series],
    }, [rows.map(({dot}) => dot.x), values(({dot, is_dot}) => is_dot && !is_beaten(dot)),
        ...dots.map((dot) => values((row) => row.dot === dot))]);
  }

  const kKinds = {lines, bars, histograms, scatter};

  function redraw(holder) {
    const own = specs.get(holder), {left, top} = own.plots[0]?.cursor || {left: -10, top: -10};
    own.width = holder.clientWidth;
    for (const made of own.plots.splice(0)) made.destroy();
    holder.replaceChildren();
    holder.className = `holder ${own.spec.small ? "small" : own.kind}`;
    holder.setAttribute("role", "img");
    holder.setAttribute("aria-label", own.spec.title);
    kKinds[own.kind](holder, own.spec, ratio > 1 ? kPrintWidth : own.width || 720);
    queueMicrotask(() => own.plots[0]?.setCursor({left, top}));  // after uPlot has scaled it
  }

  /// Redraws charts whose width has changed. Makes scrollable elements reachable with the keyboard.
  function fit() {
    for (const own of document.querySelectorAll(".scroll")) {
      own.tabIndex = own.scrollWidth > own.clientWidth || own.scrollHeight > own.clientHeight ? 0 : -1;
    }
    for (const [holder, {width}] of specs) {
      if (holder.clientWidth > 0 && holder.clientWidth !== width) redraw(holder);
    }
  }

  /// Redraws all charts with the colours of the style, for the screen or for print.
  function restyle(is_print) {
    ratio = is_print ? 3 : 1;
    document.documentElement.classList.toggle("print", is_print);
    for (const holder of specs.keys()) redraw(holder);
  }
  window.addEventListener("resize", fit);
  window.addEventListener("beforeprint", () => restyle(true));
  window.addEventListener("afterprint", () => restyle(false));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => restyle(ratio > 1));
  document.addEventListener("toggle", fit, true);  // a section was unfolded

  /// Draws a chart in an element, or redraws it with other values.
  function show(holder, kind, spec) {
    specs.set(holder, {plots: specs.get(holder)?.plots || [], kind, spec});
    redraw(holder);
  }

  /// Functions that return the head and rows of the table of a chart's values.
  const kValues = {
    lines: ({series, format = figure_text}) => {
      const maps = series.map((own) => new Map(own.points)), kMost = 40;
      const xs = [...new Set(series.flatMap((own) => own.points.map((p) => p[0])))].sort((a, b) => a - b);
      const every = Math.ceil(xs.length / kMost);
      const chosen = xs.filter((x, i) => (xs.length - 1 - i) % every === 0);
      const text = (value) => (is_number(value) ? format(value) : "");
      return [["iteration", ...series.map((own) => own.name)],
              chosen.map((x) => [count_text(x), ...maps.map((map) => text(map.get(x)))])];
    },
    bars: (spec) => [["", ...spec.rows.map((row) => (spec.rows.length > 1 ? `${row.name}, ${spec.unit}` : spec.unit))],
                     spec.parts.map((name, i) => [name, ...spec.rows.map((row) => row.values[i].toFixed(3))])],
    histograms: (spec) => {
      const all = percentages(spec);
      return [[spec.item, ...spec.panels.map((panel) => panel.name)],
              all[0].map((_, bin) => [bin_text(bin), ...all.map((values) => `${figure_text(values[bin])} %`)])];
    },
    scatter: (spec) => [["", spec.x_label, spec.y_label, spec.size_label], spec.dots.map((dot) =>
        [dot.name, dot.x.toFixed(2), dot.y.toFixed(2), count_text(dot.size)])],
  };

  /// Returns a chart with its caption, and a table of its values to unfold.
  function figure(kind, spec, caption) {
    const holder = element("div"), [head, rows] = kValues[kind](spec);
    const made = element("figure", {}, holder, element("figcaption", {}, caption),
                         element("details", {class: "values"}, element("summary", {}, "Values"), table(head, rows)));
    show(holder, kind, spec);
    return made;
  }

  return {show, figure, fit, plots: (holder) => specs.get(holder).plots};
})();
