// The page of a rig in a notebook. Frames come from the kernel.

import { inShadow } from "./shadow.js";
import { createView } from "./view.js";

function render({ model, el }) {
  const waiting = new Map(); // span -> what the view waits for
  const history = (span) => new Promise((resolve) => {
    waiting.set(span, resolve);
    model.send({ kind: "history", span });
  });
  const view = createView(inShadow(el), { uPlot, history });
  const take = ({ kind, content }) => {
    if (kind === "history") {
      waiting.get(content.span)?.(content);
      waiting.delete(content.span);
      return;
    }
    view.take(kind, JSON.parse(content));
    if (kind === "layout") view.load();
  };
  model.on("msg:custom", take);
  model.send({ kind: "hello" });
  return () => model.off("msg:custom", take);
}

export default { render };
