// Runs in the browser when the document is ready and whenever `texts` change.
// texts: content of the page; choices: what its reader has chosen, which goes back to the server.
const at = (id) => document.getElementById(id);
const write = (id, text) => { if (at(id).textContent !== text) at(id).textContent = text; };
const [shown] = texts.data.shown;

function begin() {
  const choose = (change) => { choices.data = { ...choices.data, ...change }; };
  at("pause").addEventListener("click", () => {
    const paused = at("pause").getAttribute("aria-pressed") !== "true";
    at("pause").setAttribute("aria-pressed", paused);
    write("pause", paused ? "Go on" : "Pause");
    choose({ paused: [paused] });
  });
  for (const choice of document.querySelectorAll("input[name=window]")) {
    choice.addEventListener("change", () => choose({ window_s: [Number(choice.value)] }));
    // A browser keeps the choice when the page is loaded again.
    if (choice.checked) choose({ window_s: [Number(choice.value)] });
  }
  // Plots take their colours from the style sheet when they are drawn.
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const root of cb_obj.document?.roots() ?? []) Bokeh.index.get_one(root)?.request_repaint();
  });
  document.body.dataset.ready = "yes";
}

// An alarm that lasts keeps its element: it is announced once, however its text counts on.
function showAlarms(list) {
  const old = new Map([...at("alarms").children].map((item) => [item.dataset.name, item]));
  for (const [index, [name, text]] of list.entries()) {
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
  at("events").replaceChildren(...events.map(([when_ms, level, text]) => {
    const item = document.createElement("li"), time = document.createElement("time");
    time.textContent = new Date(when_ms).toLocaleTimeString("en-GB");
    item.className = level;
    item.append(time, text);
    return item;
  }));
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
  }
  showAlarms(shown.alarms);
  showEvents(shown.events);
  // After what waits to be drawn: the server sends no more before this.
  setTimeout(() => { choices.data = { ...choices.data, seen: [shown.number] }; });
}
