// A place for a widget that the styles of a notebook do not reach, nor its styles the notebook.

import { make } from "./format.js";

/** Makes an element inside another one. `STYLES` are the style sheets of the page and of widgets. */
export function inShadow(element) {
  const root = element.shadowRoot ?? element.attachShadow({ mode: "open" });
  const box = make("div", { class: "widget" });
  root.replaceChildren(make("style", {}, STYLES), box);
  return box;
}
