// Sliders for a twin. The kernel simulates; this draws.

import { Charts, dutyColour } from "./charts.js";
import { make, numberText, setText } from "./format.js";
import { Plate } from "./plate.js";
import { Series } from "./series.js";
import { inShadow } from "./shadow.js";

const STEPS = 400; // of a slider

class SlidersView {
  constructor(model, root) {
    this.model = model;
    this.about = model.get("about");
    this.shown = "temperatures";
    this.#build(root);
  }

  /** Takes a message of the kernel. */
  take({ kind, content }, buffers) {
    if (kind === "recording") this.recording = content;
    if (kind === "run") this.#run(content, buffers);
    this.problem.hidden = kind !== "problem";
    if (kind === "problem") setText(this.problem, content);
  }

  destroy() {
    this.charts.destroy();
  }

  #build(root) {
    const { about } = this;
    const card = (title, ...children) => make("section", { class: "card" }, make("h2", {}, title), ...children);
    this.problem = make("p", { class: "trouble", role: "alert", hidden: true });
    this.said = make("p", { class: "said" });
    this.rows = about.parameters.map((one) => this.#parameter(one));
    const reset = make("button", { type: "button", click: () => this.#reset() }, "As given");
    const parameters = make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Parameters" },
      ...this.rows.map(({ row }) => row));
    const columns = [card("Parameters", parameters, reset)];
    const isHeld = this.model.get("duty").length > 0;
    this.held = isHeld ? about.driven.map((part, k) => this.#duty(part, k)) : [];
    if (isHeld) columns.unshift(card("Duty", ...this.held.map(({ row }) => row)));
    const plateBox = make("div");
    if (about.plate) {
      this.when = make("input", {
        type: "range", min: "0", max: "1", step: "any", value: "1", "aria-label": "Time of the plate",
        input: () => this.#drawPlate(),
      });
      this.whenText = make("output");
      columns.push(card("Plate", plateBox,
        make("div", { class: "row" }, make("span", {}, "at"), this.when, this.whenText)));
      columns.at(-1).classList.add("plate");
    }
    const chartBox = make("div", { class: "charts" }), dutyBox = make("div");
    const choice = make("fieldset", { class: "choice", hidden: !about.recorded },
      make("legend", { class: "hidden" }, "The charts show"),
      ...["temperatures", "residuals"].map((name) => make("label", {}, make("input", {
        type: "radio", name: "shown", value: name, checked: name === this.shown,
        change: () => { this.shown = name; this.#drawCharts(); },
      }), make("span", {}, name === "residuals" ? "Recording − twin, K" : "Temperatures, °C"))));
    const legend = make("p", { class: "legend" },
      ...(about.recorded ? [make("span", { class: "key measured" }, "recorded")] : []),
      make("span", { class: "key estimate" }, "twin"));
    const duties = make("div", { class: "legend" }, ...about.driven.map((part, k) => {
      const key = make("span", { class: "key line" }, part.name);
      key.style.setProperty("--key", dutyColour(k));
      return key;
    }));
    if (!isHeld) columns.push(card("Duty, %", duties, dutyBox));
    root.append(this.problem, make("div", { class: "parts" },
      make("div", { class: "column" }, ...columns),
      make("div", { class: "column" }, card("Channels", this.said, choice, legend, chartBox))));
    const modes = about.recorded ? ["difference", "measured", "estimate"] : ["estimate"];
    this.plate = about.plate ? new Plate(plateBox, about, modes) : null;
    this.series = new Series(about.channels.length, about.driven.length);
    this.series.span = Infinity;
    this.series.width = about.duration;
    this.charts = new Charts(chartBox, dutyBox, about, this.series, uPlot, false);
  }

  #parameter(one) {
    const of = (entry) => (one.logarithmic ? Math.exp(entry) : entry);
    const shown = make("output");
    const slider = make("input", {
      type: "range", min: String(one.low), max: String(one.high), step: String((one.high - one.low) / STEPS || "any"),
      "aria-label": `${one.name}, ${one.unit}`,
      input: () => {
        this.model.set("values", { ...this.model.get("values"), [one.name]: of(Number(slider.value)) });
        this.model.save_changes();
        show();
      },
    });
    const show = () => setText(shown, `${this.model.get("values")[one.name].toPrecision(3)} ${one.unit}`);
    const set = () => {
      const value = this.model.get("values")[one.name];
      slider.value = String(one.logarithmic ? Math.log(value) : value);
      show();
    };
    set();
    return { set, row: make("label", { class: "row", title: one.description }, make("span", {}, one.name), slider, shown) };
  }

  #duty(part, k) {
    const shown = make("output");
    const show = () => setText(shown, `${numberText(Number(slider.value), 0)} %`);
    const slider = make("input", {
      type: "range", min: String(100 * part.lowest), max: "100", step: "1",
      value: String(100 * this.model.get("duty")[k]), "aria-label": `Duty of ${part.name}`,
      input: () => {
        const duty = [...this.model.get("duty")];
        duty[k] = Number(slider.value) / 100;
        this.model.set("duty", duty);
        this.model.save_changes();
        show();
      },
    });
    const set = () => {
      slider.value = String(100 * this.model.get("duty")[k]);
      show();
    };
    show();
    return { set, row: make("label", { class: "row" }, make("span", {}, part.name), slider, shown) };
  }

  #reset() {
    this.model.set("values", Object.fromEntries(this.about.parameters.map((one) => [one.name, one.value])));
    this.model.save_changes();
  }

  /** Sets all sliders to the values of the model, such as those that Python has set. */
  show() {
    for (const { set } of [...this.rows, ...this.held]) set();
  }

  #run(content, buffers) {
    const { samples } = content, { channels, driven } = this.about;
    const table = (buffer) => {
      const bytes = buffer.buffer ? buffer.buffer.slice(buffer.byteOffset, buffer.byteOffset + buffer.byteLength) : buffer;
      return new Float32Array(bytes);
    };
    const rows = (values, count) => Array.from({ length: count }, (_, k) =>
      Array.from(values.subarray(k * samples, (k + 1) * samples)));
    this.expected = rows(table(buffers[0]), channels.length);
    this.series.duty = rows(table(buffers[1]), driven.length);
    this.elements = table(buffers[2]);
    setText(this.said, content.rmse === null ? "" : `Root mean square difference ${numberText(content.rmse, 3)} K`);
    this.#drawCharts();
    this.#drawPlate();
  }

  #drawCharts() {
    if (!this.expected || !this.recording) return;
    const { series, recording, expected } = this;
    const measured = recording.measured ?? expected.map((row) => row.map(() => null));
    const isApart = this.shown === "residuals";
    series.time = recording.time;
    series.mean = !isApart ? measured : measured.map((row, k) =>
      row.map((value, n) => (value === null ? null : value - expected[k][n])));
    series.expected = isApart ? expected.map((row) => row.map(() => 0)) : expected;
    // The axis holds these: a band without width around what is expected.
    series.low = series.high = series.mean;
    series.band = expected.map(() => Array(recording.time.length).fill(0));
    this.charts.draw(null);
  }

  #drawPlate() {
    if (!this.plate || !this.expected || !this.recording) return;
    const { time, measured } = this.recording;
    const at = Math.round(Number(this.when.value) * (time.length - 1));
    const count = this.elements.length / time.length;
    const channels = this.expected.map((row) => row[at]);
    setText(this.whenText, `${numberText(time[at], 0)} s`);
    this.plate.outlook({ channels, elements: Array.from(this.elements.subarray(at * count, (at + 1) * count)) });
    this.plate.sample({ measured: measured?.map((row) => row[at]) ?? channels.map(() => null), expected: channels });
  }
}

function render({ model, el }) {
  const view = new SlidersView(model, inShadow(el));
  const take = (message, buffers) => view.take(message, buffers);
  const show = () => view.show();
  model.on("msg:custom", take);
  model.on("change:values", show);
  model.on("change:duty", show);
  model.send({ kind: "hello" });
  return () => {
    model.off("msg:custom", take);
    model.off("change:values", show);
    model.off("change:duty", show);
    view.destroy();
  };
}

export default { render };
