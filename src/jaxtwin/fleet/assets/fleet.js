// The page of a fleet: three answers, what several rigs have in common, and a line for each rig.

import { make, setText, timeText, zoneName } from "/assets/format.js";

const POLL_MS = 2000;
const LEVELS = ["critical", "warning", "notice", "unknown", "good"];
const SIGNS = { good: "✓", unknown: "…", notice: "i", warning: "!", critical: "‼" };
const WORDS = { good: "well", unknown: "not known", notice: "notice", warning: "warning", critical: "critical" };
const QUESTIONS = { rig: "Are the rigs well?", twin: "Are the twins right?", minute: "What comes next?" };

if (location.hash.length > 1) {
  sessionStorage.setItem("jaxtwin-token", decodeURIComponent(location.hash.slice(1)));
  history.replaceState(null, "", location.pathname);
}

const clock = make("p", { class: "clock" });
const subtitle = make("p", { class: "subtitle" });
const trouble = make("p", { class: "trouble", role: "alert", hidden: true });
const answers = {};
const story = make("div", { class: "story" });
for (const [name, question] of Object.entries(QUESTIONS)) {
  const sign = make("span", { class: "sign", "aria-hidden": "true" });
  const level = make("span", { class: "hidden" });
  const head = make("span");
  const text = make("p", { class: "text" });
  const card = make("section", { class: "answer unknown", "aria-label": question }, sign,
    make("div", {}, make("h2", {}, question), make("p", { class: "head" }, level, head), text));
  answers[name] = { card, sign, level, head, text };
  story.append(card);
}
const common = make("ul");
const trends = make("section", { class: "card trends", "aria-labelledby": "trends-title", hidden: true },
  make("h2", { id: "trends-title" }, "What several rigs have in common"), common);

const search = make("input", {
  type: "search", placeholder: "Search names, groups, findings …", "aria-label": "Search the rigs", input: () => show(),
});
let level = "", fleet = { rigs: [] };
const choice = make("fieldset", { class: "choice" }, make("legend", { class: "hidden" }, "Rigs shown"));
const chips = Object.fromEntries(["", ...LEVELS].map((name) => {
  const label = make("span", { class: name ? `chip ${name}` : "chip" });
  choice.append(make("label", {}, make("input", {
    type: "radio", name: "level", value: name, checked: name === "", change: () => { level = name; show(); },
  }), label));
  return [name, label];
}));
const shown = make("span", { class: "shown", role: "status" });
const lines = make("ul", { class: "lines" });
const heads = make("div", { class: "line heads", "aria-hidden": "true" },
  ...["", "Rig", "Group", "Is it well?", "Is its twin right?", "What comes next?"].map((head, k) =>
    make("span", { class: ["", "name", "group", "well", "twin", "next"][k] }, head)));
const list = make("section", { class: "card", "aria-labelledby": "rigs-title" },
  make("h2", { id: "rigs-title" }, "Rigs, the worst first"),
  make("div", { class: "tools" }, search, choice, shown), make("div", {}, heads, lines));
document.querySelector("#page").append(
  make("header", {}, make("div", {}, make("h1", {}, "Fleet"), subtitle), clock), trouble,
  make("main", { class: "fleet" }, story, trends, list),
  make("footer", {}, "What comes next, and why, are estimates of the twins."));

/** A line of a rig that can be changed. */
function newLine(name) {
  const part = (kind) => make("span", { class: kind });
  const parts = { dot: part("dot"), group: part("group"), head: part("head"), text: part("text"), twin: part("twin"), next: part("next") };
  const hidden = make("span", { class: "hidden" });
  const link = make("a", { class: "line", href: `/rigs/${encodeURIComponent(name)}` },
    make("span", {}, parts.dot, hidden), make("span", { class: "name" }, name), parts.group,
    make("span", { class: "well" }, parts.head, " ", parts.text), parts.twin, parts.next);
  return { ...parts, hidden, link, item: make("li", {}, link) };
}

const known = new Map();

function update(rig) {
  if (!known.has(rig.name)) known.set(rig.name, newLine(rig.name));
  const line = known.get(rig.name);
  const [rank, head, text] = rig.rig;
  const kind = `line ${rank}`;
  if (line.link.className !== kind) line.link.className = kind;
  setText(line.dot, SIGNS[rank]);
  setText(line.hidden, WORDS[rank]);
  setText(line.group, rig.group);
  setText(line.head, head);
  setText(line.text, text);
  for (const [place, [state, words]] of [["twin", rig.right], ["next", rig.next]]) {
    const look = `${place} ${state === "good" ? "" : `is-${state}`}`;
    if (line[place].className !== look) line[place].className = look;
    setText(line[place], words);
  }
  const title = `${rig.name} (${rig.group}): ${head}. ${text}`;
  if (line.link.title !== title) line.link.title = title;
  return line.item;
}

function show() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const isSought = (rig) => {
    const text = [rig.name, rig.group, ...rig.rig, ...rig.right, ...rig.next, rig.twin].join(" ").toLowerCase();
    return words.every((word) => text.includes(word));
  };
  const sought = fleet.rigs.filter(isSought);
  const counts = Object.fromEntries(LEVELS.map((name) => [name, sought.filter((rig) => rig.rig[0] === name).length]));
  for (const name of LEVELS) {
    setText(chips[name], `${SIGNS[name]} ${counts[name]} ${WORDS[name]}`);
    chips[name].parentElement.hidden = !counts[name] && level !== name;
  }
  setText(chips[""], `all ${sought.length}`);
  const rows = sought.filter((rig) => !level || rig.rig[0] === level)
    .sort((one, two) => LEVELS.indexOf(one.rig[0]) - LEVELS.indexOf(two.rig[0])
      || LEVELS.indexOf(one.right[0]) - LEVELS.indexOf(two.right[0])
      || one.name.localeCompare(two.name, undefined, { numeric: true }));
  const items = rows.map(update);
  if (!items.length) items.push(make("li", { class: "nothing" }, "No rig is like this."));
  const isSame = items.length === lines.children.length && items.every((item, k) => lines.children[k] === item);
  if (!isSame) lines.replaceChildren(...items);
  setText(shown, rows.length === fleet.rigs.length ? "" : `${rows.length} of ${fleet.rigs.length}`);
}

function take(content) {
  fleet = content;
  setText(clock, `${timeText(content.t)} ${zoneName()}`);
  setText(subtitle, `${content.rigs.length} rigs in ${new Set(content.rigs.map((rig) => rig.group)).size} groups`);
  for (const [name, answer] of Object.entries(answers)) {
    const { level: rank, head, text } = content.answers[name];
    answer.card.className = `answer ${rank}`;
    setText(answer.sign, SIGNS[rank]);
    setText(answer.level, `${WORDS[rank]}: `);
    setText(answer.head, head);
    setText(answer.text, text);
  }
  trends.hidden = !content.trends.length;
  const texts = content.trends.map((one) => one.text).join("\n");
  if (common.dataset.texts !== texts) {
    common.dataset.texts = texts;
    common.replaceChildren(...content.trends.map((one) => make("li", {}, make("button", {
      type: "button", title: one.rigs.join(", "),
      click: () => { search.value = one.group; level = ""; choice.querySelector("input").checked = true; show(); },
    }, one.text))));
  }
  trouble.hidden = !content.problems.length;
  setText(trouble, content.problems.slice(0, 4).join(" · "));
  show();
}

async function poll() {
  if (!document.hidden) {
    try {
      const answer = await fetch("/overview");
      if (!answer.ok) throw new Error(String(answer.status));
      take(await answer.json());
    } catch {
      trouble.hidden = false;
      setText(trouble, "No connection to the server. All that is shown is old; trying again …");
    }
  }
  setTimeout(poll, POLL_MS);
}

document.addEventListener("visibilitychange", () => document.hidden || show());
poll();
