// Whether a source that should be heard all the time has fallen silent.

const SILENT_MS = 3000;
const LOOK_MS = 500;

/**
 * Calls `show` with whether nothing was heard for some seconds, at each look.
 *
 * - `isExpected`: whether anything should be heard: not of a recording, which ends by itself.
 * - `now`: the time, ms.
 */
export class Silence {
  constructor(show, now = () => performance.now()) {
    Object.assign(this, { show, now, isExpected: true, heard: now() });
    this.timer = setInterval(() => this.look(), LOOK_MS);
  }

  hear() {
    this.heard = this.now();
    this.look();
  }

  look() {
    this.show(this.isExpected && this.now() - this.heard > SILENT_MS);
  }

  end() {
    clearInterval(this.timer);
  }
}
