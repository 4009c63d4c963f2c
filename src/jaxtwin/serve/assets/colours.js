// Colours of temperatures and of differences. Both scales are told apart with any colour vision.

const HEAT = [[20, 11, 53], [101, 21, 110], [187, 55, 84], [249, 142, 9], [252, 255, 164]];
const APART = [[0, 90, 160], [110, 170, 215], [240, 240, 240], [240, 160, 100], [190, 75, 0]];

function between(stops, part) {
  const place = Math.min(Math.max(part, 0), 1) * (stops.length - 1);
  const lower = Math.min(Math.floor(place), stops.length - 2);
  const rest = place - lower;
  return stops[lower].map((value, k) => Math.round(value + rest * (stops[lower + 1][k] - value)));
}

/** Of a temperature at a part of its range, 0 to 1: red, green, blue. */
export const heatColour = (part) => between(HEAT, part);

/** Of a difference, -1 to 1. */
export const apartColour = (part) => between(APART, (part + 1) / 2);

export const cssColour = (rgb) => `rgb(${rgb.join(" ")})`;

/** Black or white, whichever is easier to read on a colour. */
export function inkOn([red, green, blue]) {
  return 0.299 * red + 0.587 * green + 0.114 * blue > 140 ? "#111" : "#fff";
}
