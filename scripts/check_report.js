// Checks a report from inside, at its current width. check_report.sh adds this to a copy. Sends its findings, and the
// text that the page shows, to the page around it.
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
      const svg = figure.querySelector("svg"), name = svg ? svg.getAttribute("aria-label") : "?";
      expect(svg && svg.querySelector("polyline, polygon, circle, rect"), `${name}: nothing is drawn`);
      for (const part of svg ? svg.querySelectorAll("*") : []) {
        const values = [...part.attributes].map((own) => own.value).join(" ") + part.textContent;
        expect(!/NaN|undefined|Infinity|\bnull\b/.test(values), `${name}: <${part.tagName}> has ${values}`);
        const box = part.getBoundingClientRect();
        expect(part.tagName === "title" || (box.left >= -1 && box.right <= innerWidth + 1),
               `${name}: "${part.textContent}" is cut off`);
      }
      expect(svg && Math.abs(svg.getBoundingClientRect().width - svg.viewBox.baseVal.width) < 2,
             `${name}: is drawn for another width`);
      const rows = [...figure.querySelectorAll(".values tbody tr")];
      expect(rows.length > 0 && rows.every((row) => /\d/.test(row.textContent)), `${name}: has no table of values`);
    }
    const text = document.getElementById("report").innerText;
    expect(!/NaN|undefined|Infinity|\[object/.test(text), "the text has a value that is no number");
    for (const picture of document.images) expect(picture.naturalWidth > 0, `no picture: ${picture.alt}`);
    const drawn = [...document.querySelectorAll("svg text, svg title")].map((own) => own.textContent).join("\n");
    parent.postMessage({faults, text: `${figures.length} charts\n${text}\n${drawn}`}, "*");
  }, 500);
});
