// Everything that is drawn: the rose, the field's circle, the deviation plot. SVG; plot.js is the reports' own.

import { touch } from "./plot.js";

const NS = "http://www.w3.org/2000/svg";
const RAD = Math.PI / 180;

export function element(name, attributes = {}, text = null) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== null) node.textContent = text;
  return node;
}

const at = (degrees, radius) => [radius * Math.sin(degrees * RAD), -radius * Math.cos(degrees * RAD)];

// --- the rose: the card turns, the bow is always up ---------------------------------------------

export class Rose {
  constructor(svg) {
    this.arc = element("path", { class: "r-arc" });
    this.card = element("g");
    for (const radius of [100, 74]) svg.append(element("circle", { r: radius, class: "r-ring" }));
    svg.append(this.arc, this.card);
    for (let degrees = 0; degrees < 360; degrees += 10) this.tick(degrees);
    ["N", "NE", "E", "SE", "S", "SW", "W", "NW"].forEach((name, k) => this.name(name, 45 * k));
    svg.append(element("path", { class: "r-boat", d: "M0-34C13-16 13 6 11 30L-11 30C-13 6-13-16 0-34Z" }));
    svg.append(element("path", { class: "r-lubber", d: "M0-84L6-101L-6-101Z" }));
    this.course = element("path", { class: "r-course", d: "M0-100L5-112L-5-112Z" });
    this.card.append(this.course);
    this.shown = null;
  }

  tick(degrees) {
    const big = degrees % 30 === 0;
    const [x1, y1] = at(degrees, 100), [x2, y2] = at(degrees, big ? 92 : 96);
    this.card.append(element("line", { x1, y1, x2, y2, class: big ? "r-tick big" : "r-tick" }));
    if (!big || degrees % 90 === 0) return;
    const [x, y] = at(degrees, 106);
    this.card.append(element("text", { x, y, class: "r-number", transform: `rotate(${degrees} ${x} ${y})` }, degrees));
  }

  name(name, degrees) {
    const [x, y] = at(degrees, 83);
    const css = name === "N" ? "r-name n" : name.length > 1 ? "r-name between" : "r-name";
    this.card.append(element("text", { x, y, class: css, transform: `rotate(${degrees} ${x} ${y})` }, name));
  }

  show(heading, sigma, course) {
    this.course.setAttribute("visibility", course === null ? "hidden" : "visible");
    if (course !== null) this.course.setAttribute("transform", `rotate(${course})`);
    // Turn the short way round, also through north.
    const before = this.shown ?? heading;
    this.shown = before + (((heading - before) % 360) + 540) % 360 - 180;
    this.card.setAttribute("transform", `rotate(${-this.shown.toFixed(2)})`);
    const half = Math.min(Math.max(2 * sigma, 0.4), 179.9);
    const [x1, y1] = at(-half, 100), [x2, y2] = at(half, 100), [x3, y3] = at(half, 40), [x4, y4] = at(-half, 40);
    const large = half > 90 ? 1 : 0;
    this.arc.setAttribute("d",
      `M${x1} ${y1}A100 100 0 ${large} 1 ${x2} ${y2}L${x3} ${y3}A40 40 0 ${large} 0 ${x4} ${y4}Z`);
  }
}

// --- the field as the vehicle turns -------------------------------------------------------------

const closed = (points) => `${line(points)}Z`;
const line = (points, digits = 1) => points.map((p, k) => `${k ? "L" : "M"}${p.map((v) => v.toFixed(digits)).join(" ")}`).join("");
// Forward is up.
const placing = (farthest, radius) => ([forward, right]) => [(right * radius) / farthest, (-forward * radius) / farthest];
const far = (points) => Math.max(0, ...points.map(([f, r]) => Math.hypot(f, r)));

// The last seconds, from above and from the side, against the Earth's field at this place.
export class Field {
  constructor(svg) {
    this.svg = svg;
    this.trail = [];
  }

  show({ instance, level_mgauss }, earth) {
    if (this.instance !== instance) this.trail = [];
    this.instance = instance;
    this.trail = [...this.trail.slice(-149), level_mgauss];
    const total = earth?.total_mgauss ?? 0, across = earth?.horizontal_mgauss ?? 0;
    const farthest = Math.max(total, 50, ...this.trail.map((field) => Math.hypot(...field)));
    const above = placing(farthest, 54), beside = ([forward, right, down]) => [
      120 + (Math.hypot(forward, right) * 54) / farthest, (down * 54) / farthest];
    const pieces = [];
    for (const middle of [0, 120]) pieces.push(
      element("line", { x1: middle - 58, x2: middle + 58, y1: 0, y2: 0, class: "c-axis" }),
      element("line", { y1: -58, y2: 58, x1: middle, x2: middle, class: "c-axis" }));
    if (earth) {
      const [cx, cy] = beside([across, 0, total * Math.sin(earth.dip_deg * RAD)]);
      pieces.push(element("circle", { r: (54 * across) / farthest, class: "c-earth" }), element("circle", { cx, cy, r: 6, class: "c-earth" }));
    }
    for (const [place, middle] of [[above, 0], [beside, 120]]) {
      const [cx, cy] = place(level_mgauss);
      pieces.push(
        element("path", { d: line(this.trail.map(place)), class: "f-trail" }),
        element("line", { x1: middle, x2: cx, y1: 0, y2: cy, class: "f-vector" }),
        element("circle", { cx, cy, r: 3, class: "c-now" }));
    }
    pieces.push(element("text", { x: 0, y: -61, class: "p-text" }, "ahead"), element("text", { x: 120, y: 67, class: "p-text" }, "down"));
    this.svg.replaceChildren(...pieces);
  }
}

export class Circle {
  constructor(svg) {
    this.svg = svg;
  }

  draw(trail, now, earth, planned) {
    const { points, positions, written } = trail ?? { points: [], positions: [], written: null };
    const farthest = Math.max(earth ?? 0, far(points), far([now]), 50), place = placing(farthest, 100);
    const pieces = [
      element("line", { x1: -112, x2: 112, y1: 0, y2: 0, class: "c-axis" }),
      element("line", { y1: -112, y2: 112, x1: 0, x2: 0, class: "c-axis" }),
    ];
    if (earth) pieces.push(element("circle", { r: (100 * earth) / farthest, class: "c-earth" }));
    const placed = points.map(place), cut = written ?? points.length;
    pieces.push(element("path", { d: line(placed.slice(0, cut)), class: "c-trail" }));
    pieces.push(element("path", { d: line(placed.slice(cut)), class: "c-trail c-after" }));
    const [cx, cy] = place(now);
    pieces.push(element("circle", { cx, cy, r: 5, class: "c-now" }));
    for (let k = 0; k < Math.max(planned, positions.length); k++) pieces.push(...this.spot(k, positions, place));
    this.svg.replaceChildren(...pieces);
  }

  spot(k, positions, place) {
    const lit = k < positions.length;
    // Until reached, it waits in a row below the circle.
    const [cx, cy] = lit ? place(positions[k]) : [-112 + 9 + 22 * k, 110];
    const css = lit ? "c-spot lit" : k === positions.length ? "c-spot next" : "c-spot";
    return [
      element("circle", { cx, cy, r: 9, class: css }),
      element("text", { x: cx, y: cy, class: lit ? "c-digit lit" : "c-digit" }, k + 1),
    ];
  }
}

// What the old calibration makes of the circle that the new one shows.
export function beforeAndAfter({ instance, old_circle, horizontal_mgauss }) {
  const svg = element("svg", { viewBox: "-60 -60 120 120", role: "img", "aria-label": `Compass ${instance}: the field before and after` });
  const place = placing(Math.max(horizontal_mgauss, far(old_circle), 1), 54);
  svg.append(
    element("line", { x1: -58, x2: 58, y1: 0, y2: 0, class: "c-axis" }),
    element("line", { y1: -58, y2: 58, x1: 0, x2: 0, class: "c-axis" }),
    element("path", { d: closed(old_circle.map(place)), class: "c-trail" }),
    element("circle", { r: -place([horizontal_mgauss, 0])[1], class: "c-trail c-after" }),
  );
  return svg;
}

// --- the deviation card as a line ---------------------------------------------------------------

export function deviationPlot(rows, sigma) {
  const most = 1.06 * Math.max(...rows.map((row) => Math.abs(row.old_error_deg)), sigma ?? 0, 1);
  const y = (error) => 70 - (error / most) * 70;
  const svg = element("svg", { viewBox: "0 0 418 186", class: "plot", role: "img", "aria-label": "Deviation of the old calibration",
    "data-x": "0 360", "data-y": `${-most} ${most}`, "data-labels": "heading, deg|error, deg", "data-ticks": "0 45 90 135 180 225 270 315 360" });
  const area = element("svg", { class: "area", x: 46, y: 12, width: 360, height: 140 });
  svg.append(element("g"), area);
  if (sigma) area.append(element("path", { class: "band new", d: line([[0, y(sigma)], [360, y(sigma)], [360, y(-sigma)], [0, y(-sigma)]], 2) }));
  const old = element("path", { class: "line old", d: line([...rows, { ...rows[0], heading_deg: 360 }].map((row) => [row.heading_deg, y(row.old_error_deg)]), 2) });
  old.append(element("title", {}, "old calibration"));
  area.append(old);
  const box = document.createElement("div");
  box.append(svg);
  touch(svg); // draws the axes
  return box;
}
