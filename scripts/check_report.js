// Checks a report from inside, at its current width. check_report.sh adds this to a copy. Sends its findings, and the
// text that the page shows, to the page around it.
const kNoNumber = /NaN|undefined|Infinity|\[object/;

/// Every curve has values with a place in the chart, the colour of one is seen, and no text touches an edge.
function check_plot(plot, name, expect) {
  const {width, height} = plot.ctx.canvas, {data} = plot.ctx.getImageData(0, 0, width, height);
  const seen = (x, y) => data[4 * (y * width + x) + 3] > 0;
  const has_color = (text) => {
    const rgb = text.match(/\w\w/g).slice(0, 3).map((digits) => parseInt(digits, 16));
    return data.some((_, i) => i % 4 === 3 && data[i] > 30 && rgb.every((c, k) => Math.abs(c - data[i - 3 + k]) < 9));
  };
  const places = plot.data.slice(1).map((ys) => ys.filter((y) => y !== undefined).map((y) => plot.valToPos(y, "y")));
  expect(places.every((all) => all.length > 0 && all.every(Number.isFinite)), `${name}: a value has no place`);
  expect(plot.series.slice(1).some(({mark}) => has_color(mark)), `${name}: no curve is seen`);
  const is_cut = [...Array(height).keys()].some((y) => seen(0, y) || seen(width - 1, y)) ||
                 [...Array(width).keys()].some((x) => seen(x, 0) || seen(x, height - 1));
  expect(!is_cut, `${name}: a text is cut off`);
}

window.addEventListener("error", (event) => parent.postMessage({faults: [event.message], text: ""}, "*"));
window.addEventListener("load", () => {
  for (const section of document.querySelectorAll("details")) section.open = true;
  setTimeout(() => {
    const faults = [], figures = [...document.querySelectorAll("figure")];
    const expect = (is_true, fault) => { if (!is_true) faults.push(fault); };
    expect(document.querySelector("h1"), "the page has no heading");
    expect(figures.length > 0, "the page has no charts");
    const width = document.documentElement.scrollWidth;
    expect(width <= innerWidth, `the page is ${width} px wide in a window of ${innerWidth} px`);
    for (const figure of figures) {
      const holder = figure.querySelector(".holder"), name = holder.getAttribute("aria-label");
      const plots = Charts.plots(holder), bars = holder.querySelectorAll(".stack > span");
      expect(plots.length > 0 || bars.length > 0, `${name}: nothing is drawn`);
      for (const plot of plots) check_plot(plot, name, expect);
      for (const part of holder.querySelectorAll("div, span, th, td")) {
        expect(!kNoNumber.test(part.textContent + part.title), `${name}: <${part.tagName}> has ${part.textContent}`);
        const box = part.getBoundingClientRect();
        expect(box.left >= -1 && box.right <= innerWidth + 1, `${name}: "${part.textContent}" is cut off`);
      }
      expect(holder.scrollWidth <= holder.clientWidth && (plots.length !== 1 || plots[0].width === holder.clientWidth),
             `${name}: is drawn for another width`);
      const rows = [...figure.querySelectorAll(".values tbody tr")];
      expect(rows.length > 0 && rows.every((row) => /\d/.test(row.textContent)), `${name}: has no table of values`);
    }
    const text = document.getElementById("report").innerText;
    expect(!kNoNumber.test(text), "the text has a value that is no number");
    for (const picture of document.images) expect(picture.naturalWidth > 0, `no picture: ${picture.alt}`);
    parent.postMessage({faults, text: `${figures.length} charts\n${text}`}, "*");
  }, 500);
});
