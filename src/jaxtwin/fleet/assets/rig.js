// The page of a rig of a fleet: the view of a rig, from frames that are asked for once a second.

import { make, setText, timeText, zoneName } from "/assets/format.js";
import { createView } from "/assets/view.js";

const POLL_MS = 1000;
const path = location.pathname;

const title = make("h1", {}, decodeURIComponent(path.split("/").at(-1)));
const subtitle = make("p", { class: "subtitle" });
const clock = make("p", { class: "clock" });
const trouble = make("p", { class: "trouble", role: "alert", hidden: true });
const said = make("p", { class: "said", role: "status" });
const refit = make("button", { type: "button", hidden: true, click: () => ask() }, "Refit to the last minutes");
const main = make("main");
document.querySelector("#page").append(
  make("header", {}, make("a", { class: "back", href: "/" }, "← Fleet"), make("div", {}, title, subtitle), refit, said, clock),
  trouble, main, make("footer", {}, "Estimates are those of the twin; only what is called measured was measured."));

const view = createView(main, {
  uPlot: window.uPlot,
  history: async () => (await fetch(`${path}/history`)).json(),
});

async function ask() {
  const token = sessionStorage.getItem("jaxtwin-token");
  if (!token) {
    setText(said, "This needs the token: open the address that the server printed.");
    return;
  }
  try {
    const answer = await fetch(`${path}/refit`, {
      method: "POST", body: "{}",
      headers: { "content-type": "application/json", authorization: `Bearer ${token}` },
    });
    const { text, error } = await answer.json();
    setText(said, text ?? `Refused: ${error}`);
  } catch {
    setText(said, "The server did not answer.");
  }
}

let isLoaded = false, time = 0;

async function poll() {
  if (!document.hidden) {
    try {
      const answer = await fetch(`${path}/frames`);
      if (!answer.ok) throw new Error(String(answer.status));
      for (const [kind, content] of await answer.json()) {
        if (kind === "layout") {
          document.title = `${content.rig} · jaxtwin`;
          setText(subtitle, `${content.title || content.rig} · ${content.source} · twin: ${content.twin}`);
          refit.hidden = !content.control;
        }
        if (kind === "sample") {
          setText(clock, `${timeText(content.t)} ${zoneName()}`);
          if (content.t === time) continue;
          time = content.t;
        }
        view.take(kind, content);
      }
      if (!isLoaded) await view.load();
      isLoaded = true;
      trouble.hidden = true;
    } catch {
      trouble.hidden = false;
      setText(trouble, "No connection to the server, or the rig was taken away. All values are old; trying again …");
    }
  }
  setTimeout(poll, POLL_MS);
}

poll();
