// Small charts over time, one for each channel and one for the duty, all with the same axes.

import { make, numberText, setText, timeText } from "./format.js";

const DRIVEN = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
const DASHES = [[], [6, 3], [2, 2], [8, 3, 2, 3], [4, 4], [1, 3]];

/**
 * Draws `series` and the forecast of an outlook.
 *
 * - `uPlot`: the class of the library.
 * - `isClock`: whether times are s since 1970, or s since the start of a run.
 */
export class Charts {
  constructor(root, dutyRoot, layout, series, uPlot, isClock = true) {
    Object.assign(this, { root, layout, series, uPlot, isClock });
    this.charts = layout.channels.map((channel, k) => this.#channelChart(root, channel.name, k));
    this.dutyChart = this.#dutyChart(dutyRoot);
    this.observer = new ResizeObserver(() => this.#resize());
    this.observer.observe(root);
    this.observer.observe(dutyRoot);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.scheme.addEventListener("change", () => this.#repaint());
  }

  draw(outlook) {
    const { series } = this;
    if (!series.time.length) return;
    const gaps = this.#gaps(series.time);
    const times = outlook?.times.filter((time) => time > series.time.at(-1)) ?? [];
    const skipped = outlook ? outlook.times.length - times.length : 0;
    const x = [...gaps.time, ...times];
    const blank = Array(times.length).fill(null);
    let low = Infinity, high = -Infinity;
    const all = this.charts.map((chart, k) => {
      const at = (values) => gaps.of(values);
      const ahead = times.length ? outlook.forecast.slice(skipped).map((row) => row[k]) : [];
      const half = times.length ? outlook.forecast_band.slice(skipped).map((row) => row[k]) : [];
      const expected = at(series.expected[k]), band = at(series.band[k]);
      const minimum = at(series.low[k]), maximum = at(series.high[k]);
      const edge = (sign) => [
        ...expected.map((value, n) => (value === null || band[n] === null ? null : value + sign * band[n])),
        ...ahead.map((value, n) => value + sign * half[n]),
      ];
      const [upper, lower] = [edge(1), edge(-1)];
      for (const value of [...minimum, ...lower]) if (value !== null && value < low) low = value;
      for (const value of [...maximum, ...upper]) if (value !== null && value > high) high = value;
      return [x, upper, lower, [...maximum, ...blank], [...minimum, ...blank],
        [...expected, ...ahead], [...at(series.mean[k]), ...blank]];
    });
    if (!Number.isFinite(low)) [low, high] = [0, 1];
    const room = Math.max(0.08 * (high - low), 0.5);
    const until = x.at(-1), since = series.time.at(-1) - Math.min(series.span, Math.max(until - x[0], 10));
    this.range = { x: [since, until], y: [low - room, high + room] };
    this.now = series.time.at(-1);
    this.charts.forEach((chart, k) => {
      chart.setData(all[k], true);
      if (chart.cursor.idx === null || chart.cursor.idx === undefined) this.#title(k, null);
    });
    const duty = series.duty.map((values) => [...gaps.of(values).map(percent), ...blank]);
    this.dutyChart.setData([x, ...duty], true);
  }

  destroy() {
    this.observer.disconnect();
    for (const chart of [...this.charts, this.dutyChart]) chart.destroy();
  }

  /** Times with a further one, at which nothing is known, in each gap: no line is drawn across. */
  #gaps(time) {
    const width = this.series.width;
    const places = [];
    const found = [];
    time.forEach((one, k) => {
      if (k && one - time[k - 1] > 3.5 * Math.max(width, 1)) { found.push(time[k - 1] + width); places.push(-1); }
      found.push(one);
      places.push(k);
    });
    return { time: found, of: (values) => places.map((k) => (k < 0 ? null : values[k])) };
  }

  #channelChart(root, name, k) {
    const value = make("span", { class: "value" });
    const box = make("div", { class: "plot" });
    const head = make("h3", {}, name);
    root.append(make("figure", { class: "chart", "aria-label": `${name} over time` },
      make("figcaption", {}, head, value), box));
    const faint = { stroke: "transparent", width: 0, points: { show: false } };
    const chart = new this.uPlot({
      ...this.#common(box),
      series: [
        {}, { ...faint }, { ...faint }, { ...faint }, { ...faint },
        { stroke: () => this.#colour("--estimate"), width: 1.5, dash: [5, 3], points: { show: false } },
        { stroke: () => this.#colour("--measured"), width: 1.5, points: { show: false } },
      ],
      bands: [
        { series: [1, 2], fill: () => this.#colour("--estimate-band") },
        { series: [3, 4], fill: () => this.#colour("--measured-band") },
      ],
      scales: { x: this.#x(), y: { range: () => this.range?.y ?? [0, 1] } },
      hooks: { draw: [(u) => this.#now(u)], setCursor: [(u) => this.#title(k, u.cursor.idx)] },
    }, [[], [], [], [], [], [], []], box);
    chart.value = value;
    return chart;
  }

  #dutyChart(root) {
    const box = make("div", { class: "plot" });
    root.append(box);
    return new this.uPlot({
      ...this.#common(box),
      series: [{}, ...this.layout.driven.map((part, k) => ({
        label: part.name, stroke: DRIVEN[k % DRIVEN.length], width: 2, dash: DASHES[k % DASHES.length],
        paths: this.uPlot.paths.stepped({ align: 1 }), points: { show: false },
      }))],
      scales: { x: this.#x(), y: { range: () => [this.layout.driven.some((one) => one.lowest < 0) ? -105 : -5, 105] } },
      hooks: { draw: [(u) => this.#now(u)] },
    }, [[], ...this.layout.driven.map(() => [])], box);
  }

  #colour(name) {
    return getComputedStyle(this.root).getPropertyValue(name).trim();
  }

  #x() {
    return { time: this.isClock, range: () => this.range?.x ?? [0, 1] };
  }

  #common(box) {
    const rem = parseFloat(getComputedStyle(document.documentElement).fontSize);
    const height = Math.round((this.layout.channels.length > 3 ? 8.2 : 14) * rem);
    const axis = {
      stroke: () => this.#colour("--quiet"), grid: { stroke: () => this.#colour("--grid"), width: 1 },
      ticks: { show: false }, font: `${Math.round(0.72 * rem)}px system-ui, sans-serif`,
    };
    return {
      width: Math.max(box.clientWidth, 100), height,
      legend: { show: false },
      cursor: { y: false, sync: { key: "jaxtwin" }, points: { show: false }, drag: { x: false, y: false } },
      axes: [
        { ...axis, size: 1.5 * rem, space: 5 * rem, values: (_, splits) => splits.map((one) => this.#tick(one)) },
        { ...axis, size: 2.5 * rem, space: 1.9 * rem },
      ],
    };
  }

  #time(seconds) {
    return this.isClock ? timeText(seconds) : `${numberText(seconds, 0)} s`;
  }

  #tick(seconds) {
    const text = this.#time(seconds);
    if (!this.isClock) return text;
    return this.series.span > 600 ? text.replace(/:\d\d(?=\D*$)/, "") : text;
  }

  #now(u) {
    if (!this.now) return;
    const x = Math.round(u.valToPos(this.now, "x", true));
    const context = u.ctx;
    context.save();
    context.strokeStyle = this.#colour("--quiet");
    context.setLineDash([3, 3]);
    context.beginPath();
    context.moveTo(x, u.bbox.top);
    context.lineTo(x, u.bbox.top + u.bbox.height);
    context.stroke();
    context.restore();
  }

  /** The values at the cursor, or the newest ones. */
  #title(k, idx) {
    const chart = this.charts?.[k];
    if (!chart) return;
    const data = chart.data;
    let at = idx;
    if (at === null || at === undefined) at = data[0].findLastIndex((time) => time <= this.now);
    const measured = data[6]?.[at], expected = data[5]?.[at];
    const text = measured === null || measured === undefined
      ? `expected ${numberText(expected)} °C (estimate)`
      : `${numberText(measured)} °C`;
    setText(chart.value, idx === null || idx === undefined ? text : `${this.#time(data[0][at])}: ${text}`);
  }

  #resize() {
    for (const chart of [...this.charts, this.dutyChart]) {
      const width = chart.root.parentElement.clientWidth;
      if (width && width !== chart.width) chart.setSize({ width, height: chart.height });
    }
  }

  #repaint() {
    for (const chart of [...this.charts, this.dutyChart]) chart.redraw(false, true);
  }
}

const percent = (part) => (part === null ? null : 100 * part);

/** What tells the lines of the duty apart, for a legend. */
export const dutyColour = (k) => DRIVEN[k % DRIVEN.length];
