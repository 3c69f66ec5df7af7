// Runs in the browser when the document is ready and whenever `texts` change.
// texts: content of the page; choices: what its reader has chosen, and marked: his last mark, which
// go back to the server.
const at = (id) => document.getElementById(id);
// A number keeps its unit on its line.
const unbroken = (text) => text.replace(/(\d) (?=(%|[mµ]?s|m?N|ppm)(\W|$)|\/min)/g, "$1\u00a0");
const write = (id, text) => {
  const whole = unbroken(text);
  if (at(id).textContent !== whole) at(id).textContent = whole;
};
const [shown] = texts.data.shown;
const choose = (change) => {
  hideReadOuts();
  choices.data = { ...choices.data, ...change };
};
const element = (kind, text, attributes = {}) => {
  const made = document.createElement(kind);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
};

function begin() {
  at("pause").addEventListener("click", () => {
    const paused = at("pause").getAttribute("aria-pressed") !== "true";
    at("pause").setAttribute("aria-pressed", paused);
    write("pause", paused ? "Resume" : "Pause");
    at("explore").hidden = !paused;
    // In a pause the wheel zooms, a drag moves, and the pointer shows values.
    for (const root of Bokeh.documents[0].roots()) {
      for (const tool of root.toolbar?.tools ?? []) tool.active = paused;
      // A finger that moves up or down scrolls the page all the same.
      const hits = Bokeh.index.get_one(root)?.canvas?.events_el;
      if (hits) hits.style.touchAction = paused ? "pan-y" : "";
    }
    choose({ paused: [paused] });
  });
  const mark = (event) => {
    event.preventDefault();
    marked.data = { number: [marked.data.number[0] + 1], text: [at("mark-text").value] };
    at("mark-text").value = "";
  };
  at("mark").addEventListener("submit", mark);
  document.addEventListener("keydown", (event) => {
    const typing = event.target.matches("input[type=text]") || event.repeat;
    if (event.key === "m" && !typing && !event.ctrlKey && !event.metaKey && !event.altKey) mark(event);
  });
  for (const choice of document.querySelectorAll("input[name=window]")) {
    choice.addEventListener("change", () => choose({ window_s: [Number(choice.value)] }));
    // Also where it is the present one: a reader may have zoomed.
    choice.addEventListener("click", () => {
      const times = Bokeh.documents[0].get_model_by_name("force").x_range;
      times.setv({ start: -Number(choice.value), end: 0 });
      hideReadOuts();
    });
    // A browser keeps the choice when the page is loaded again.
    if (choice.checked) choose({ window_s: [Number(choice.value)] });
  }
  beginReadOuts(() => at("pause").getAttribute("aria-pressed") === "true");
  // Plots take their colours from the style sheet when they are drawn.
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const root of cb_obj.document?.roots() ?? []) Bokeh.index.get_one(root)?.request_repaint();
  });
  document.body.dataset.ready = "yes";
}

// An alarm that lasts keeps its element: it is announced once, however its text counts on.
function showAlarms(list) {
  const old = new Map([...at("alarms").children].map((item) => [item.dataset.name, item]));
  for (const [index, [name, broken]] of list.entries()) {
    const text = unbroken(broken);
    let item = old.get(name);
    if (!item) {
      item = document.createElement("li");
      item.dataset.name = name;
      item.append(document.createElement("strong"), " – ", document.createElement("span"));
      item.firstChild.textContent = name;
      at("alarms").insertBefore(item, at("alarms").children[index] ?? null);
    }
    old.delete(name);
    if (item.lastChild.textContent !== text) item.lastChild.textContent = text;
  }
  for (const item of old.values()) item.remove();
}

function showEvents(events) {
  const key = JSON.stringify(events);
  if (at("events").dataset.key === key) return;
  at("events").dataset.key = key;
  at("events").replaceChildren(...events.map(([when_ms, kind, text]) => {
    const item = document.createElement("li"), time = document.createElement("time");
    time.textContent = new Date(when_ms).toLocaleTimeString("en-GB");
    item.className = kind;
    item.append(time, unbroken(text));
    return item;
  }));
}

// A choice for each of several contactors; its element stays while their names do.
function offerContactors(names) {
  for (const part of document.querySelectorAll("#contactor, .several")) {
    part.hidden = names.length < 2;
  }
  const group = at("contactor"), key = JSON.stringify(names);
  if (names.length < 2 || group.dataset.key === key) return;
  group.dataset.key = key;
  group.replaceChildren(group.firstElementChild, ...names.map((name, index) => {
    const label = document.createElement("label");
    const choice = element("input", "", { type: "radio", name: "contactor", value: index });
    choice.checked = index === 0;
    choice.addEventListener("change", () => choose({ contactor: [index] }));
    label.append(choice, element("span", name));
    return label;
  }));
  at("fingers-keys").replaceChildren(...names.map((name, index) => {
    const item = document.createElement("span");
    item.append(element("i", "", { style: `color: ${shown.colours[index]}; border-top: 3px solid` }), name);
    return item;
  }));
  choose({ contactor: [0] });
}

function showContactors(rows) {
  const table = at("contactors"), titles = [...document.querySelectorAll(".contactors th")];
  while (table.rows.length > rows.length) table.lastElementChild.remove();
  for (const [index, texts] of rows.entries()) {
    const row = table.rows[index] ?? table.appendChild(element("tr", "", { role: "row" }));
    if (index === shown.chosen) row.setAttribute("aria-current", "true");
    else row.removeAttribute("aria-current");
    for (const [place, text] of texts.entries()) {
      const label = titles[place].textContent;
      const cell = row.cells[place] ?? row.appendChild(
        element("td", "", { role: place ? "cell" : "rowheader", "data-label": label }));
      const whole = unbroken(text);
      if (cell.textContent !== whole) cell.textContent = whole;
    }
  }
}

if (!document.body.dataset.ready) begin();
if (shown) {
  write("stream", shown.stream);
  write("state", shown.state);
  write("state-note", shown.note);
  at("state").dataset.state = shown.state;
  document.body.classList.toggle("old", shown.old);
  for (const [id, [value, note]] of Object.entries(shown.figures)) {
    write(id, value);
    write(`${id}-note`, note);
    // A figure without a value and a note does not apply to this display.
    at(id).parentElement.hidden = value === "–" && !note;
  }
  for (const plot of document.querySelectorAll(".plots > figure")) {
    const id = plot.id.replace("plot-", ""), why = plot.querySelector(".empty");
    plot.hidden = shown.hidden.includes(id);
    if (why) why.hidden = !shown.empty.includes(id);
  }
  const names = shown.contactors.map(([name]) => name), chosen = names[shown.chosen];
  offerContactors(names);
  showContactors(shown.contactors);
  write("beyond", shown.beyond);
  for (const title of document.querySelectorAll("h2 .of")) {
    title.textContent = chosen === undefined ? "" : ` – ${chosen}`;
  }
  showAlarms(shown.alarms);
  showEvents(shown.events);
  // After what waits to be drawn: the server sends no more before this.
  setTimeout(() => { choices.data = { ...choices.data, seen: [shown.number] }; });
}
