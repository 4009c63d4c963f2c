// What charts over time share: the axis of time, the line at now, colours and gaps.

import { numberText, timeText } from "./format.js";

/**
 * The axis of time of all charts of a `series`, in the colours of `root`.
 *
 * - `isClock`: whether times are s since 1970, or s since the start of a run.
 */
export class TimeAxes {
  constructor(root, series, isClock) {
    Object.assign(this, { root, series, isClock });
    this.range = [0, 1];
    this.now = null;
  }

  /** Times with a further one, at which nothing is known, in each gap: no line is drawn across. */
  gaps() {
    const { time, width } = this.series;
    const places = [];
    const found = [];
    time.forEach((one, k) => {
      if (k && one - time[k - 1] > 3.5 * Math.max(width, 1)) { found.push(time[k - 1] + width); places.push(-1); }
      found.push(one);
      places.push(k);
    });
    return { time: found, of: (values) => places.map((k) => (k < 0 ? null : values[k])) };
  }

  /** A colour of the style sheet. */
  colour(name) {
    return getComputedStyle(this.root).getPropertyValue(name).trim();
  }

  /** The options of a chart that fills a box: `y` is the range of its values. */
  options(box, y) {
    const rem = parseFloat(getComputedStyle(document.documentElement).fontSize);
    const axis = {
      stroke: () => this.colour("--quiet"), grid: { stroke: () => this.colour("--grid"), width: 1 },
      ticks: { show: false }, font: `${Math.round(0.72 * rem)}px system-ui, sans-serif`,
    };
    return {
      width: Math.max(box.clientWidth, 100), height: Math.max(box.clientHeight, 60),
      legend: { show: false },
      cursor: { y: false, sync: { key: "jaxtwin" }, points: { show: false }, drag: { x: false, y: false } },
      scales: { x: { time: this.isClock, range: () => this.range }, y: { range: y } },
      axes: [
        { ...axis, size: 1.5 * rem, space: 5 * rem, values: (_, splits) => splits.map((one) => this.#tick(one)) },
        { ...axis, size: 2.5 * rem, space: 1.9 * rem },
      ],
    };
  }

  /** The options of an edge of a band, which is not drawn itself. */
  faint() {
    return { stroke: "transparent", width: 0, points: { show: false } };
  }

  /** A time as text. */
  text(seconds) {
    return this.isClock ? timeText(seconds) : `${numberText(seconds, 0)} s`;
  }

  /** Draws the line at now into a chart. */
  mark(chart) {
    if (!this.now) return;
    const x = Math.round(chart.valToPos(this.now, "x", true));
    const context = chart.ctx;
    context.save();
    context.strokeStyle = this.colour("--quiet");
    context.setLineDash([3, 3]);
    context.beginPath();
    context.moveTo(x, chart.bbox.top);
    context.lineTo(x, chart.bbox.top + chart.bbox.height);
    context.stroke();
    context.restore();
  }

  /** The place in a chart's data of its cursor, or of the newest values. */
  place(chart) {
    const at = chart.cursor.idx ?? null;
    return at === null ? chart.data[0].findLastIndex((time) => time <= this.now) : at;
  }

  /** Makes a chart as large as its box. */
  fit(chart) {
    const { clientWidth: width, clientHeight: height } = chart.root.parentElement;
    if (width && height && (width !== chart.width || height !== chart.height)) chart.setSize({ width, height });
  }

  #tick(seconds) {
    const text = this.text(seconds);
    if (!this.isClock) return text;
    return this.series.span > 600 ? text.replace(/:\d\d(?=\D*$)/, "") : text;
  }
}
