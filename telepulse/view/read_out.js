// Values under the pointer in a paused page: those of all curves of a plot at one time, or at one
// hold-down, and the events at a line.
// plots: by id, its group, whether it is across a hold-down, the unit of its values, and its curves.
// curves, events: sources of the data, by group; fingers: that of several contactors.
const NEAR_PX = 6, MOST_EVENTS = 4;

function hideReadOuts() {
  for (const box of document.querySelectorAll(".read-out")) box.hidden = true;
}

function number(value) {
  return String(Number(value.toPrecision(4))).replace("-", "−");
}

// Value of a line at x: that of the nearer neighbour, unless there is a gap; undefined without one.
// near: distance at which a curve's end or a gap's edge still counts.
function lineValue(t, y, x, near) {
  let after = 0;
  while (after < t.length && t[after] < x) after += 1;
  const sides = [after - 1, after].filter((index) => Number.isFinite(t[index]) && Number.isFinite(y[index]));
  sides.sort((one, other) => Math.abs(t[one] - x) - Math.abs(t[other] - x));
  const whole = sides.length === 2 || Math.abs(t[sides[0]] - x) <= near;
  return whole ? y[sides[0]] : undefined;
}

// Rows of a read-out, each a colour and a text.
function readOutRows(id, x, perPx) {
  const plot = plots[id], rows = [], unit = ` ${plot.unit}`, { data } = curves[plot.group];
  const place = (at) => (plot.across ? `${number(at)} N` : `${at.toFixed(3).replace("-", "−")} s`);
  const lines = plot.curves.map(({ name, words, colour, marker }) => ({
    words: words.split(":")[0], colour, marker, t: data[`${name}_t`], y: data[`${name}_y`],
  }));
  if (id === "fingers") {
    const names = [...document.querySelectorAll("#fingers-keys span")];
    for (const [index, colour] of [...fingers.data.colour].entries()) {
      const words = names[index].textContent;
      lines.push({ words, colour, t: fingers.data.t[index], y: fingers.data.y[index] });
    }
  }
  for (const { words, colour, marker, t, y } of lines) {
    const known = [...y.keys()].filter((index) => Number.isFinite(y[index]));
    if (known.length === 0) continue;
    if (marker) {
      const nearest = known.reduce((best, index) => (Math.abs(t[index] - x) < Math.abs(t[best] - x) ? index : best));
      rows.push([colour, `${words} ${number(y[nearest])}${unit}, at ${place(t[nearest])}`]);
    } else if (known.length > 1 && t[known[0]] === t[known.at(-1)]) {
      // A vertical line has a place, and no value.
      rows.push([colour, `${words} ${place(t[known[0]])}`]);
    } else {
      const value = lineValue(t, y, x, NEAR_PX * perPx);
      const text = value === undefined ? "–" : number(value) + unit;
      // A curve without words is the upper limit of the one before.
      if (words) rows.push([colour, `${words} ${text}`]);
      else rows.at(-1)[1] += ` to ${text}`;
    }
  }
  if (plot.across) return [["", `at ${place(x)}`], ...rows];
  const { t, text, colour } = events[plot.group].data;
  const met = [...t.keys()].filter((index) => Math.abs(t[index] - x) <= NEAR_PX * perPx);
  for (const index of met.slice(-MOST_EVENTS)) rows.push([colour[index], text[index]]);
  if (met.length > MOST_EVENTS) rows.push(["", `and ${met.length - MOST_EVENTS} events more`]);
  return [["", `at ${place(x)}`], ...rows];
}

function showReadOut(figure, clientX, clientY) {
  const id = figure.id.replace("plot-", ""), box = figure.querySelector(".read-out");
  const view = Bokeh.index.get_one(Bokeh.documents[0].get_model_by_name(id));
  const { left, top, width } = figure.querySelector(".drawn").getBoundingClientRect();
  const sx = clientX - left, { bbox, x_scale: scale } = view.frame;
  hideReadOuts();
  if (!bbox.contains(sx, clientY - top)) return;
  const x = scale.invert(sx), perPx = Math.abs(scale.invert(sx + 1) - x);
  box.replaceChildren(...readOutRows(id, x, perPx).map(([colour, text]) => {
    const row = element("li", unbroken(text));
    if (colour) row.style.borderLeft = `4px solid ${colour}`;
    return row;
  }));
  // The line is at the pointer, the texts on its side with more room.
  const right = sx < width / 2;
  box.classList.toggle("right", right);
  Object.assign(box.style, {
    left: right ? `${sx}px` : "", right: right ? "" : `${width - sx}px`,
    top: `${bbox.top}px`, minHeight: `${bbox.height}px`,
  });
  box.hidden = false;
}

function beginReadOuts(isPaused) {
  for (const figure of document.querySelectorAll("figure")) {
    const show = ({ clientX, clientY }) => {
      // After the plot itself, which may zoom or move.
      if (isPaused()) requestAnimationFrame(() => showReadOut(figure, clientX, clientY));
    };
    const drawn = figure.querySelector(".drawn"), early = { capture: true, passive: true };
    drawn.addEventListener("pointermove", (event) => { if (event.pointerType === "mouse") show(event); }, early);
    drawn.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse") hideReadOuts(); });
    // A finger taps; while it moves the plot or the page, there are no values.
    drawn.addEventListener("pointerdown", (event) => { if (event.pointerType !== "mouse") hideReadOuts(); }, early);
    drawn.addEventListener("click", show, early);
    drawn.addEventListener("wheel", show, early);
  }
}
