// The server of the page has gone: what was last seen stays.
document.getElementById("state").textContent = "ended";
document.getElementById("state").dataset.state = "ended";
document.getElementById("state-note").textContent =
  "nothing feeds this page any more: it shows the last state";
