// Small charts of the uncertain parameters of a twin: the estimate with its band, and the value of
// the twin in use.

import { make, setText, significantText } from "./format.js";

const SHOWN = 6;

/** Draws the parameters of a `series` with the time axis of the other charts. */
export class ParameterCharts {
  constructor(root, uncertain, axes, uPlot) {
    Object.assign(this, { root, uncertain, axes });
    this.charts = uncertain.map((one, k) => this.#chart(one, k, uPlot));
    this.observer = new ResizeObserver(() => this.charts.forEach((chart) => axes.fit(chart)));
    for (const chart of this.charts) this.observer.observe(chart.root.parentElement);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.repaint = () => this.charts.forEach((chart) => chart.redraw(false, true));
    this.scheme.addEventListener("change", this.repaint);
  }

  /** Draws again; `uncertain` has the values of the twin that is in use now. */
  draw(uncertain) {
    this.uncertain = uncertain;
    const { series } = this.axes;
    if (!series.time.length) return;
    const gaps = this.axes.gaps();
    const shown = this.#mostMoved();
    this.charts.forEach((chart, k) => {
      chart.figure.hidden = !shown.has(k);
      if (!shown.has(k)) return;
      const [upper, lower, mean] = ["parameter_upper", "parameter_lower", "parameter"]
        .map((name) => gaps.of(series[name][k]));
      const twin = uncertain[k].value;
      const known = [...upper, ...lower, twin].filter((value) => value !== null);
      const [low, high] = [Math.min(...known), Math.max(...known)];
      const room = 0.08 * (high - low) || 0.1 * Math.abs(twin) || 1;
      chart.limits = [low - room, high + room];
      chart.setData([gaps.time, upper, lower, gaps.time.map(() => twin), mean], true);
      this.axes.fit(chart);
      this.#title(k);
    });
  }

  destroy() {
    this.observer.disconnect();
    this.scheme.removeEventListener("change", this.repaint);
    for (const chart of this.charts) chart.destroy();
  }

  /** The few parameters that have moved furthest from the twin, in half widths of their bands, within
   * the time that is shown. */
  #mostMoved() {
    const { series } = this.axes;
    const moved = this.uncertain.map(({ value }, k) => series.parameter[k].reduce((most, mean, at) => {
      const half = (series.parameter_upper[k][at] - series.parameter_lower[k][at]) / 2;
      return mean !== null && half > 0 ? Math.max(most, Math.abs(mean - value) / half) : most;
    }, 0));
    const order = moved.map((_, k) => k).sort((a, b) => moved[b] - moved[a] || a - b);
    return new Set(order.slice(0, SHOWN));
  }

  #chart({ name, description }, k, uPlot) {
    const { axes } = this;
    const value = make("span", { class: "value" });
    const box = make("div", { class: "plot" });
    const figure = make("figure", { class: "chart", "aria-label": `${name} over time, estimated`, title: description },
      make("figcaption", {}, make("h3", {}, name), value), box);
    this.root.append(figure);
    const options = axes.options(box, () => this.charts?.[k].limits ?? [0, 1]);
    const chart = new uPlot({
      ...options,
      series: [
        {}, axes.faint(), axes.faint(),
        { stroke: () => axes.colour("--quiet"), width: 1.5, points: { show: false } },
        { stroke: () => axes.colour("--estimate"), width: 1.5, dash: [5, 3], points: { show: false } },
      ],
      bands: [{ series: [1, 2], fill: () => axes.colour("--estimate-band") }],
      hooks: { draw: [(u) => axes.mark(u)], setCursor: [() => this.#title(k)] },
    }, [[], [], [], [], []], box);
    return Object.assign(chart, { figure, value });
  }

  #title(k) {
    const chart = this.charts?.[k];
    if (!chart) return;
    const at = this.axes.place(chart);
    const mean = chart.data[4]?.[at];
    const text = `${significantText(mean)} ${this.uncertain[k].unit}`;
    setText(chart.value, (chart.cursor.idx ?? null) === null ? text : `${this.axes.text(chart.data[0][at])}: ${text}`);
  }
}
