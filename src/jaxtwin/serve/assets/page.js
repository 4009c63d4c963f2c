// The page: the stream of the server, and commands for those who have the token.

import { make, numberText, setText, timeText, zoneName } from "./format.js";
import { Silence } from "./silence.js";
import { createView } from "./view.js";

const AGAIN_MS = 1000;

const token = {
  get: () => sessionStorage.getItem("jaxtwin-token") ?? "",
  set: (text) => sessionStorage.setItem("jaxtwin-token", text.trim()),
};
if (location.hash.length > 1) {
  token.set(decodeURIComponent(location.hash.slice(1)));
  window.history.replaceState(null, "", location.pathname);
}

// Head: names, clock, and the stop, which is the largest button.
const title = make("h1", {}, "jaxtwin");
const subtitle = make("p", { class: "subtitle" });
const clock = make("p", { class: "clock" });
const stop = make("button", { type: "button", class: "stop", hidden: true, click: () => command("stop", {}) }, "Stop");
const trouble = make("p", { class: "trouble", role: "alert", hidden: true });
const main = make("main");
const said = make("p", { class: "said", role: "status" });
const controlBox = make("section", { class: "card control", "aria-labelledby": "control-title", hidden: true });
const head = make("header", {}, make("div", {}, title, subtitle), clock, stop);
document.querySelector("#page").append(head, trouble, main,
  make("footer", {}, "Estimates are those of the twin; only what is called measured was measured."));

async function loadHistory(span) {
  const answer = await fetch(`/history?span=${span}`);
  if (!answer.ok) throw new Error(`/history: ${answer.status}`);
  return answer.json();
}

const view = createView(main, {
  uPlot: window.uPlot,
  aside: controlBox,
  history: loadHistory,
  twinAction: (kind, version) => command(kind, {
    promote: { version, reason: "promoted on the page" },
    rollback: { reason: "rolled back on the page" },
    refit: { seconds: 900 },
    acknowledge: {},
  }[kind]),
});

// Commands.
const field = make("input", { type: "password", id: "token", autocomplete: "off", change: () => token.set(field.value) });
const minutes = make("input", { type: "number", id: "minutes", min: "0.1", max: "1440", step: "any", value: "10" });
const reset = make("input", { type: "checkbox", id: "reset" });
const start = make("button", { type: "submit" }, "Start");
const state = make("p", { class: "state" });
// An empty or unreadable field is no zero.
const hold = make("button", { type: "button", click: () => {
  if (references.some((field) => field.value === "")) setText(said, "Give a temperature for each output.");
  else command("hold", { references: references.map((field) => Number(field.value)), ...howLong() });
} }, "Hold the temperatures");
let sliders = [], references = [];

const howLong = () => ({ seconds: 60 * Number(minutes.value), reset: reset.checked });

async function command(kind, content) {
  if (!token.get()) {
    controlBox.hidden = false;
    setText(said, "A command needs the token that the server printed when it began.");
    field.focus();
    return;
  }
  setText(said, kind === "stop" ? "Stopping …" : "…");
  try {
    const answer = await fetch(`/control/${kind}`, {
      method: "POST",
      headers: { "content-type": "application/json", authorization: `Bearer ${token.get()}` },
      body: JSON.stringify(content),
    });
    const { text, error } = await answer.json();
    setText(said, text ?? (kind === "stop" ? error : `Refused: ${error}`));
  } catch {
    setText(said, kind === "stop" ? "The server did not answer: stop the rig by hand." : "The server did not answer.");
  }
}

function buildControl(layout) {
  stop.hidden = !layout.is_live;
  const drive = layout.driven.map((part, k) => {
    const shown = make("output", { for: `duty-${k}` }, "0 %");
    const slider = make("input", {
      type: "range", id: `duty-${k}`, min: String(100 * part.lowest), max: "100", step: "1", value: "0",
      input: () => setText(shown, `${numberText(Number(slider.value), 0)} %`),
    });
    return { slider, row: make("div", { class: "row" }, make("label", { for: `duty-${k}` }, `Duty of ${part.name}`), slider, shown) };
  });
  sliders = drive.map(({ slider }) => slider);
  const outputs = layout.outputs ?? [];
  const given = references.map((field) => field.value);
  references = outputs.map((_, k) => make("input", {
    type: "number", id: `reference-${k}`, step: "0.1", value: given[k] ?? "",
  }));
  const form = make("form", {
    submit: (event) => {
      event.preventDefault();
      command("drive", { duty: sliders.map((slider) => Number(slider.value) / 100), ...howLong() });
    },
  },
    ...drive.map(({ row }) => row),
    start,
    ...outputs.map((name, k) => make("div", { class: "row" },
      make("label", { for: `reference-${k}` }, `Temperature of ${name}, °C`), references[k])),
    ...(outputs.length ? [hold] : []),
    make("div", { class: "row" }, make("label", { for: "minutes" }, "Minutes (of the rig)"), minutes),
    make("div", { class: "row" }, make("label", { for: "reset" }, "End a trip of the device first"), reset));
  controlBox.replaceChildren(make("h2", { id: "control-title" }, "Commands"),
    make("form", { class: "row", submit: (event) => event.preventDefault() },
      make("label", { for: "token" }, "Token"), field),
    ...(layout.control ? [state, form] : []), said);
  field.value = token.get();
  controlBox.hidden = !(layout.control || token.get()) || !layout.is_live;
}

function run({ state: now, duty, references: held, text }) {
  // What is driven already, unless somebody has moved a slider.
  if (duty && sliders.every((slider) => slider.value === "0")) {
    sliders.forEach((slider, k) => {
      slider.value = String(Math.round(100 * duty[k]));
      slider.dispatchEvent(new Event("input"));
    });
  }
  setText(start, now !== "idle" ? "Hold this duty instead" : "Drive with this duty");
  const what = duty?.map((part) => `${numberText(100 * part, 0)} %`) ?? held?.map((one) => `${numberText(one)} °C`);
  const asked = () => `${duty ? "driven" : "held"}: ${what.join(", ")}`;
  setText(state, now === "driving" ? `The rig is ${asked()}.`
    : now === "starting" ? `To be ${asked()}; the device has not acknowledged it yet.`
    : text ? `Not driven: ${text}.` : "Not driven.");
}

// The stream. Browsers allow six connections to a host, so that a hidden page has none.
let source = null, last = "", server = "", layoutText = "";
const silence = new Silence((isSilent) => {
  trouble.hidden = !isSilent || document.hidden;
  if (isSilent) setText(trouble, "No connection to the server. All values are old; trying again …");
});

function take(kind, event) {
  silence.hear();
  if (event.lastEventId) last = event.lastEventId;
  const content = JSON.parse(event.data);
  if (kind === "hello") {
    const isNew = server && content.server !== server;
    server = content.server;
    // Layout comes right after it.
    queueMicrotask(() => setTimeout(() => view.load(isNew).catch(() => {}), 0));
    return;
  }
  if (kind === "layout" && event.data !== layoutText) {
    layoutText = event.data;
    document.title = `${content.rig} · jaxtwin`;
    setText(title, content.title || content.rig);
    const recorded = content.recording ? ` · recorded into ${content.recording}` : " · not recorded";
    setText(subtitle, `${content.rig} · ${content.source}${content.is_live ? recorded : ""} · twin: ${content.twin}`);
    buildControl(content);
  }
  if (kind === "run") run(content);
  if (kind === "sample") setText(clock, `${timeText(content.t)} ${zoneName()}`);
  view.take(kind, content);
}

function open() {
  if (source || document.hidden) return;
  source = new EventSource(last ? `/events?after=${encodeURIComponent(last)}` : "/events");
  const kinds = ["hello", "layout", "sample", "outlook", "story", "findings", "diagnosis", "twins", "run", "log"];
  for (const kind of kinds) source.addEventListener(kind, (event) => take(kind, event));
  source.addEventListener("error", () => {
    close();
    setTimeout(open, AGAIN_MS);
  });
}

function close() {
  source?.close();
  source = null;
}

document.addEventListener("visibilitychange", () => (document.hidden ? close() : open()));
open();
