// Points of the surface that are clicked: their coordinates, the distance of the last two, and the option that makes it
// true.
const picks = [];  // the last two, in coordinates of files
let pick = null;  // the place in the picture whose point is awaited, [0, 1] x [0, 1]

function pick_at(event) {
  if (!image || shown_mode === "photograph" || mode === "photograph") return;
  const box = picture.getBoundingClientRect(), scale = Math.min(box.width / image.width, box.height / image.height);
  const place = [(event.clientX - box.left - box.width / 2) / (scale * image.width) + 0.5,
                 (event.clientY - box.top - box.height / 2) / (scale * image.height) + 0.5];
  if (place.some((x) => !(x >= 0 && x <= 1))) return;
  pick = place;
  renew();
}

function add_pick(point) {
  if (point) picks.push(point);
  if (picks.length > 2) picks.shift();
  show_picks(point ? "" : "no surface here");
}

function show_picks(trouble = "") {
  const text = (x) => String(Number(x.toPrecision(7))), last = picks[picks.length - 1];
  const length = picks.length === 2 ? norm(sub(picks[0], picks[1])) : 0;
  const true_length = $("true_distance").valueAsNumber;
  show_text("point", trouble || last.map(text).join(", "));
  show_text("apart", length > 0 ? text(length) + (scene.metric ? " m" : "") : "-");
  show_text("scale", length > 0 && true_length > 0 ? `--scale=${[...picks.flat(), true_length].map(text).join(",")}` : "");
}
