// The history of the channels in the browser: intervals of one length, at most some hundred.

const MOST = 900;
const OF_CHANNELS = ["low", "high", "mean", "expected", "band"];
const OF_PARAMETERS = ["parameter", "parameter_lower", "parameter_upper"];
const KEPT = [...OF_CHANNELS, "duty", ...OF_PARAMETERS]; // what a history has

/** What is drawn over time. `load` takes the answer of /history, `add` a sample of the stream, and
 * `know` what an outlook says of uncertain parameters, which holds for the samples after it. */
export class Series {
  constructor(channels, cells, parameters = 0) {
    Object.assign(this, { channels, cells, parameters });
    this.known = null;
    this.span = 300;
    this.width = 1;
    this.clear();
  }

  clear() {
    this.time = [];
    const lists = (count) => Array.from({ length: count }, () => []);
    for (const name of [...OF_CHANNELS, "count"]) this[name] = lists(this.channels);
    for (const name of OF_PARAMETERS) this[name] = lists(this.parameters);
    this.duty = lists(this.cells);
  }

  /** Takes a history. What is older than it, from before the server began anew, is kept. */
  load(history, keep) {
    const before = keep ? this.#before(history.time[0] ?? Infinity) : null;
    this.clear();
    this.width = history.width;
    this.time = [...(before?.time ?? []), ...history.time];
    for (const name of KEPT) {
      this[name] = (history[name] ?? []).map((values, k) => [...(before?.[name][k] ?? []), ...values]);
    }
    this.count = this.mean.map((values) => values.map(() => 1));
    this.#forget();
  }

  add(sample) {
    const begin = Math.floor(sample.t / this.width) * this.width;
    const last = this.time.length - 1;
    if (last >= 0 && begin < this.time[last]) return;
    const isNew = last < 0 || begin > this.time[last];
    if (isNew) this.time.push(begin);
    const at = this.time.length - 1;
    for (let k = 0; k < this.channels; k += 1) {
      const value = sample.measured[k];
      if (isNew || this.mean[k][at] === null) {
        this.low[k][at] = this.high[k][at] = this.mean[k][at] = value;
        this.count[k][at] = value === null ? 0 : 1;
      } else if (value !== null) {
        const count = (this.count[k][at] += 1);
        this.low[k][at] = Math.min(this.low[k][at], value);
        this.high[k][at] = Math.max(this.high[k][at], value);
        this.mean[k][at] += (value - this.mean[k][at]) / count;
      }
      this.expected[k][at] = sample.expected[k];
      this.band[k][at] = sample.band[k];
    }
    for (let k = 0; k < this.cells; k += 1) this.duty[k][at] = sample.duty[k];
    for (const name of OF_PARAMETERS) {
      for (let k = 0; k < this.parameters; k += 1) this[name][k][at] = this.known?.[name][k] ?? null;
    }
    this.#forget();
  }

  know(outlook) {
    this.known = outlook;
  }

  #before(time) {
    const end = this.time.findIndex((one) => one >= time);
    const stop = end < 0 ? this.time.length : end;
    const found = { time: this.time.slice(0, stop) };
    for (const name of KEPT) {
      found[name] = this[name].map((values) => values.slice(0, stop));
    }
    return found;
  }

  #forget() {
    const oldest = (this.time.at(-1) ?? 0) - this.span - this.width;
    let stop = this.time.findIndex((one) => one >= oldest);
    stop = Math.max(stop, this.time.length - MOST, 0);
    if (stop < 1) return;
    this.time.splice(0, stop);
    for (const name of [...KEPT, "count"]) {
      for (const values of this[name]) values.splice(0, stop);
    }
  }
}
