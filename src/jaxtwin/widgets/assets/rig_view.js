// The page of a rig in a notebook. Frames come from the kernel.

import { make } from "./format.js";
import { inShadow } from "./shadow.js";
import { Silence } from "./silence.js";
import { createView } from "./view.js";

function render({ model, el }) {
  const trouble = make("p", { class: "trouble", role: "alert", hidden: true },
    "Nothing comes from the kernel any more. All values are old.");
  const root = make("div", { class: "view" });
  inShadow(el).append(trouble, root);
  const silence = new Silence((isSilent) => { trouble.hidden = !isSilent; });
  const waiting = new Map(); // span -> what the view waits for
  const history = (span) => new Promise((resolve) => {
    waiting.set(span, resolve);
    model.send({ kind: "history", span });
  });
  const view = createView(root, { uPlot, history });
  const take = ({ kind, content }) => {
    silence.hear();
    if (kind === "history") {
      waiting.get(content.span)?.(content);
      waiting.delete(content.span);
      return;
    }
    const frame = JSON.parse(content);
    if (kind === "layout") silence.isExpected = frame.is_live;
    view.take(kind, frame);
    if (kind === "layout") view.load();
  };
  model.on("msg:custom", take);
  model.send({ kind: "hello" });
  return () => {
    silence.end();
    model.off("msg:custom", take);
  };
}

export default { render };
