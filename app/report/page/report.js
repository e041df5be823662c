// Builds the page from its data, and unfolds the sections for printing.
{
  const data = JSON.parse(document.getElementById("data").textContent);
  const [title, headline, parts] = data.kind === "comparison" ? comparison_page(data) : training_page(data);
  document.title = title;
  document.getElementById("report").replaceChildren(element("h1", {}, headline), ...parts.flat());
  Charts.fit();
  let unfolded = [];
  window.addEventListener("beforeprint", () => {
    unfolded = [...document.querySelectorAll(".folded:not([open])")];
    for (const own of unfolded) own.open = true;
  });
  window.addEventListener("afterprint", () => { for (const own of unfolded) own.open = false; });
}
