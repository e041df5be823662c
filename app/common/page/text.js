// Numbers as text, and HTML elements. Texts become text nodes, so they are never parsed as HTML.

const count_text = (n) => Math.round(n).toLocaleString("en-US");

/// Formats a number with three significant digits.
function figure_text(value) {
  const size = Math.abs(value);
  if (size >= 1e7) return `${(value / 1e6).toFixed(1)} M`;
  if (size >= 1000) return count_text(value);
  if (Number.isInteger(value)) return String(value);
  return value.toFixed(Math.min(6, Math.max(0, 2 - Math.floor(Math.log10(size)))));
}

const percent_text = (share) => `${(100 * share).toFixed(1)} %`.replace(/^-(0\.0 %)$/, "$1");

function element(name, attributes = {}, ...content) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...content);
  return made;
}

/// Returns a table of texts. The first of a row names it. `head` may be empty. Words are aligned to the left, figures
/// to the right.
function table(head, rows, {words = false, marked = -1} = {}) {
  const row = (scope, texts) => element("tr", {}, ...texts.map((text, i) =>
      (scope === "row" && i > 0 ? element("td", {}, text) : element("th", {scope}, text))));
  const made = element("table", {class: (words ? "words" : "figures") + (head.length > 8 ? " dense" : "")});
  if (head.length > 0) made.append(element("thead", {}, row("col", head)));
  const body = element("tbody", {}, ...rows.map((texts) => row("row", texts)));
  if (marked >= 0) body.children[marked].className = "marked";
  made.append(body);
  return element("div", {class: "scroll", role: "group", "aria-label": "table"}, made);
}
