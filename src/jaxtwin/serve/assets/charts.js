// Small charts over time, one for each channel and one for the duty, all with the same axes.

import { make, numberText, setText } from "./format.js";
import { TimeAxes } from "./time_axes.js";

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
    Object.assign(this, { root, layout, series, uPlot });
    this.axes = new TimeAxes(root, series, isClock);
    this.charts = layout.channels.map((channel, k) => this.#channelChart(root, channel.name, k));
    this.dutyChart = this.#dutyChart(dutyRoot);
    this.observer = new ResizeObserver(() => this.#resize());
    for (const chart of [...this.charts, this.dutyChart]) this.observer.observe(chart.root.parentElement);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.scheme.addEventListener("change", () => this.#repaint());
  }

  draw(outlook) {
    const { series } = this;
    if (!series.time.length) return;
    const gaps = this.axes.gaps();
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
    this.range = [low - room, high + room];
    Object.assign(this.axes, { range: [since, until], now: series.time.at(-1) });
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

  #channelChart(root, name, k) {
    const value = make("span", { class: "value" });
    const box = make("div", { class: "plot" });
    const head = make("h3", {}, name);
    root.append(make("figure", { class: "chart", "aria-label": `${name} over time` },
      make("figcaption", {}, head, value), box));
    const { axes } = this;
    const chart = new this.uPlot({
      ...axes.options(box, () => this.range ?? [0, 1]),
      series: [
        {}, axes.faint(), axes.faint(), axes.faint(), axes.faint(),
        { stroke: () => axes.colour("--estimate"), width: 1.5, dash: [5, 3], points: { show: false } },
        { stroke: () => axes.colour("--measured"), width: 1.5, points: { show: false } },
      ],
      bands: [
        { series: [1, 2], fill: () => axes.colour("--estimate-band") },
        { series: [3, 4], fill: () => axes.colour("--measured-band") },
      ],
      hooks: { draw: [(u) => axes.mark(u)], setCursor: [(u) => this.#title(k, u.cursor.idx)] },
    }, [[], [], [], [], [], [], []], box);
    chart.value = value;
    return chart;
  }

  #dutyChart(root) {
    const box = make("div", { class: "plot" });
    root.append(box);
    const lowest = this.layout.driven.some((one) => one.lowest < 0) ? -105 : -5;
    return new this.uPlot({
      ...this.axes.options(box, () => [lowest, 105]),
      series: [{}, ...this.layout.driven.map((part, k) => ({
        label: part.name, stroke: DRIVEN[k % DRIVEN.length], width: 2, dash: DASHES[k % DASHES.length],
        paths: this.uPlot.paths.stepped({ align: 1 }), points: { show: false },
      }))],
      hooks: { draw: [(u) => this.axes.mark(u)] },
    }, [[], ...this.layout.driven.map(() => [])], box);
  }

  /** The values at the cursor, or the newest ones. */
  #title(k, idx) {
    const chart = this.charts?.[k];
    if (!chart) return;
    const { data } = chart, at = this.axes.place(chart);
    const measured = data[6]?.[at], expected = data[5]?.[at];
    const text = measured === null || measured === undefined
      ? `expected ${numberText(expected)} °C (estimate)`
      : `${numberText(measured)} °C`;
    setText(chart.value, idx === null || idx === undefined ? text : `${this.axes.text(data[0][at])}: ${text}`);
  }

  #resize() {
    for (const chart of [...this.charts, this.dutyChart]) this.axes.fit(chart);
  }

  #repaint() {
    for (const chart of [...this.charts, this.dutyChart]) chart.redraw(false, true);
  }
}

const percent = (part) => (part === null ? null : 100 * part);

/** What tells the lines of the duty apart, for a legend. */
export const dutyColour = (k) => DRIVEN[k % DRIVEN.length];
