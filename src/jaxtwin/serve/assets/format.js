// Numbers and times as text, and elements of a page.

const clock = new Intl.DateTimeFormat(undefined, {
  hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23",
});
const day = new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short" });

/** The name of the local time zone, such as "CET". */
export function zoneName() {
  const parts = new Intl.DateTimeFormat(undefined, { timeZoneName: "short" }).formatToParts();
  return parts.find((part) => part.type === "timeZoneName")?.value ?? "";
}

/** A time, s since 1970, in the local zone; with its day if it is not of today. */
export function timeText(seconds) {
  const date = new Date(seconds * 1000);
  const text = clock.format(date);
  return date.toDateString() === new Date().toDateString() ? text : `${day.format(date)} ${text}`;
}

/** A number with the given digits after the point, and a real minus; "–" if it is missing. */
export function numberText(value, digits = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  // -0.0 is 0.0
  return Number(text) === 0 ? (0).toFixed(digits) : text.replace("-", "−");
}

/** The same with its sign. */
export function signedText(value, digits = 1) {
  const text = numberText(value, digits);
  return text === "–" || text.startsWith("−") || Number(text) === 0 ? text : `+${text}`;
}

/** A number with four digits, whatever its size; "–" if it is missing. */
export function significantText(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return value.toPrecision(4).replace(/^-/, "−").replace(/e([+-])/, (_, sign) => (sign === "-" ? "e−" : "e"));
}

/** Makes an element. A function among the attributes listens to the event of that name. */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

/** Sets the text of an element if it is another one, so that nothing is drawn in vain. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Replaces the rows of a table's body. A row is a list of texts or elements, the first its head. */
export function setRows(body, rows) {
  body.replaceChildren(
    ...rows.map(([head, ...cells]) =>
      make("tr", {}, make("th", { scope: "row" }, head), ...cells.map((cell) => make("td", {}, cell))),
    ),
  );
}
