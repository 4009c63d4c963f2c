// A rig without a plate: its nodes with temperatures, and the links between them.

import { cssColour, heatColour, inkOn } from "./colours.js";
import { numberText, setText } from "./format.js";

const BOX = [156, 96], PITCH = [226, 156], EDGE = 8, HEAD = 22, ROOM = 62;
const MIN_RANGE = 2; // K; a smaller range would show noise as colour

export class Network {
  /**
   * - `root`: where it is drawn.
   * - `layout`: that of a rig with a network.
   */
  constructor(root, layout) {
    this.layout = layout;
    const { size: [columns, rows], nodes, links } = layout.network;
    const width = (columns - 1) * PITCH[0] + BOX[0] + 2 * EDGE;
    const height = (rows - 1) * PITCH[1] + BOX[1] + HEAD + ROOM + EDGE;
    this.svg = shape("svg", {
      class: "network", viewBox: `0 0 ${width} ${height}`, role: "img",
      "aria-label": "The network of the rig. The tables of values have all its numbers.",
    });
    // A small network must not fill the whole column.
    this.svg.style.maxWidth = `${width / 13}rem`;
    const corner = ({ column, row }) => [EDGE + column * PITCH[0], HEAD + row * PITCH[1]];
    const middle = (name) => {
      const [x, y] = corner(nodes.find((node) => node.name === name));
      return [x + BOX[0] / 2, y + BOX[1] / 2];
    };
    for (const [a, b] of links) {
      const [[x1, y1], [x2, y2]] = [middle(a), middle(b)];
      this.svg.append(shape("line", { x1, y1, x2, y2, class: "link" }));
    }
    this.room = text(EDGE + 26, height - 9, "room");
    this.svg.append(ground(EDGE + 10, height - 19, 0), this.room);
    this.boxes = nodes.map((node) => this.#box(node, corner(node)));
    root.append(this.svg);
  }

  sample(sample) { this.now = sample; this.draw(); }
  outlook(outlook) { this.ahead = outlook; }
  /** Names of the parts that a diagnosis suspects: their boxes stand out. */
  suspect(names) {
    this.layout.network.nodes.forEach((node, k) => {
      const isSuspect = [node.name, ...node.driven].some((name) => names.includes(name));
      this.boxes[k].box.classList.toggle("suspect", isSuspect);
    });
  }

  draw() {
    const { now, ahead, layout } = this;
    if (!now || !ahead) return;
    const names = [...layout.network.elements, ...layout.nodes];
    const at = (name, ...values) => values.flat()[names.indexOf(name)] ?? null;
    const values = layout.network.nodes.map(({ name, held }) => held ?? at(name, ahead.elements, ahead.nodes));
    const known = values.filter((value) => value !== null);
    const middle = (Math.max(...known) + Math.min(...known)) / 2;
    const range = Math.max(Math.max(...known) - Math.min(...known), MIN_RANGE);
    layout.network.nodes.forEach((node, k) => {
      const { box, value, later, reads, heat } = this.boxes[k];
      const colour = heatColour(0.15 + 0.7 * ((values[k] - middle) / range + 0.5));
      box.style.setProperty("--fill", cssColour(colour));
      box.style.setProperty("--text", inkOn(colour));
      setText(value, `${numberText(values[k])} °C`);
      const minute = at(node.name, ahead.elements_later, ahead.nodes_later);
      setText(later, node.held !== null ? "held" : `${numberText(minute)} in a minute`);
      setText(reads, node.channels.map((name) => {
        const measured = now.measured[layout.channels.findIndex((channel) => channel.name === name)];
        return measured === null ? `${name} failed` : `${name} reads ${numberText(measured)}`;
      }).join(", "));
      setText(heat, node.driven.map((name) =>
        `▼ ${name} ${numberText(100 * now.duty[layout.driven.findIndex((part) => part.name === name)], 0)} %`).join(" "));
    });
    setText(this.room, `room ${numberText(ahead.room)} °C`);
  }

  #box(node, [x, y]) {
    const box = shape("g", { class: "node" });
    const line = (down, kind, content = "") => text(x + BOX[0] / 2, y + down, content, kind);
    const above = node.channels.length ? 0 : 8;
    const [value, later, reads] = [line(46 + above, "value"), line(66 + above, "small"), line(86, "small")];
    const heat = text(x + BOX[0] / 2, y - 7, "", "out");
    if (node.is_losing) box.append(ground(x + 22, y + BOX[1], 20));
    box.append(shape("rect", { x, y, width: BOX[0], height: BOX[1], rx: 8 }),
      line(20 + above, "name", node.name), value, later, reads, heat);
    this.svg.append(box);
    return { box, value, later, reads, heat };
  }
}

function shape(tag, attributes, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const text = (x, y, content, kind = "") => shape("text", { x, y, class: kind }, content);

/** The sign of the surroundings at the end of a line that leads down. */
function ground(x, y, length) {
  const bars = [0, 1, 2].map((k) => `M${x - 10 + 3.5 * k} ${y + length + 4 * k}h${20 - 7 * k}`);
  return shape("path", { d: `M${x} ${y}v${length}${bars.join("")}`, class: "link" });
}
