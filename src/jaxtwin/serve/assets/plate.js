// The plate on a canvas: what is measured, estimated, their difference, and a minute ahead.

import { apartColour, cssColour, heatColour, inkOn } from "./colours.js";
import { make, numberText, setText, signedText } from "./format.js";

const MODES = [
  ["measured", "Measured"],
  ["estimate", "Estimate"],
  ["difference", "Measured − estimate"],
  ["later", "In a minute (estimate)"],
];
const FINE = 96; // points along the plate between which the browser interpolates
const LEAST = { heat: 2, apart: 0.5 }; // K; smaller ranges would show noise as colour

export class Plate {
  /**
   * - `root`: where it is drawn.
   * - `layout`: that of the rig, with a plate.
   * - `names`: of the modes among which one can choose.
   */
  constructor(root, layout, names = MODES.map(([name]) => name)) {
    this.layout = layout;
    this.mode = names[0];
    this.picked = null;
    this.suspects = [];
    const { columns, rows } = layout.plate;
    this.width = columns.at(-1);
    this.height = rows.at(-1);
    this.canvas = make("canvas", {
      tabindex: "0", role: "img",
      "aria-label": "The plate. Arrow keys go from channel to channel; the table of values has all numbers.",
      pointermove: (event) => this.#hover(event),
      pointerleave: () => this.#pick(null),
      keydown: (event) => this.#step(event),
      blur: () => this.#pick(null),
    });
    this.readout = make("output", { class: "readout" });
    this.scale = make("canvas", { class: "scale", width: "200", height: "1", "aria-hidden": "true" });
    this.low = make("span");
    this.high = make("span");
    const modes = MODES.filter(([name]) => names.includes(name)).map(([name, label]) =>
      make("label", {}, make("input", {
        type: "radio", name: "plate-mode", value: name, checked: name === this.mode,
        change: () => { this.mode = name; this.draw(); },
      }), make("span", {}, label)));
    root.append(
      make("fieldset", { class: "choice" }, make("legend", { class: "hidden" }, "The plate shows"), ...modes),
      this.canvas,
      make("div", { class: "scale-row" }, this.low, this.scale, this.high),
      this.readout,
    );
    // A square plate must not fill the whole column.
    this.canvas.style.maxWidth = `${(22 * this.width) / this.height}rem`;
    this.fine = document.createElement("canvas");
    this.fine.width = FINE;
    this.fine.height = Math.max(2, Math.round((FINE * this.height) / this.width));
    // Small zones lie on large ones.
    this.zones = layout.channels
      .flatMap((channel, k) => channel.zones.map((zone) => ({ zone, channel: k })))
      .sort((a, b) => area(b.zone) - area(a.zone));
    new ResizeObserver(() => this.#resize()).observe(this.canvas);
    this.#say();
  }

  sample(sample) { this.now = sample; this.draw(); }
  outlook(outlook) { this.ahead = outlook; }
  /** Names of the parts that a diagnosis suspects: their outlines stand out. */
  suspect(names) { this.suspects = names; this.draw(); }

  draw() {
    const context = this.canvas.getContext("2d");
    const scale = this.canvas.width / this.width;
    const values = this.#values();
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const isApart = this.mode === "difference";
    const known = (values.elements ?? values.channels ?? []).filter((value) => value !== null);
    let low = Math.min(...known), high = Math.max(...known);
    if (!known.length) [low, high] = [0, 1];
    if (isApart) { high = Math.max(Math.abs(low), Math.abs(high), LEAST.apart); low = -high; }
    else if (high - low < LEAST.heat) {
      const middle = (low + high) / 2;
      [low, high] = [middle - LEAST.heat / 2, middle + LEAST.heat / 2];
    }
    const colour = (value) => isApart ? apartColour(value / high) : heatColour((value - low) / (high - low));
    if (values.elements) this.#fill(context, values.elements, colour);
    for (const { zone, channel } of this.zones) {
      const value = values.channels?.[channel];
      const box = [zone[0] * scale, zone[2] * scale, (zone[1] - zone[0]) * scale, (zone[3] - zone[2]) * scale];
      if (!values.elements && value !== null && value !== undefined) {
        context.fillStyle = cssColour(colour(value));
        context.fillRect(...box);
      }
      context.lineWidth = this.picked === channel ? 4 * this.ratio : this.ratio;
      context.strokeStyle = this.picked === channel ? "#fff" : "rgb(255 255 255 / 45%)";
      context.strokeRect(...box);
    }
    this.#cells(context, scale);
    this.#labels(context, scale, values, colour, isApart);
    this.#legend(low, high, isApart);
    this.#say();
  }

  #values() {
    const { now, ahead } = this;
    if (this.mode === "measured") return { channels: now?.measured };
    if (this.mode === "estimate") return { channels: ahead?.channels, elements: ahead?.elements };
    if (this.mode === "later") return { channels: ahead?.channels_later, elements: ahead?.elements_later };
    const apart = now?.measured.map((value, k) =>
      value === null || now.expected[k] === null ? null : value - now.expected[k]);
    return { channels: apart };
  }

  /** Temperatures are linear between the centres of elements, as in the network of the twin. */
  #fill(context, elements, colour) {
    const { columns, rows } = this.layout.plate;
    const picture = this.fine.getContext("2d");
    const pixels = picture.createImageData(this.fine.width, this.fine.height);
    const across = shares(columns, this.fine.width), down = shares(rows, this.fine.height);
    const count = columns.length - 1;
    let place = 0;
    for (const [row, nextRow, ofRow] of down) {
      for (const [column, nextColumn, ofColumn] of across) {
        const above = mixed(elements[row * count + column], elements[row * count + nextColumn], ofColumn);
        const below = mixed(elements[nextRow * count + column], elements[nextRow * count + nextColumn], ofColumn);
        const rgb = colour(mixed(above, below, ofRow));
        pixels.data.set([...rgb, 255], place);
        place += 4;
      }
    }
    picture.putImageData(pixels, 0, 0);
    context.imageSmoothingEnabled = true;
    context.drawImage(this.fine, 0, 0, this.canvas.width, this.canvas.height);
  }

  #cells(context, scale) {
    context.font = `600 ${0.8 * this.rem}px system-ui, sans-serif`;
    context.textAlign = "left";
    context.textBaseline = "bottom";
    for (const { name, outline } of this.layout.driven) {
      if (!outline.length) continue;
      context.beginPath();
      for (const [x, y] of outline) context.lineTo(x * scale, y * scale);
      context.closePath();
      const isSuspect = this.suspects.includes(name);
      const lines = isSuspect ? [[7, "rgb(0 0 0 / 75%)"], [4, "#ffb000"]] : [[3.5, "rgb(0 0 0 / 55%)"], [1.5, "#fff"]];
      for (const [width, colour] of lines) {
        context.lineWidth = width * this.ratio;
        context.strokeStyle = colour;
        context.setLineDash(isSuspect ? [] : [6 * this.ratio, 4 * this.ratio]);
        context.stroke();
      }
      context.setLineDash([]);
      const corner = outline.reduce((a, b) => (b[1] - b[0] > a[1] - a[0] ? b : a));
      outlined(context, name, corner[0] * scale + 5 * this.ratio, corner[1] * scale - 4 * this.ratio, this.ratio);
    }
  }

  #labels(context, scale, values, colour, isApart) {
    if (!values.channels) return;
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const { zone, channel } of this.zones) {
      const value = values.channels[channel];
      const wide = (zone[1] - zone[0]) * scale, tall = (zone[3] - zone[2]) * scale;
      const size = Math.min(this.rem, wide / 3.2, tall / 2.4);
      if (size < 8 * this.ratio) continue; // hover says it
      const text = value === null ? "failed" : isApart ? signedText(value) : numberText(value);
      context.font = `600 ${size}px system-ui, sans-serif`;
      const x = ((zone[0] + zone[1]) / 2) * scale, y = ((zone[2] + zone[3]) / 2) * scale;
      const lift = this.zones.some(({ zone: other }) => other !== zone && holds(zone, other)) ? tall / 4 : 0;
      if (values.elements) outlined(context, text, x, y - lift, this.ratio);
      else {
        context.fillStyle = value === null ? "#d55e00" : inkOn(colour(value));
        context.fillText(text, x, y - lift);
      }
    }
  }

  #legend(low, high, isApart) {
    const context = this.scale.getContext("2d");
    for (let x = 0; x < 200; x += 1) {
      const part = x / 199;
      context.fillStyle = cssColour(isApart ? apartColour(2 * part - 1) : heatColour(part));
      context.fillRect(x, 0, 1, 1);
    }
    setText(this.low, isApart ? `${signedText(low)} K` : `${numberText(low)} °C`);
    setText(this.high, isApart ? `${signedText(high)} K` : `${numberText(high)} °C`);
  }

  #resize() {
    this.ratio = window.devicePixelRatio || 1;
    this.rem = this.ratio * parseFloat(getComputedStyle(document.documentElement).fontSize);
    const width = Math.round(this.canvas.clientWidth * this.ratio);
    const height = Math.round((width * this.height) / this.width);
    if (!width || (this.canvas.width === width && this.canvas.height === height)) return;
    this.canvas.width = width;
    this.canvas.height = height;
    this.draw();
  }

  #hover(event) {
    const scale = this.canvas.clientWidth / this.width;
    const x = event.offsetX / scale, y = event.offsetY / scale;
    const found = this.zones.filter(({ zone }) => x >= zone[0] && x <= zone[1] && y >= zone[2] && y <= zone[3]);
    this.#pick(found.at(-1)?.channel ?? null);
  }

  #step(event) {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const count = this.layout.channels.length;
    this.#pick(((this.picked ?? (step > 0 ? -1 : 0)) + step + count) % count);
  }

  #pick(channel) {
    if (channel === this.picked) return;
    this.picked = channel;
    this.draw();
  }

  #say() {
    const k = this.picked;
    if (k === null || !this.now) {
      setText(this.readout, "Point at the plate, or use the arrow keys, for values.");
      return;
    }
    const { measured, expected } = this.now;
    const later = this.ahead?.channels_later ? `, in a minute ${numberText(this.ahead.channels_later[k])} (estimate)` : "";
    setText(this.readout, `${this.layout.channels[k].name}: measured ${numberText(measured[k], 2)} °C, ` +
      `expected ${numberText(expected[k], 2)} (estimate)${later}`);
  }
}

const area = (zone) => (zone[1] - zone[0]) * (zone[3] - zone[2]);
const mixed = (a, b, part) => a + part * (b - a);
const holds = (outer, inner) => {
  const x = (outer[0] + outer[1]) / 2, y = (outer[2] + outer[3]) / 2;
  return area(inner) < area(outer) && x > inner[0] && x < inner[1] && y > inner[2] && y < inner[3];
};

function outlined(context, text, x, y, ratio) {
  context.lineWidth = 3 * ratio;
  context.strokeStyle = "rgb(0 0 0 / 70%)";
  context.strokeText(text, x, y);
  context.fillStyle = "#fff";
  context.fillText(text, x, y);
}

/** For each of `count` points: the centres of elements around it, and the share of the second. */
function shares(edges, count) {
  const centres = edges.slice(1).map((edge, k) => (edge + edges[k]) / 2);
  return Array.from({ length: count }, (_, k) => {
    const at = ((k + 0.5) / count) * edges.at(-1);
    const next = centres.findIndex((centre) => centre > at);
    if (next <= 0) {
      const end = next < 0 ? centres.length - 1 : 0;
      return [end, end, 0];
    }
    return [next - 1, next, (at - centres[next - 1]) / (centres[next] - centres[next - 1])];
  });
}
