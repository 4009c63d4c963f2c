// The view of a rig: draws frames into an element, wherever they come from.

import { Charts, dutyColour } from "./charts.js";
import {
  make, numberText, setRows, setText, significantText, signedText, timeText, zoneName,
} from "./format.js";
import { Network } from "./network.js";
import { ParameterCharts } from "./parameter_charts.js";
import { Plate } from "./plate.js";
import { Series } from "./series.js";

const SPANS = [[300, "5 min"], [3600, "1 h"], [86400, "1 day"], [604800, "1 week"]];
const SIGNS = { good: "✓", unknown: "…", notice: "i", warning: "!", critical: "‼", plain: "·" };
const WORDS = { good: "good", unknown: "not known", notice: "notice", warning: "warning", critical: "critical" };
const QUESTIONS = { rig: "Is the rig well?", minute: "What comes next?", twin: "Is the twin right?" };
const FEW = 4; // channels whose charts leave room for tables beside them
const SURE = 0.9; // as in the headline
const CHART_MS = 500;
const SPEAK_MS = 30_000;
const calm = matchMedia("(prefers-reduced-motion: reduce)");

/**
 * Makes a view in an element.
 *
 * - `uPlot`: the class of the library that draws charts.
 * - `history`: a function of a number of seconds that promises the history of the last ones.
 * - `twinAction`: called with "promote" and a version, "rollback", "refit" or "acknowledge"; null
 *   where nobody may.
 * - `aside`: an element that stands beside the charts, such as one with commands.
 */
export function createView(root, { uPlot, history, twinAction = null, aside = "" }) {
  return new View(root, uPlot, history, twinAction, aside);
}

/** The parts of which something has surely changed, whatever it may be: names as in `loosen P1`. */
function suspects({ explanations }) {
  const shares = new Map();
  for (const { name, probability } of explanations) {
    const part = name.split(" ").slice(1).join(" ");
    shares.set(part, (shares.get(part) ?? 0) + probability);
  }
  return [...shares].filter(([, share]) => share >= SURE).map(([part]) => part);
}

class View {
  constructor(root, uPlot, history, twinAction, aside) {
    Object.assign(this, { root, uPlot, history, twinAction, aside });
    this.drawn = this.charted = this.spoken = 0;
    this.#build();
    this.take = this.take.bind(this);
  }

  /** Takes a frame. */
  take(kind, content) {
    const known = {
      layout: this.#layout, sample: this.#sample, outlook: this.#outlook, story: this.#story,
      findings: this.#findings, diagnosis: this.#diagnosis, twins: this.#twins, log: this.#log,
    }[kind];
    known?.call(this, content);
  }

  /** Loads the history of the span that is shown; `keep` what is older than it. */
  async load(keep = false) {
    if (!this.series) return;
    const series = this.series;
    const found = await this.history(series.span);
    if (series !== this.series) return;
    series.load(found, keep);
    this.charted = 0;
    this.#drawCharts();
  }

  #build() {
    const part = (id, title, ...children) =>
      make("section", { class: `card ${id}`, "aria-labelledby": `${id}-title` },
        make("h2", { id: `${id}-title` }, title), ...children);
    this.answers = {};
    const story = make("div", { class: "story" });
    for (const [name, question] of Object.entries(QUESTIONS)) {
      const sign = make("span", { class: "sign", "aria-hidden": "true" });
      const level = make("span", { class: "hidden" });
      const head = make("p", { class: "head" }, level, make("span"));
      const number = make("p", { class: "number", hidden: true });
      const text = make("p", { class: "text" });
      const card = make("section", { class: "answer unknown", "aria-label": question },
        sign, make("div", {}, make("h2", {}, question), number, head, text));
      this.answers[name] = { card, sign, level, head: head.lastChild, text, number };
      story.append(card);
    }
    this.acknowledge = make("button", {
      type: "button", hidden: true, click: () => this.twinAction("acknowledge"),
    }, "Acknowledge");
    this.answers.rig.text.after(this.acknowledge);
    this.hottest = make("p", { class: "number" }, "–");
    this.hottestText = make("p", { class: "text" });
    this.answers.rig.card.after(make("section", { class: "answer plain", "aria-label": "Temperature" },
      make("div", {}, make("h2", {}, "Temperature"), this.hottest, this.hottestText)));
    this.spokenText = make("p", { class: "hidden", role: "status" });
    this.plateBox = make("div");
    this.chartBox = make("div", { class: "charts" });
    this.dutyBox = make("div");
    this.dutyLegend = make("div", { class: "legend" });
    this.energy = make("p", { class: "energy" });
    this.spanChoice = make("fieldset", { class: "choice" }, make("legend", { class: "hidden" }, "Time shown"),
      ...SPANS.map(([span, label], k) => make("label", {}, make("input", {
        type: "radio", name: "span", value: String(span), checked: k === 0,
        change: () => { this.series.span = span; this.load(); },
      }), make("span", {}, label))));
    const legend = make("p", { class: "legend" },
      make("span", { class: "key measured" }, "measured"),
      make("span", { class: "key estimate" }, "expected, and forecast (estimate) with 95 % band"));
    const table = (label, heads, caption) => {
      const body = make("tbody");
      const scroll = make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label },
        make("table", {}, make("caption", { class: "hidden" }, caption ?? label), make("thead", {},
          make("tr", {}, ...heads.map((head) => make("th", { scope: "col" }, head)))), body));
      return [scroll, body];
    };
    const [values, valueRows] = table("Table of values",
      ["Channel", "Measured", "Expected", "Error, K", "In a minute"]);
    const [unseen, unseenRows] = table("Estimates of what nothing measures",
      ["Estimate of", "Now", "± 95 %", "In a minute"]);
    const [findings, findingRows] = table("Table of findings", ["Since", "What", "Size", "Sure"]);
    const [twins, twinRows] = table("Table of twins", ["Version", "Made", "Why", "Role"]);
    const [parameters, parameterRows] = table("Table of the parameters of the twin, estimated",
      ["Parameter", "Estimated", "95 % band", "Twin in use"]);
    Object.assign(this, { valueRows, unseenRows, findingRows, twinRows, parameterRows });
    this.parameterBox = make("div", { class: "charts" });
    this.parametersPart = part("parameters", "Parameters of the twin (estimated)",
      make("p", { class: "legend" },
        make("span", { class: "key estimate" }, "estimated, with 95 % band"),
        make("span", { class: "key reference" }, "value of the twin in use")),
      this.parameterBox, parameters);
    this.causes = make("div", { class: "causes" });
    this.lines = make("ol", { class: "log", tabindex: "0", "aria-label": "Log, the newest first" });
    this.refit = make("button", {
      type: "button", class: "refit", hidden: true, click: () => this.twinAction("refit"),
    }, "Refit to the last 15 minutes");
    this.twinsPart = part("twins", "Twins of the store", twins, this.refit);
    this.platePart = part("plate", "Plate", this.plateBox);
    this.tables = make("div", { class: "tables" },
      part("values", "Values, °C", values),
      part("unseen", "What nothing measures (estimates)", unseen));
    this.right = make("div", { class: "column right" },
      part("channels", "Channels", this.spanChoice, legend, this.chartBox), this.parametersPart);
    this.bottom = make("div", { class: "bottom" },
      make("div", { class: "column" }, this.twinsPart, part("log", "Log", this.lines)));
    this.root.replaceChildren(
      story, this.spokenText,
      make("div", { class: "parts" },
        make("div", { class: "column left" },
          this.platePart,
          part("findings", "Findings", findings, this.causes),
          part("duty", "Duty and energy", this.dutyLegend, this.dutyBox, this.energy),
          this.aside,
        ),
        this.right,
        this.bottom,
      ),
    );
    this.twinsPart.hidden = true;
    setRows(findingRows, [["–", "nothing was found", "", ""]]);
  }

  #layout(layout) {
    const before = this.layout;
    this.layout = layout;
    if (before && drawnOf(before) === drawnOf(layout)) return;
    this.charts?.destroy();
    this.parameterCharts?.destroy();
    this.chartBox.replaceChildren();
    this.dutyBox.replaceChildren();
    this.plateBox.replaceChildren();
    this.parameterBox.replaceChildren();
    const span = this.series?.span;
    this.series = new Series(layout.channels.length, layout.driven.length, layout.uncertain.length);
    if (span) this.series.span = span;
    const isFew = layout.channels.length <= FEW;
    this.root.classList.toggle("few", isFew);
    if (isFew) this.right.append(this.tables);
    else this.bottom.prepend(this.tables);
    setText(this.platePart.firstChild, layout.plate ? "Plate" : "Network (estimates, but for what reads)");
    this.plate = layout.plate ? new Plate(this.plateBox, layout) : new Network(this.plateBox, layout);
    this.charts = new Charts(this.chartBox, this.dutyBox, layout, this.series, this.uPlot);
    this.parametersPart.hidden = !layout.uncertain.length;
    this.parameterCharts = new ParameterCharts(this.parameterBox, layout.uncertain, this.charts.axes, this.uPlot);
    this.dutyValues = layout.driven.map(() => make("span"));
    this.dutyLegend.replaceChildren(...layout.driven.map((part, k) => {
      const key = make("span", { class: "key line" }, `${part.name} `, this.dutyValues[k]);
      key.style.setProperty("--key", dutyColour(k));
      return key;
    }));
    if (before) this.load().catch(() => {});
  }

  #sample(sample) {
    if (!this.layout) return;
    this.now = sample;
    this.series.add(sample);
    const time = performance.now();
    if (calm.matches && time - this.drawn < 1000) return;
    this.drawn = time;
    this.plate.sample(sample);
    this.#drawHottest();
    this.dutyValues.forEach((element, k) => setText(element, `${numberText(100 * sample.duty[k], 0)} %`));
    if (time - this.charted >= CHART_MS) this.#drawCharts();
  }

  #drawCharts() {
    this.charted = performance.now();
    this.charts?.draw(this.ahead);
    this.parameterCharts?.draw(this.layout.uncertain);
    this.#drawValues();
  }

  #outlook(outlook) {
    this.ahead = outlook;
    this.plate?.outlook(outlook); // none before the layout
    const power = outlook.power.reduce((sum, one) => sum + one, 0);
    const energy = outlook.energy < 3600 ? `${numberText(outlook.energy, 0)} J` : `${numberText(outlook.energy / 3600, 2)} Wh`;
    setText(this.energy, `Power ${numberText(power, 1)} W, energy since the server began ${energy} (estimates).`);
    const { layout } = this;
    if (!layout) return;
    this.series.know(outlook);
    setRows(this.parameterRows, layout.uncertain.map(({ name, unit, value }, k) => {
      const [mean, lower, upper] = ["parameter", "parameter_lower", "parameter_upper"]
        .map((part) => significantText(outlook[part][k]));
      return [`${name}, ${unit}`, mean, `${lower} to ${upper}`, significantText(value)];
    }));
    setRows(this.unseenRows, [
      ...layout.nodes.map((name, k) => [`${name.replace(/(.*)\.SENSOR$/, "sensor of $1")}, °C`, numberText(outlook.nodes[k]),
        numberText(outlook.nodes_band[k]), numberText(outlook.nodes_later[k])]),
      ["room, °C", numberText(outlook.room), numberText(outlook.room_band), ""],
      ...layout.driven.map((part, k) => [`unexplained heat at ${part.name}, W`,
        ...watts(outlook.heats[k], outlook.heats_band[k]), ""]),
    ]);
  }

  /** The hottest channel now and in a minute, to be read from across a room. */
  #drawHottest() {
    const { now, ahead, layout } = this;
    const known = now.measured.map((value) => value ?? -Infinity);
    const k = known.indexOf(Math.max(...known));
    const { name } = layout.channels[k];
    setText(this.hottest, now.measured[k] === null ? "–" : `${numberText(now.measured[k])} °C`);
    setText(this.hottestText, known.length > 1 ? `${name}, the hottest of ${known.length}` : name);
    const later = ahead?.forecast.at(-1)[k];
    const { number } = this.answers.minute;
    number.hidden = later === undefined;
    setText(number, `${name} ${numberText(later)} °C`);
  }

  #drawValues() {
    const { now, ahead, layout } = this;
    if (!now) return;
    setRows(this.valueRows, layout.channels.map((channel, k) => {
      const [measured, expected] = [now.measured[k], now.expected[k]];
      return [channel.name, measured === null ? "failed" : numberText(measured, 2), numberText(expected, 2),
        measured === null ? "–" : signedText(measured - expected, 2), numberText(ahead?.channels_later[k], 1)];
    }));
  }

  #story(story) {
    let changed = false;
    for (const [name, answer] of Object.entries(this.answers)) {
      const { level, text, since, until } = story[name];
      const times = since === null ? "" : until === null ? `, since ${timeText(since).replace(/:\d\d$/, "")}`
        : `, ${timeText(since)} to ${timeText(until)}`;
      const head = `${story[name].head}${times}`;
      changed ||= answer.head.textContent !== head;
      answer.card.className = `answer ${level}`;
      setText(answer.sign, SIGNS[level]);
      setText(answer.level, `${WORDS[level]}: `);
      setText(answer.head, minus(head));
      setText(answer.text, minus(text));
    }
    this.acknowledge.hidden = !(this.twinAction && story.new);
    const time = performance.now();
    if (changed && time - this.spoken > (this.spoken ? SPEAK_MS / 6 : 0)) {
      this.spoken = time;
      setText(this.spokenText, Object.keys(QUESTIONS).map((name) => `${story[name].head}.`).join(" "));
    }
  }

  #findings(findings) {
    setRows(this.findingRows, findings.map((one) => [
      timeText(one.since ?? one.found),
      make("span", { class: one.until === null ? `mark ${one.severity}` : "mark over" },
        minus(one.until === null ? one.detail : `${one.detail} (over)`)),
      one.size === null ? "–" : `${signedText(one.size, 2)} ${one.unit}`,
      one.probability === null ? "–" : `${numberText(100 * one.probability, 0)} %`,
    ]));
    if (!findings.length) setRows(this.findingRows, [["–", "nothing was found", "", ""]]);
  }

  #diagnosis(found) {
    this.plate?.suspect(found.causes.flatMap(suspects));
    if (found.state === "none") {
      this.causes.replaceChildren();
      return;
    }
    const heading = make("h3", {}, "Why (estimate)");
    const notes = [];
    if (found.state === "awaited") notes.push(make("p", {}, "A diagnosis follows, one minute and five minutes after the finding."));
    if (found.state === "running") notes.push(make("p", {}, "The last minutes are being diagnosed …"));
    if (found.state === "failed") notes.push(make("p", {}, `Not diagnosed: ${found.text}`));
    const causes = found.causes.map((cause) => make("div", { class: "cause" },
      ...cause.explanations.filter((one, k) => k === 0 || one.probability >= 0.005).slice(0, 5).map((one) => {
        const percent = Math.round(100 * one.probability);
        const size = one.size === null || one.unit === "multiple" ? "" : ` (${numberText(one.lower, 2)} to ${numberText(one.upper, 2)})`;
        return make("div", { class: "bar-row" },
          make("span", { class: "name" }, minus(`${one.phrase}${size}, since ${timeText(one.onset)}`)),
          make("progress", { max: "100", value: String(percent), "aria-label": one.name }),
          make("span", { class: "number" }, `${percent} %`));
      })));
    if (found.state === "done" && !causes.length) {
      notes.push(make("p", {}, "No fault explains it better than a healthy rig."));
    }
    this.causes.replaceChildren(heading, ...causes, ...notes);
  }

  #twins(twins) {
    this.twinsPart.hidden = false;
    const isAllowed = this.twinAction && this.layout?.control;
    this.refit.hidden = !isAllowed;
    setRows(this.twinRows, twins.versions.map((one) => {
      const roles = make("span", {}, one.aliases.join(", "));
      if (isAllowed && one.number !== twins.followed) {
        const isPrevious = one.aliases.includes("previous");
        roles.append(" ", make("button", {
          type: "button", click: () => this.twinAction(isPrevious ? "rollback" : "promote", one.number),
        }, isPrevious ? "Roll back" : "Promote"));
      }
      return [`${one.number}`, timeText(Date.parse(one.made) / 1000), one.reason, roles];
    }));
  }

  #log(lines) {
    this.lines.replaceChildren(...lines.toReversed().map((line) => make("li", { class: line.level },
      make("time", { datetime: new Date(line.t * 1000).toISOString() }, timeText(line.t)),
      make("span", {}, ` ${minus(line.text)}`))));
  }
}

/** A heat and its band with enough digits, W. */
function watts(heat, band) {
  const digits = band < 0.1 ? 3 : 2;
  return [signedText(heat, digits), numberText(band, digits)];
}

/** A text of the server, in which a minus is a hyphen. */
const minus = (text) => text.replace(/(^|[ (±])-(?=\d)/g, "$1−");

/** What of a layout the charts are made for. */
function drawnOf({ channels, uncertain }) {
  return JSON.stringify([channels, uncertain.map(({ name }) => name)]);
}

export { zoneName };
