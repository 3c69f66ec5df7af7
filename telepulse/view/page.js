// Runs in the browser when the document is ready and whenever `texts` change.
// texts: what has changed on the page; choices: what its reader has chosen, and marked: his last
// mark, which go back to the server. colours: of several contactors.
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
  if (document.body.dataset.lost) return;
  choices.data = { ...choices.data, ...change };
};
const clock = (when_ms) => new Date(when_ms).toLocaleTimeString("en-GB");
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
  // Plots of folded groups are neither sent nor drawn.
  for (const group of document.querySelectorAll("details")) {
    group.addEventListener("toggle", () => {
      const open = [...document.querySelectorAll("details[open]")];
      choose({ unfolded: [open.map((each) => each.id.replace("group-", "")).join(" ")] });
    });
  }
  beginReadOuts(() => at("pause").getAttribute("aria-pressed") === "true");
  // Plots take their colours from the style sheet when they are drawn.
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const root of Bokeh.documents[0].roots()) Bokeh.index.get_one(root)?.request_repaint();
  });
  document.body.dataset.ready = "yes";
}

// An alarm that lasts keeps its element: it is announced once, however its text counts on.
function showAlarms(list) {
  const old = new Map([...at("alarms").children].map((item) => [item.dataset.identity, item]));
  for (const [index, [identity, name, broken]] of list.entries()) {
    const text = unbroken(broken);
    let item = old.get(identity);
    if (!item) {
      item = document.createElement("li");
      item.dataset.identity = identity;
      item.append(document.createElement("strong"), " – ", document.createElement("span"));
      item.firstChild.textContent = name;
      at("alarms").insertBefore(item, at("alarms").children[index] ?? null);
    }
    old.delete(identity);
    if (item.lastChild.textContent !== text) item.lastChild.textContent = text;
  }
  for (const item of old.values()) item.remove();
}

function showEvents(events) {
  at("events").replaceChildren(...events.map(([when_ms, kind, text]) => {
    const item = document.createElement("li"), time = document.createElement("time");
    time.textContent = clock(when_ms);
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
    item.append(element("i", "", { style: `color: ${colours[index]}; border-top: 3px solid` }), name);
    return item;
  }));
  choose({ contactor: [0] });
}

// Plots and figures that do not apply to this display are hidden, and groups with nothing else.
function showFigures(figures, hidden) {
  for (const [id, [value, note]] of Object.entries(figures)) {
    write(id, value);
    write(`${id}-note`, note);
    // A figure without a value and a note does not apply to this display.
    at(id).parentElement.hidden = value === "–" && !note;
  }
  for (const id of Object.keys(plots)) at(`plot-${id}`).hidden = hidden.includes(id);
  for (const group of document.querySelectorAll("details")) {
    const first = [...group.querySelectorAll("dl > div:not([hidden])")];
    const lead = first.find((each) => each.children[1].textContent !== "–");
    const [name, value] = lead ? [...lead.children].map((each) => each.textContent) : ["", ""];
    const title = group.querySelector("h2").textContent.toLowerCase();
    group.querySelector("summary .note").textContent = name === title ? value : `${name} ${value}`;
    const was = group.hidden;
    group.hidden = first.length === 0 && !group.querySelector("figure:not([hidden])");
    // Who presses watches the press.
    if (was && !group.hidden && group.id === "group-press") group.open = true;
  }
}

function showContactors(chosen, rows) {
  const names = rows.map(([name]) => name);
  offerContactors(names);
  for (const title of document.querySelectorAll(".of")) {
    title.textContent = names.length ? ` – ${names[chosen]}` : "";
  }
  const titles = [...document.querySelectorAll(".contactors th")].map((each) => each.textContent);
  at("contactors").replaceChildren(...rows.map((texts, index) => {
    const row = element("tr", "", { role: "row", "aria-current": index === chosen });
    row.append(...texts.map((text, place) => element("td", unbroken(text), {
      role: place ? "cell" : "rowheader", "data-label": titles[place],
    })));
    return row;
  }));
}

if (!document.body.dataset.ready) begin();
if (shown) {
  if ("stream" in shown) write("stream", shown.stream);
  if (shown.state) {
    const [state, note, ended_ms] = shown.state;
    write("state", state);
    write("state-note", ended_ms ? `at ${clock(ended_ms)}; ${note}` : note);
    at("state").dataset.state = state;
  }
  if ("old" in shown) document.body.classList.toggle("old", shown.old);
  if (shown.figures) showFigures(...shown.figures);
  for (const why of shown.empty ? document.querySelectorAll(".empty") : []) {
    why.hidden = !shown.empty.includes(why.parentElement.id.replace("plot-", ""));
  }
  if (shown.contactors) showContactors(...shown.contactors);
  if ("beyond" in shown) write("beyond", shown.beyond);
  if (shown.alarms) showAlarms(shown.alarms);
  if (shown.calm) {
    const [known, text] = shown.calm;
    write("calm", text);
    at("calm").classList.toggle("unknown", !known);
  }
  if (shown.events) showEvents(shown.events);
  // After what waits to be drawn: the server sends no more before this.
  setTimeout(() => { choices.data = { ...choices.data, seen: [shown.number] }; });
}
