// Results as pieces of the page: calibration, check, gap report, history. Text goes in as text only.

import { beforeAndAfter, deviationPlot } from "./draw.js";

export function node(name, options = {}, ...children) {
  const { text, ...rest } = options;
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(rest)) {
    if (key === "class") made.className = value;
    else if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else made.setAttribute(key, value);
  }
  if (text !== undefined) made.textContent = text;
  made.append(...children);
  return made;
}

const fixed = (value, digits = 1) => (value === null || value === undefined ? "–" : Number(value).toFixed(digits));

// --- calibration --------------------------------------------------------------------------------

export function calibration(document) {
  const good = document.compasses.every((compass) => compass.accepted);
  const words = !good ? "Not accepted" : document.written ? "Calibrated, written, read back" : "Solved, not written";
  const pieces = [node("p", { class: `verdict ${good ? (document.written ? "good" : "warn") : "bad"}`, text: words })];
  for (const message of document.messages ?? []) pieces.push(node("p", { class: "soft", text: message }));
  for (const compass of document.compasses) {
    const both = (document.old_and_new ?? []).find((entry) => entry.instance === compass.instance);
    const one = node("details", { class: "compass" }, ...oneCompass(compass, both));
    one.open = !compass.accepted || compass === document.compasses[0];
    pieces.push(one);
  }
  return pieces;
}

// What a write would change of one compass, read in a second.
export function proposal(one) {
  const known = (value, digits) => (value === null ? "?" : `${fixed(value, digits)}°`);
  const words = !one.accepted ? "not accepted; nothing is written for it"
    : one.already_right ? `already right, within ${known(Math.max(one.after_deg, one.before_deg), 2)}` : null;
  const figures = words
    ? node("p", { text: words, class: one.accepted ? "soft" : "bad" })
    : node("p", { class: "change" }, node("span", { class: "old", text: known(one.before_deg, 1) }), document_text(" → "),
        node("span", { class: "new", text: known(one.after_deg, 2) }), node("small", { text: " off" }));
  const drawn = !words && one.old_circle.length ? [beforeAndAfter(one)] : [];
  return node("figure", {}, ...drawn, node("figcaption", {}, node("b", { text: `Compass ${one.instance}` }), figures));
}

function oneCompass(compass, both) {
  const sigma = compass.heading_sigma_deg;
  const brief = compass.accepted ? ` within ${fixed(sigma, 2)}°` : " not accepted";
  const pieces = [node("summary", {}, node("b", { text: `Compass ${compass.instance}` }), document_text(brief))];
  const sentence = compass.accepted
    ? `Heading within ${fixed(sigma, 2)}° (one sigma). The old values were ${fixed(compass.heading_change_deg)}° off.`
    : "Nothing written for it.";
  pieces.push(node("p", { text: sentence }));
  for (const reason of compass.reasons) pieces.push(node("p", { class: "bad", text: reason }));
  for (const warning of compass.warnings ?? []) pieces.push(node("p", { class: "soft", text: warning }));
  const left = node("div", {}, ...(both ? oldAndNew(both) : [])), right = node("div", {}, ...budget(compass));
  pieces.push(node("div", { class: "two" }, left, right));
  if (both && both.deviation.length) pieces.push(...card(both.deviation, sigma));
  return pieces;
}

function oldAndNew({ old, new: fresh }) {
  const table = node("table", {}, row("th", "value", "old", "new"));
  const add = (name, a, b, digits) => table.append(row("td", name, fixed(a, digits), fixed(b, digits)));
  ["X", "Y", "Z"].forEach((axis, k) => add(`offset ${axis}, mG`, old.offsets_mgauss[k], fresh.offsets_mgauss[k], 1));
  ["X", "Y", "Z"].forEach((axis, k) => add(`diagonal ${axis}`, old.diagonals[k], fresh.diagonals[k], 3));
  ["XY", "XZ", "YZ"].forEach((pair, k) => add(`off-diagonal ${pair}`, old.off_diagonals[k], fresh.off_diagonals[k], 3));
  add("scale", old.scale, fresh.scale, 3);
  return [node("h3", { text: "Old and new" }), node("div", { class: "scroll" }, table)];
}

function row(cell, ...texts) {
  return node("tr", {}, ...texts.map((text) => node(cell, { text })));
}

function budget(compass) {
  const parts = Object.entries(compass.heading_error_budget_deg ?? {})
    .filter(([, value]) => value !== null)
    .sort((a, b) => b[1] - a[1]);
  if (!parts.length) return [];
  const most = parts[0][1] || 1;
  const grid = node("div", { class: "budget" });
  for (const [name, value] of parts) {
    const bar = node("i");
    bar.style.width = `${(100 * value) / most}%`;
    const text = value < 0.005 ? "< 0.01°" : `${fixed(value, 2)}°`;
    grid.append(node("span", { text: name.replaceAll("_", " ") }), node("span", {}, bar), node("span", { text }));
  }
  return [node("h3", { text: "Error budget, one sigma" }), grid];
}

function card(rows, sigma) {
  const table = node("table", {}, row("th", "heading", "old was off", "heading", "old was off"));
  const half = Math.ceil(rows.length / 2);
  for (let k = 0; k < half; k++) {
    const cells = [rows[k], rows[k + half]].flatMap((r) => (r ? [`${r.heading_deg}°`, signed(r.old_error_deg)] : ["", ""]));
    table.append(row("td", ...cells));
  }
  const list = node("details", {}, node("summary", { text: "As a table" }), node("div", { class: "scroll" }, table));
  return [node("h3", { text: "Deviation card: how far the old calibration was off" }), deviationPlot(rows, sigma), list];
}

const signed = (value) => `${value > 0 ? "+" : ""}${fixed(value)}°`;

// --- check --------------------------------------------------------------------------------------

export function check(document) {
  const css = { pass: "good", warn: "warn", fail: "bad" };
  const rank = { fail: 0, warn: 1, pass: 2 };
  const list = node("ul", { class: "items" });
  for (const item of [...document.items].sort((a, b) => rank[a.verdict] - rank[b.verdict])) {
    const line = node("li", {}, node("b", { class: css[item.verdict], text: item.verdict }), document_text(item.text));
    if (item.remedy) line.append(node("small", { text: item.remedy }));
    list.append(line);
  }
  return [node("p", { class: `verdict ${css[document.verdict]}`, text: document.summary }), list];
}

const document_text = (text) => window.document.createTextNode(text);

// --- gap ----------------------------------------------------------------------------------------

export function gap(document) {
  const pieces = [node("p", { class: "verdict", text: `Gap: ${String(document.verdict).replaceAll("_", " ")}` })];
  const table = node("table", {}, row("th", "cause", "probability"));
  for (const cause of document.causes ?? []) table.append(row("td", cause.effect, fixed(cause.probability, 2)));
  if ((document.causes ?? []).length) pieces.push(table);
  const shrink = document.gap?.field_rms_mgauss?.shrink;
  if (shrink !== null && shrink !== undefined) pieces.push(node("p", { text: `The named causes close ${fixed(100 * shrink, 0)} % of the gap in the field.` }));
  return pieces;
}

// --- history ------------------------------------------------------------------------------------

export function historyLine(entry, acts) {
  const when = new Date(entry.made_at);
  const shown = Number.isNaN(when.valueOf()) ? entry.made_at : when.toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
  const buttons = node("div", { class: "acts" });
  buttons.append(node("button", { text: "Show", onclick: () => acts.show(entry.id) }));
  if (entry.has_report) buttons.append(node("a", { href: `/api/history/${entry.id}/report`, target: "_blank", rel: "noopener", text: "Report" }));
  if (entry.undo_file && entry.kind === "calibration" && !entry.undone_by) buttons.append(node("button", { text: "Undo", onclick: () => acts.undo(entry.id) }));
  if (entry.kind === "calibration" && entry.compasses.length) buttons.append(node("button", { text: "Explain the gap", onclick: () => acts.gap(entry.id) }));
  const css = entry.undone_by ? "soft" : entry.ok ? "good" : "bad";
  const mark = node("span", { class: css, text: entry.undone_by ? "undone" : entry.ok ? "ok" : "no" });
  const words = node("div", {}, node("b", { text: entry.kind }), document_text(` · ${entry.summary}`));
  return node("li", { "data-kind": entry.kind }, words, mark, node("time", { datetime: entry.made_at, text: shown }), buttons);
}
