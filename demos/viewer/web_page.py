"""The page that a browser shows: a sentence, the picture, and the controls, in one column on a phone."""

from __future__ import annotations

import json

from .style import ACCENT, FAINT, IDLE, INK, ON_INK, OVER, PAPER

_PAGE_COLOURS = {
    "PAPER": PAPER,
    "ACCENT": ACCENT,
    "FAINT": FAINT,
    "IDLE": IDLE,
    "ON_INK": ON_INK,
    "OVER": OVER,
    "INK": INK,
}


def demo_page(keys: dict[str, str], tall: float) -> str:
    """The page.

    Args:
        keys: Names in the window of a browser's keys.
        tall: Height of the picture with everything on a phone, in its widths.
    """
    text = _PAGE
    for name, colour in _PAGE_COLOURS.items():
        text = text.replace(f"--{name}--", colour)
    return text.replace("--TALL--", f"{100 * tall:.0f}vw").replace("--KEYS--", json.dumps(keys))


_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>partdr demo</title>
<link rel="icon" href="data:,">
<style>
* { box-sizing: border-box; }
html { height: 100%; }
body { margin: 0; height: 100%; font: 16px/1.35 system-ui, sans-serif; color: --INK--; background: --PAPER--; }
#page { height: 100dvh; display: flex; flex-direction: column; padding: 0 12px 10px; max-width: 1400px; margin: auto; }
#above p { margin: 10px 0 8px; font-size: 20px; text-align: center; min-height: 1.35em; }
#view { position: relative; flex: 1; min-height: 120px; touch-action: none; cursor: grab; user-select: none; }
#view img:not([src]) { display: none; }
#view img { position: absolute; inset: 0; width: 100%; height: 100%; pointer-events: none; }
.row { display: flex; flex-wrap: wrap; gap: 8px 10px; align-items: center; justify-content: center; margin: 8px 0 0; }
button { font: inherit; min-height: 44px; min-width: 44px; padding: 4px 16px; border: 0; border-radius: 8px; }
button { background: --IDLE--; color: --INK--; cursor: pointer; }
button:hover { background: --OVER--; }
button.on { background: --ACCENT--; color: --ON_INK--; }
.first button[data-text=play] { background: --ACCENT--; color: --ON_INK--; min-width: 96px; }
label { flex: 1 1 180px; max-width: 320px; display: grid; grid-template-columns: 1fr auto; font-size: 15px; }
.first label:only-of-type { max-width: 760px; }
label span { color: --FAINT--; }
input { grid-column: 1 / 3; width: 100%; height: 30px; margin: 0; accent-color: --ACCENT--; touch-action: pan-x; }
.label { color: --FAINT--; min-width: 86px; }
#busy { position: fixed; top: 45%; left: 50%; transform: translateX(-50%); padding: 8px 16px; border-radius: 8px; }
#busy { background: --ACCENT--; color: --ON_INK--; display: none; }
.more #view { flex: none; height: --TALL--; touch-action: pan-y; }
.more #page { height: auto; }
.more .row { justify-content: flex-start; }
.more p { margin: 6px 0 0; font-size: 15px; }
.more .label { flex-basis: 100%; margin-bottom: -6px; }
@media (min-width: 800px) {
  .more #page { height: 100dvh; display: grid; grid-template: auto 1fr / 400px 1fr; gap: 0 12px; max-width: none; }
  .more #view { grid-area: 1 / 2 / 3 / 3; height: auto; touch-action: none; }
  .more #below { overflow: auto; font-size: 14px; }
  .more button { min-height: 28px; min-width: 28px; padding: 2px 9px; font-size: 14px; border-radius: 6px; }
  .more .row { gap: 4px 5px; margin-top: 5px; }
  .more .label { flex-basis: 78px; min-width: 78px; margin: 0; font-size: 13px; }
  .more label { font-size: 13px; flex-basis: 170px; }
  .more input { height: 20px; }
  .more p { font-size: 14px; }
}
</style>
<body class="first">
<div id="page">
<div id="above"></div>
<div id="view"><img alt="The picture: the photo, and the body before it"></div>
<div id="below"></div>
</div>
<div id="busy">working ...</div>
<script>
const keys = --KEYS--, view = document.getElementById("view"), picture = view.querySelector("img");
const busy = document.getElementById("busy"), places = ["above", "below"].map(id => document.getElementById(id));
let more = false, socket = null, asked = 0, done = 0, held = null, shape = "", entries = [];

const tell = message => {  // a promise that is kept when it was done
  if (!socket || socket.readyState !== 1) return;
  const id = ++asked;
  socket.send(JSON.stringify({...message, id}));
  setTimeout(() => { if (done < id) busy.style.display = "block"; }, 600);
};
const answered = id => {
  done = Math.max(done, id || 0);
  if (done >= asked) { busy.style.display = "none"; if (next) { const message = next; next = null; tell(message); } }
};
let next = null;  // the newest of many messages, which waits until the last one was answered
const tellLater = message => { if (done >= asked) tell(message); else next = message; };
const look = () => tell({do: "look", visible: !document.hidden, more});
const show = now => {
  more = now;
  document.body.className = more ? "more" : "first";
  look();
  scrollTo(0, 0);
  awake();
};

// Controls: made anew where there are others, else changed in place.
const make = (entry, row, at, alone) => {
  if (entry.kind === "text") {
    const text = document.createElement(alone ? "p" : "span");
    if (!alone) text.className = "label";
    return text;
  }
  if (entry.kind === "button") {
    const button = document.createElement("button");
    button.dataset.text = button.textContent = entry.text;
    button.title = entry.hint + (entry.key ? ` (key: ${entry.key})` : "");
    button.onclick = () => {
      button.blur();
      if (entry.key === "h") show(!more); else tell({do: "click", more, row, at, text: entry.text});
    };
    return button;
  }
  const label = document.createElement("label"), slider = document.createElement("input");
  const span = document.createElement("span"), value = document.createElement("output");
  span.textContent = entry.text;
  slider.type = "range"; slider.min = entry.low; slider.max = entry.high; slider.step = "any";
  slider.oninput = () => {
    held = slider;
    tellLater({do: "slide", more, row, at, text: entry.text, value: +slider.value});
  };
  slider.onchange = () => setTimeout(() => { held = null; }, 300);
  label.append(span, value, slider);
  return label;
};
const arrange = told => {
  const rows = [...told.above, ...told.below];
  const kind = ({kind, text, hint, low, high}, row) => kind === "text" ? row.length === 1 : [text, hint, low, high];
  const now = JSON.stringify(rows.map(row => row.map(entry => kind(entry, row))));
  if (now !== shape) {
    shape = now; entries = [];
    places.forEach(place => place.replaceChildren());
    rows.forEach((row, index) => {
      const alone = row.length === 1 && row[0].kind === "text", line = document.createElement("div");
      if (!alone) line.className = "row";
      entries.push(row.map((entry, at) => make(entry, index, at, alone)));
      line.append(...entries[index]);
      places[index < told.above.length ? 0 : 1].append(line);
    });
  }
  rows.forEach((row, index) => row.forEach((entry, at) => {
    const made = entries[index][at];
    if (entry.kind === "text") made.textContent = entry.text;
    else if (entry.kind === "button") {
      made.classList.toggle("on", !!entry.colour);
      made.style.background = entry.colour;
      if (entry.text === "play") made.textContent = entry.colour ? "pause" : "play";
    } else {
      const [span, value, slider] = made.children;
      value.textContent = entry.shown;
      if (held !== slider) slider.value = entry.value;
    }
  }));
};
const connect = () => {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/messages`);
  socket.onopen = () => { asked = done = 0; look(); };
  socket.onmessage = event => {
    const told = JSON.parse(event.data);
    if ("above" in told) { if (told.more === more) arrange(told); } else answered(told.done || asked);
  };
  socket.onclose = () => setTimeout(connect, 1000);
};
connect();
document.addEventListener("visibilitychange", () => { look(); awake(); });

// Keys and the mouse.
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey || !(event.key in keys)) return;
  const on = document.activeElement.tagName;
  if (on === "BUTTON" && event.key === " " || on === "INPUT" && event.key.startsWith("Arrow")) return;
  event.preventDefault();  // F5 loads no page anew
  if (event.repeat) return;
  if (event.key === "h") show(!more); else tell({do: "press", key: keys[event.key]});
});
const size = () => {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [width, height] = [view.clientWidth, view.clientHeight].map(side => Math.round(side * ratio));
  return {width, height, zoom: ratio, more};
};
const mouse = (kind, event) => {
  const box = view.getBoundingClientRect();
  const x = (event.clientX - box.left) / box.width, y = (event.clientY - box.top) / box.height;
  return {do: "mouse", kind, x, y, shift: event.shiftKey, ...size()};
};
const fingers = new Map();
let apart = 0;
const gap = () => {
  const [one, other] = [...fingers.values()];
  return Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
};
view.addEventListener("pointerdown", event => {
  view.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, event);
  if (fingers.size === 1) tell(mouse("LeftButtonPress", event));
  if (fingers.size === 2) { tell(mouse("LeftButtonRelease", event)); apart = gap(); }
});
view.addEventListener("pointermove", event => {
  if (!fingers.has(event.pointerId)) return;
  fingers.set(event.pointerId, event);
  if (fingers.size === 1) tellLater(mouse("MouseMove", event));
  if (fingers.size === 2 && Math.abs(Math.log(gap() / apart)) > 0.1) {
    tell(mouse(gap() > apart ? "MouseWheelForward" : "MouseWheelBackward", event));
    apart = gap();
  }
});
const lift = event => {
  if (!fingers.delete(event.pointerId)) return;
  next = null;
  if (!fingers.size) tell(mouse("LeftButtonRelease", event));
};
view.addEventListener("pointerup", lift);
view.addEventListener("pointercancel", lift);
view.addEventListener("wheel", event => {
  event.preventDefault();
  tellLater(mouse(event.deltaY < 0 ? "MouseWheelForward" : "MouseWheelBackward", event));
}, {passive: false});

// Pictures: the next one is asked for when the last one is on the screen. A hidden page asks for none.
let wake = () => {}, stop = new AbortController();
const awake = () => { stop.abort(); wake(); };
new ResizeObserver(() => awake()).observe(view);
const watch = async () => {
  let shown = {number: 0, quality: 0, rate: 0}, last = "";
  for (;;) try {
    if (document.hidden) await new Promise(done => { wake = done; });
    await new Promise(done => setTimeout(done, 0));
    stop = new AbortController();
    const now = size(), begun = performance.now();
    if (JSON.stringify(now) !== last) shown = {...shown, number: 0, quality: 0};
    last = JSON.stringify(now);
    const body = JSON.stringify({...shown, ...now});
    const answer = await fetch("picture", {method: "POST", body, signal: stop.signal});
    const file = await answer.blob();
    if (!answer.ok) throw new Error(answer.status);
    const seconds = (performance.now() - begun) / 1000, told = JSON.parse(answer.headers.get("X-Picture"));
    const address = URL.createObjectURL(file);
    picture.src = address;
    await picture.decode().finally(() => URL.revokeObjectURL(address));
    shown = {number: told.number, quality: told.quality, rate: file.size / Math.max(seconds - told.waited, 0.001)};
  } catch (fault) { if (fault.name !== "AbortError") await new Promise(done => setTimeout(done, 1000)); }
};
watch();
</script>
</html>
"""
