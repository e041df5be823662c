// Charts as SVG, for reports and the live view. Colours are the classes c0 to c9 of style.css.
//   lines:      {title, y_label, series: [{name, color, points: [[x, y]], markers}], bands: [{name, color, opacity,
//               lower, upper}], events: [{x, label}], log, from_zero, height, columns}; x is the iteration, and
//               `columns` (as series) is what the table of values has instead of the series. With `small`: no axes,
//               only the range, in the text of `format`, which is at least 2 % of the largest value
//   bars:       {title, unit, parts: [name], rows: [{name, values}]}: stacked, one bar for each row
//   histograms: {title, x_label, item, panels: [{name, counts}]}: bin 0 is the value 0, bin k 2^(k-1) to 2^k - 1
//   scatter:    {title, x_label, y_label, size_label, dots: [{name, color, x, y, low, high, size}]}: areas stand for
//               sizes; the dashed line joins dots that no other one beats in both (less x, more y)
// Each kind has a function that draws it (kKinds) and one that lists its values (kValues).
const Charts = (() => {
  const kLeft = 58, kBottom = 38, kRight = 14;  // px around the plot
  const specs = new Map();  // charts by element: {kind, spec}

  const make = (name) => document.createElementNS("http://www.w3.org/2000/svg", name);

  function draw(parent, name, attributes = {}, text = null) {
    const made = make(name);
    for (const [key, value] of Object.entries(attributes)) {
      made.setAttribute(key, typeof value === "number" ? Math.round(10 * value) / 10 : value);
    }
    if (text !== null) made.textContent = text;
    parent.append(made);
    return made;
  }

  const is_number = (value) => typeof value === "number" && Number.isFinite(value);
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = `12px ${getComputedStyle(document.documentElement).fontFamily}`;  // as in style.css
  const text_width = (text) => pen.measureText(text).width;
  const name_width = (name) => 16 + text_width(name);  // with its mark
  const kNarrow = 560;  // px, as in style.css; below this width, names are in a legend
  const sum = (values) => values.reduce((total, value) => total + value, 0);

  /// Maps [low, high], widened by a margin and to 0 if `from_zero`, to pixels.
  function scale(values, from, to, {log = false, from_zero = false} = {}) {
    let low = Math.min(...values), high = Math.max(...values);
    if (!is_number(low) || !is_number(high)) [low, high] = log ? [1, 10] : [0, 1];
    if (log) {
      high = 1.1 * Math.max(high, 2 * low);
    } else {
      if (from_zero) [low, high] = [Math.min(low, 0), Math.max(high, 0)];
      const around = 0.01 * Math.abs(low) || 1;  // equal values
      if (high <= low) [low, high] = from_zero ? [0, 1] : [low - around, low + around];
      const room = 0.05 * (high - low);
      if (!from_zero || high > 0) high += room;
      if (!from_zero || low < 0) low -= room;
    }
    return plain_scale(low, high, from, to, log);
  }

  function plain_scale(low, high, from, to, log = false) {
    const at = (value) => {
      const share = log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low || 1);
      return from + share * (to - from);
    };
    return Object.assign(at, {low, high, log});
  }

  /// Returns about n round numbers on a scale, at least `min_step` apart.
  function ticks({low, high, log}, n, min_step = 0) {
    const found = [];
    if (log) {
      for (let power = 10 ** Math.floor(Math.log10(low)); power <= high; power *= 10) {
        for (const tick of high / low > 100 ? [power] : [power, 2 * power, 5 * power]) {
          if (tick >= 0.9999 * low && tick <= high) found.push(tick);
        }
      }
      return found;
    }
    const rough = (high - low) / Math.max(1, n), power = 10 ** Math.floor(Math.log10(rough));
    const step = Math.max(min_step, [1, 2, 5, 10].map((f) => f * power).find((s) => s >= 0.7 * rough));
    for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; ++i) found.push(i * step);
    return found;
  }

  function tick_text(value, step) {
    const digits = (s) => Math.min(9, Math.max(0, Math.ceil(-Math.log10(s) - 1e-9)));
    if (value === 0) return "0";
    if (Math.abs(value) >= 1e5 && step >= 1e5) return `${(value / 1e6).toFixed(Math.min(3, digits(step / 1e6)))} M`;
    return Math.abs(value) >= 1000 && step >= 1 ? count_text(value) : value.toFixed(digits(step));
  }

  function axes(svg, x, y, {left, right, top, bottom, y_label, x_label, x_step}) {
    const step = (all, i) => (y.log && all === y_ticks ? all[i] : all.length > 1 ? all[1] - all[0] : 1);
    const y_ticks = ticks(y, 5), x_ticks = ticks(x, Math.max(3, Math.floor((right - left) / 110)), x_step);
    draw(svg, "text", {x: 0, y: top - 14, class: "axis"}, y_label);
    y_ticks.forEach((tick, i) => {
      draw(svg, "line", {x1: left, x2: right, y1: y(tick), y2: y(tick), class: "grid"});
      draw(svg, "text", {x: left - 8, y: y(tick) + 4, class: "tick end"}, tick_text(tick, step(y_ticks, i)));
    });
    x_ticks.forEach((tick, i) => {
      draw(svg, "line", {x1: x(tick), x2: x(tick), y1: bottom, y2: bottom + 4, class: "base"});
      draw(svg, "text", {x: x(tick), y: bottom + 17, class: "tick middle"}, tick_text(tick, step(x_ticks, i)));
    });
    draw(svg, "line", {x1: left, x2: right, y1: bottom, y2: bottom, class: "base"});
    draw(svg, "text", {x: right, y: bottom + 33, class: "axis end"}, x_label);
  }

  /// Draws a text in `room` px. A longer text is cut, and its tooltip has all of it.
  function draw_short(svg, text, room, attributes) {
    let short = text;
    while (short.length > 2 && text_width(short) > room) short = `${short.slice(0, -2)}…`;
    const made = draw(svg, "text", attributes, short);
    if (short !== text) draw(made, "title", {}, text);
  }

  /// Draws a name beside a mark of its colour.
  function draw_name(svg, {name, color, opacity = 1}, x, y, room) {
    draw(svg, "rect", {x, y: y - 9, width: 11, height: 11, class: `c${color % 10}`, "fill-opacity": String(opacity)});
    draw_short(svg, name, room - 16, {x: x + 16, y, class: "name"});
  }

  /// Draws names with colours in lines of `width`. Returns the height.
  function legend(svg, entries, width) {
    let x = 0, y = 12;
    for (const entry of entries) {
      const needed = name_width(entry.name);
      if (x > 0 && x + needed > width) [x, y] = [0, y + 18];
      draw_name(svg, entry, x, y, width);
      x += needed + 18;
    }
    return entries.length > 0 ? y + 10 : 4;
  }

  /// Returns the means of at most 300 groups. The first and the last point do not change.
  function thinned(points) {
    if (points.length <= 300) return points;
    const inner = points.slice(1, -1), groups = [];
    for (let i = 0; i < 298; ++i) {
      const group = inner.slice(Math.floor(i * inner.length / 298), Math.floor((i + 1) * inner.length / 298));
      groups.push([sum(group.map((p) => p[0])) / group.length, sum(group.map((p) => p[1])) / group.length]);
    }
    return [points[0], ...groups, points[points.length - 1]];
  }

  const path = (points, x, y) => points.map(([px, py]) => `${x(px).toFixed(1)},${y(py).toFixed(1)}`).join(" ");

  function lines(svg, spec, width) {
    const can_be_drawn = ([x, y]) => is_number(x) && is_number(y) && (!spec.log || y > 0);
    const series = spec.series.map((own) => ({...own, points: thinned(own.points.filter(can_be_drawn))}));
    const bands = (spec.bands || []).map((own) => {
      // The lower edge of a logarithmic chart may be 0.
      const lift = ([x, y]) => [x, spec.log ? Math.max(y, 0.5) : y];
      return {...own, lower: own.lower.map(lift), upper: own.upper.map(lift)};
    });
    const widest = Math.max(0, ...series.map((own) => name_width(own.name)));
    const has_names = series.length > 1 || bands.length > 0 || !spec.title.startsWith(series[0].name);
    const is_direct = has_names && bands.length === 0 && series.length <= 4 && widest <= 216 && width > kNarrow;
    const has_legend = has_names && !is_direct;
    const top = spec.small ? 4 : 26 + legend(svg, has_legend ? [...bands, ...series] : [], width);
    const height = spec.height || 220, bottom = top + height - (spec.small ? 8 : kBottom);
    const left = spec.small ? 1 : kLeft, right = width - (spec.small ? 56 : is_direct ? widest + 10 : kRight);
    const all = [...series.map((own) => own.points), ...bands.flatMap((own) => [own.lower, own.upper])].flat();
    const xs = all.map((p) => p[0]), ys = all.map((p) => p[1]);
    const x = plain_scale(spec.small ? Math.min(...xs) : 0, Math.max(1, ...xs), left, right);
    let y = scale(ys, bottom, top, {log: spec.log, from_zero: spec.from_zero !== false});
    if (spec.small) {
      // A first loss may be far above all others.
      const sorted = [...ys].sort((a, b) => a - b), high = sorted[Math.ceil(0.99 * (sorted.length - 1))];
      const room = Math.max(0, 0.02 * Math.abs(high) - (high - sorted[0])) / 2;
      const fit = plain_scale(sorted[0] - room, high + room, bottom, top);
      y = Object.assign((value) => fit(Math.min(value, high)), fit);
      draw(svg, "rect", {x: 0.5, y: 0.5, width: right, height: height - 1, class: "frame"});
      draw(svg, "text", {x: width, y: 11, class: "tick end"}, spec.format(fit.high));
      draw(svg, "text", {x: width, y: height - 3, class: "tick end"}, spec.format(fit.low));
    } else {
      axes(svg, x, y, {left, right, top, bottom, y_label: spec.y_label, x_label: "iteration", x_step: 1});
    }
    for (const {lower, upper, color, opacity} of bands) {
      draw(svg, "polygon", {class: `c${color % 10}`, "fill-opacity": String(opacity),
                            points: path([...upper, ...[...lower].reverse()], x, y)});
    }
    const events = (spec.events || []).filter((event) => event.x <= x.high);
    for (const event of events) {
      draw(svg, "line", {x1: x(event.x), x2: x(event.x), y1: top, y2: bottom, class: "event"});
    }
    for (const {points, color, markers} of series) {
      draw(svg, "polyline", {class: `c${color % 10} curve`, points: path(points, x, y)});
      if (!markers && points.length > 1) continue;
      for (const [px, py] of points) draw(svg, "circle", {class: `c${color % 10}`, cx: x(px), cy: y(py), r: 3});
    }
    events.forEach((event, i) => {  // at the bottom, where there are rarely curves
      const fits = x(event.x) + 6 + text_width(event.label) < right;
      const at = {x: x(event.x) + (fits ? 5 : -5), y: bottom - 8 - 14 * (i % 4)};
      draw(svg, "text", {...at, class: fits ? "note" : "note end"}, event.label);
    });
    if (is_direct) label_ends(svg, series, y, right, bottom);
    svg.readout = {
      xs: [...new Set(series.flatMap((own) => own.points.map((p) => p[0])))], x,
      text: (at) => [`iteration ${count_text(at)}`, ...series.filter((own) => own.points.length > 0).map((own) => {
        const near = own.points.reduce((a, b) => (Math.abs(b[0] - at) > Math.abs(a[0] - at) ? a : b));
        return `${(spec.format || figure_text)(near[1])}  ${own.name}`;
      })].join("\n"),
    };
    return bottom + (spec.small ? 4 : kBottom);
  }

  /// Draws names at the ends of the curves, moved apart to avoid overlap.
  function label_ends(svg, series, y, right, bottom) {
    const labels = series.filter((own) => own.points.length > 0)
                       .map((own) => ({own, at: y(own.points[own.points.length - 1][1])})).sort((a, b) => a.at - b.at);
    for (let i = 1; i < labels.length; ++i) labels[i].at = Math.max(labels[i].at, labels[i - 1].at + 15);
    labels.reverse().forEach(({own, at}, i) => {
      draw_name(svg, own, right + 7, Math.min(at, bottom - 15 * i) + 4, Infinity);
    });
  }

  function bars(svg, spec, width) {
    const totals = spec.rows.map((row) => sum(row.values)), longest = Math.max(0, ...totals);
    let y = legend(svg, spec.parts.map((name, color) => ({name, color})), width) + 6;
    const is_above = width <= kNarrow, widest = Math.max(...spec.rows.map((row) => text_width(row.name)));
    const left = is_above || spec.rows.length < 2 ? 0 : Math.min(220, widest) + 14, right = width - 76;
    spec.rows.forEach((row, i) => {
      if (spec.rows.length > 1) {  // a single bar needs no name
        if (is_above) y += 14;
        const at = is_above ? {x: 0, y: y - 4, class: "label"} : {x: left - 10, y: y + 17, class: "label end"};
        draw_short(svg, row.name, is_above ? width : left - 10, at);
      }
      let at = left;
      row.values.forEach((value, part) => {
        const size = longest > 0 ? value / longest * (right - left) : 0;
        if (size <= 0) return;
        const bar = draw(svg, "rect", {x: at, y, width: Math.max(0.5, size - 1), height: 26, class: `c${part % 10}`});
        draw(bar, "title", {}, `${row.name}, ${spec.parts[part]}: ${figure_text(value)} ${spec.unit}`);
        if (size > text_width(figure_text(value)) + 8) {
          draw(svg, "text", {x: at + size / 2, y: y + 17, class: `c${part % 10} inside middle`}, figure_text(value));
        }
        at += size;
      });
      draw(svg, "text", {x: at + 6, y: y + 17, class: "label"}, `${figure_text(totals[i])} ${spec.unit}`);
      y += 36;
    });
    return y;
  }

  const bin_start = (bin) => (bin === 0 ? 0 : 2 ** (bin - 1));
  const bin_text = (bin) => figure_text(bin_start(bin)) + (bin < 2 ? "" : ` to ${figure_text(2 ** bin - 1)}`);
  const shares = (counts) => counts.map((n) => n / (sum(counts) || 1));

  function histograms(svg, spec, width) {
    const n_columns = Math.min(spec.panels.length, width > kNarrow ? 4 : 2), gap = 22;
    const n_bins = Math.max(1, ...spec.panels.map(({counts}) => counts.findLastIndex((n) => n > 0) + 1));
    const highest = Math.max(1e-9, ...spec.panels.flatMap(({counts}) => shares(counts)));
    const panel_width = (width - gap * (n_columns - 1)) / n_columns, step = panel_width / n_bins;
    const bottom_of = (i) => 150 + 176 * Math.floor(i / n_columns);
    spec.panels.forEach(({name, counts}, i) => {
      const left = (i % n_columns) * (panel_width + gap), bottom = bottom_of(i);
      draw(svg, "text", {x: left, y: bottom - 128, class: "label"}, name);
      shares(counts).forEach((share, bin) => {
        if (share <= 0) return;
        const height = Math.max(1, 120 * share / highest);
        const bar = draw(svg, "rect", {x: left + bin * step, y: bottom - height, width: Math.max(1, step - 1), height,
                                       class: "c0"});
        draw(bar, "title", {}, `${bin_text(bin)}: ${figure_text(100 * share)} %`);
      });
      draw(svg, "line", {x1: left, x2: left + panel_width, y1: bottom, y2: bottom, class: "base"});
      for (let bin = 1; bin < n_bins; bin += Math.max(1, Math.ceil(n_bins / 4))) {
        const text = figure_text(bin_start(bin)), x = left + bin * step;
        if (x + text_width(text) < left + panel_width + 8) draw(svg, "text", {x, y: bottom + 16, class: "tick"}, text);
      }
    });
    const bottom = bottom_of(spec.panels.length - 1);
    draw(svg, "text", {x: width, y: bottom + 34, class: "axis end"},
         `${spec.x_label}; highest bar ${figure_text(100 * highest)} %`);
    return bottom + 40;
  }

  function scatter(svg, spec, width) {
    const dots = spec.dots, kLargest = 18, top = 26 + legend(svg, dots, width);
    const bottom = top + 320 - kBottom, right = width - kRight, largest = Math.max(0, ...dots.map((dot) => dot.size));
    const radius = (dot) => (largest > 0 ? Math.max(4, kLargest * Math.sqrt(dot.size / largest)) : 4);
    const x = scale(dots.map((dot) => dot.x), kLeft, right - kLargest, {from_zero: true});
    const y = scale(dots.flatMap((dot) => [dot.low, dot.high]), bottom - kLargest, top + kLargest);
    axes(svg, x, y, {left: kLeft, right, top, bottom, y_label: spec.y_label, x_label: spec.x_label});
    let best = -Infinity;
    const front = [...dots].sort((a, b) => a.x - b.x || b.y - a.y).filter((dot) => {
      const is_above = dot.y > best;
      best = Math.max(best, dot.y);
      return is_above;
    });
    if (front.length > 1) {
      draw(svg, "polyline", {class: "c9 curve front", points: path(front.map((dot) => [dot.x, dot.y]), x, y)});
    }
    const drawn = [];
    for (const dot of [...dots].sort((a, b) => b.size - a.size)) {  // small ones last, so that none is hidden
      const own = {x: x(dot.x), y: y(dot.y)}, below = drawn.filter((b) => Math.hypot(b.x - own.x, b.y - own.y) < 4);
      own.r = Math.max(3, Math.min(radius(dot), ...below.map((b) => b.r - 4)));  // a ring of those below stays visible
      drawn.push(own);
      const color = `c${dot.color % 10}`;
      const range = path([[dot.x, dot.low], [dot.x, dot.high]], x, y);
      if (dot.low < dot.high) draw(svg, "polyline", {class: `${color} curve`, points: range});
      const circle = draw(svg, "circle", {class: `${color} dot`, cx: own.x, cy: own.y, r: own.r});
      draw(circle, "title", {}, `${dot.name}: ${dot.note}`);
    }
    return bottom + kBottom;
  }

  const kKinds = {lines, bars, histograms, scatter};

  function redraw(holder) {
    const {kind, spec} = specs.get(holder), width = holder.clientWidth || 720;
    const svg = make("svg");
    const height = kKinds[kind](svg, spec, width);
    for (const [key, value] of Object.entries({class: "chart", role: "img", "aria-label": spec.title,
                                               viewBox: `0 0 ${width} ${Math.ceil(height)}`})) {
      svg.setAttribute(key, value);
    }
    if (svg.readout) read_out(svg, width);
    holder.replaceChildren(svg);
  }

  /// Shows the values at the pointer.
  function read_out(svg, width) {
    svg.addEventListener("pointerleave", () => { hover.hidden = true; });
    svg.addEventListener("pointermove", (event) => {
      const {xs, x, text} = svg.readout, frame = svg.getBoundingClientRect();
      const px = (event.clientX - frame.left) * width / frame.width;
      if (xs.length === 0) return;
      if (!hover.isConnected) document.body.append(hover);
      hover.textContent = text(xs.reduce((a, b) => (Math.abs(x(b) - px) < Math.abs(x(a) - px) ? b : a)));
      hover.hidden = false;
      hover.style.left = `${Math.max(4, Math.min(event.clientX + 14, window.innerWidth - hover.offsetWidth - 8))}px`;
      hover.style.top = `${Math.min(event.clientY + 14, window.innerHeight - hover.offsetHeight - 8)}px`;
    });
  }
  const hover = element("div", {class: "hover"});
  hover.hidden = true;

  /// Redraws charts whose width has changed. Makes scrollable elements reachable with the keyboard.
  function fit() {
    for (const own of document.querySelectorAll(".scroll")) {
      own.tabIndex = own.scrollWidth > own.clientWidth || own.scrollHeight > own.clientHeight ? 0 : -1;
    }
    for (const holder of specs.keys()) {
      const drawn_for = holder.firstElementChild.viewBox.baseVal.width;
      if (holder.clientWidth > 0 && drawn_for !== holder.clientWidth) redraw(holder);
    }
  }
  window.addEventListener("resize", fit);
  document.addEventListener("toggle", fit, true);  // a section was unfolded

  /// Draws a chart in an element, or redraws it with other values.
  function show(holder, kind, spec) {
    specs.set(holder, {kind, spec});
    redraw(holder);
  }

  /// Functions that return the head and rows of the table of a chart's values.
  const kValues = {
    lines: (spec) => {
      const columns = spec.columns || spec.series, kMost = 40;
      const maps = columns.map((own) => new Map(own.points));
      const xs = [...new Set(columns.flatMap((own) => own.points.map((p) => p[0])))].sort((a, b) => a - b);
      const every = Math.ceil(xs.length / kMost);
      const chosen = xs.filter((x, i) => (xs.length - 1 - i) % every === 0);
      const text = (value) => (is_number(value) ? (spec.format || figure_text)(value) : "");
      return [["iteration", ...columns.map((own) => own.name)],
              chosen.map((x) => [count_text(x), ...maps.map((map) => text(map.get(x)))])];
    },
    bars: (spec) => [["", ...spec.rows.map((row) => (spec.rows.length > 1 ? `${row.name}, ${spec.unit}` : spec.unit))],
                     spec.parts.map((name, i) => [name, ...spec.rows.map((row) => row.values[i].toFixed(3))])],
    histograms: (spec) => {
      const n = Math.max(0, ...spec.panels.map(({counts}) => counts.findLastIndex((count) => count > 0) + 1));
      const text = (counts, bin) => `${figure_text(100 * (shares(counts)[bin] || 0))} %`;
      return [[spec.item, ...spec.panels.map((panel) => panel.name)], Array.from({length: n}, (_, bin) =>
          [bin_text(bin), ...spec.panels.map(({counts}) => text(counts, bin))])];
    },
    scatter: (spec) => [["", spec.x_label, spec.y_label, spec.size_label], spec.dots.map((dot) =>
        [dot.name, dot.x.toFixed(2), dot.y.toFixed(2), count_text(dot.size)])],
  };

  /// Returns a chart with its caption, and a table of its values to unfold.
  function figure(kind, spec, caption) {
    const holder = element("div", {class: "holder"}), [head, rows] = kValues[kind](spec);
    const made = element("figure", {}, holder, element("figcaption", {}, caption),
                         element("details", {class: "values"}, element("summary", {}, "Values"), table(head, rows)));
    show(holder, kind, spec);
    return made;
  }

  return {show, figure, fit};
})();
