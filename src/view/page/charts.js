// A line chart of [iteration, value] points on a canvas, with the range of its values at the right.
function draw_chart(canvas, points, format) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (width === 0) return;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = "10px system-ui, sans-serif";
  context.fillStyle = "#9a9ea6";
  if (points.length < 2) {
    context.fillText("no values yet", 4, height / 2);
    return;
  }
  const values = points.map((point) => point[1]);
  const sorted = [...values].sort((a, b) => a - b);
  const low = sorted[0], high = sorted[Math.ceil(0.99 * (sorted.length - 1))];  // a first loss may tower over all others
  const first = points[0][0], last = points[points.length - 1][0];
  const right = width - 52;
  const x = (iteration) => 1 + (right - 2) * (iteration - first) / Math.max(1, last - first);
  const y = (value) => height - 4 - (height - 8) * Math.min(1, (value - low) / (high - low || 1));
  context.strokeStyle = "#33363b";
  context.strokeRect(0.5, 0.5, right - 1, height - 1);
  context.strokeStyle = "#6cb2f5";
  context.lineWidth = 1.5;
  context.beginPath();
  for (const [iteration, value] of points) context.lineTo(x(iteration), y(value));
  context.stroke();
  context.textAlign = "right";
  context.fillText(format(high), width, 10);
  context.fillText(format(low), width, height - 2);
}
