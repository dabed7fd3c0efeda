// Plots one can touch: the values of the nearest point, zoom, turning; by mouse, finger and keyboard.
// The picture is its own data: each svg.plot is drawn already, and is drawn again from what its paths hold.

const POINT = /([ML])(-?[\d.]+) (-?[\d.]+)/g;
const numbers = (node, name) => (node.getAttribute(name) ?? "").split(" ").filter(Boolean).map(Number);
const between = (value, low, high) => Math.min(Math.max(value, low), high);

function ticks([low, high]) {
  const rough = (high - low) / 5, magnitude = 10 ** Math.floor(Math.log10(rough));
  const step = magnitude * [1, 2, 5, 10].find((s) => s * magnitude >= rough * 0.999);
  const count = Math.floor(high / step + 1e-9) - Math.ceil(low / step - 1e-9) + 1;
  return Array.from({ length: Math.max(count, 0) }, (_, k) => +((Math.ceil(low / step - 1e-9) + k) * step).toPrecision(10));
}

class Plot {
  constructor(svg) {
    this.svg = svg;
    [this.axes, this.area] = svg.children;
    const [left, top, width, height] = ["x", "y", "width", "height"].map((name) => Number(this.area.getAttribute(name)));
    const [, , all, high] = numbers(svg, "viewBox");
    Object.assign(this, { left, top, width, height, shape: height / width, right: all - left - width, bottom: high - top - height });
    this.turns = svg.classList.contains("turns");
    this.equal = svg.classList.contains("equal");
    this.labels = (svg.dataset.labels ?? "").split("|");
    this.home = { x: numbers(svg, "data-x"), y: numbers(svg, "data-y") };
    this.view = this.home;
    this.turned = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    this.marks = [...this.area.children].map((node) => this.mark(node));
    this.touched = this.marks.filter((mark) => mark.name);
    this.at = null;
    this.controls();
    svg.setAttribute("tabindex", 0);
    svg.setAttribute("role", "application");
    svg.setAttribute("aria-roledescription", "plot");
    new ResizeObserver(() => this.resize()).observe(svg);
    for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel", "pointerleave", "keydown"]) svg.addEventListener(name, (event) => this[name](event));
    svg.addEventListener("dblclick", () => this.zoom(0.5));
  }

  mark(node) {
    const [x0, x1] = this.home.x, [y0, y1] = this.home.y, depth = numbers(node, "data-z");
    const found = node.tagName === "text" ? [["", "", node.getAttribute("x"), node.getAttribute("y")]] : [...node.getAttribute("d").matchAll(POINT)];
    const points = found.map(([, letter, x, y], k) => [
      x0 + (x / this.width) * (x1 - x0), y1 - (y / this.height) * (y1 - y0), ((depth[k] ?? 0) / this.width) * (x1 - x0), letter]);
    const name = node.querySelector("title")?.textContent;
    node.querySelector("title")?.remove(); // said by us from here on
    return { node, points, name, end: node.classList.contains("dots") ? "h0" : "", close: node.classList.contains("band") ? "Z" : "" };
  }

  controls() {
    const box = document.createElement("div");
    box.className = "hand";
    this.told = document.createElement("output");
    box.append(this.told, ...[["+", "Zoom in", 0.5], ["−", "Zoom out", 2], ["⟲", "All of it", 0]].map(([text, words, factor]) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = text;
      button.title = words;
      button.setAttribute("aria-label", `${words}: ${this.svg.getAttribute("aria-label")}`);
      button.addEventListener("click", () => this.zoom(factor));
      return button;
    }));
    this.svg.after(box);
    this.spot = this.area.appendChild(document.createElementNS(this.svg.namespaceURI, "circle"));
    this.frame = this.area.appendChild(document.createElementNS(this.svg.namespaceURI, "rect"));
    this.spot.setAttribute("class", "spot");
    this.frame.setAttribute("class", "frame");
  }

  // --- drawing --------------------------------------------------------------------------------

  // As wide as it is shown: words keep their size on a phone and on a desk.
  resize() {
    const width = this.svg.clientWidth - this.left - this.right;
    if (width < 40 || width === this.width) return;
    if (this.equal) this.height = width * this.shape;
    this.width = width;
    this.svg.setAttribute("viewBox", `0 0 ${width + this.left + this.right} ${this.height + this.top + this.bottom}`);
    this.area.setAttribute("width", width);
    this.area.setAttribute("height", this.height);
    this.draw();
  }

  place([x, y, z]) {
    if (this.turns) [x, y] = this.turned.map((row) => row[0] * x + row[1] * y + row[2] * z);
    const { x: [x0, x1], y: [y0, y1] } = this.view;
    return [((x - x0) / (x1 - x0)) * this.width, ((y1 - y) / (y1 - y0)) * this.height];
  }

  draw() {
    if (!this.turns) this.drawAxes();
    this.svg.classList.toggle("zoomed", this.view !== this.home);
    for (const { node, points, end, close } of this.marks) {
      const placed = points.map((point) => this.place(point));
      if (node.tagName === "text") ["x", "y"].forEach((name, k) => node.setAttribute(name, placed[0][k].toFixed(1)));
      else node.setAttribute("d", placed.map(([x, y], k) => `${points[k][3]}${x.toFixed(1)} ${y.toFixed(1)}${end}`).join("") + close);
    }
    if (this.at) this.show(this.at);
  }

  drawAxes() {
    const { left, top, width, height } = this, pieces = [], bottom = top + height, right = left + width;
    const put = (name, attributes, text = "") => {
      const node = document.createElementNS(this.svg.namespaceURI, name);
      for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
      node.textContent = text;
      pieces.push(node);
    };
    const given = this.view === this.home && numbers(this.svg, "data-ticks");
    const every = Math.ceil(((given.length || 1) * 26) / width); // no words over each other
    for (const tick of given.length ? given.filter((_, k) => k % every === 0) : ticks(this.view.x)) {
      const x = left + this.place([tick, 0])[0];
      put("line", { class: tick ? "grid" : "zero", x1: x, x2: x, y1: top, y2: bottom });
      put("text", { class: "tick", x, y: bottom + 14 }, tick);
    }
    for (const tick of ticks(this.view.y)) {
      const y = top + this.place([0, tick])[1];
      put("line", { class: tick ? "grid" : "zero", x1: left, x2: right, y1: y, y2: y });
      put("text", { class: "tick side", x: left - 6, y, dy: "0.32em" }, tick);
    }
    put("text", { class: "label", x: (left + right) / 2, y: bottom + this.bottom - 4 }, this.labels[0]);
    put("text", { class: "label", transform: `translate(11 ${top + height / 2}) rotate(-90)` }, this.labels[1]);
    this.axes.replaceChildren(...pieces);
  }

  // --- values ---------------------------------------------------------------------------------

  show(at) {
    this.at = at;
    const point = at.mark.points[at.k], [cx, cy] = this.place(point);
    for (const [name, value] of Object.entries({ cx, cy, r: 5 })) this.spot.setAttribute(name, value);
    const said = this.turns
      ? `${Math.hypot(...point.slice(0, 3)).toFixed(0)} mG long`
      : this.labels.map((label, axis) => {
          const [name, unit] = label.split(/, (?=\S+$)/), [low, high] = this.home["xy"[axis]];
          const digits = between(2 - Math.floor(Math.log10(high - low)), 0, 6);
          return unit === undefined ? `${point[axis].toFixed(digits)} ${name}` : `${name} ${point[axis].toFixed(digits)} ${unit}`;
        }).join(", ");
    this.told.textContent = `${at.mark.name}: ${said}`;
  }

  nearest([x, y]) {
    let best = Infinity, found = null;
    for (const mark of this.touched) mark.points.forEach((point, k) => {
      const [px, py] = this.place(point), off = (px - x) ** 2 + (py - y) ** 2;
      const seen = px >= -1 && px <= this.width + 1 && py >= -1 && py <= this.height + 1;
      if (off < best && seen) [best, found] = [off, { mark, k }];
    });
    return found;
  }

  step(marks, points) {
    const { mark, k } = this.at ?? { mark: this.touched[0], k: -1 };
    const next = this.touched[(this.touched.indexOf(mark) + marks + this.touched.length) % this.touched.length];
    this.show({ mark: next, k: between(k + points, 0, next.points.length - 1) });
  }

  // --- hands ----------------------------------------------------------------------------------

  pointer(event) {
    const box = this.svg.getBoundingClientRect(), scale = numbers(this.svg, "viewBox")[2] / box.width;
    return [(event.clientX - box.left) * scale - this.left, (event.clientY - box.top) * scale - this.top];
  }

  pointerdown(event) {
    if (!event.isPrimary || event.button) return;
    this.from = this.pointer(event);
    this.svg.setPointerCapture(event.pointerId);
  }

  pointermove(event) {
    const to = this.pointer(event), from = this.from;
    if (from && this.turns) {
      this.turn((to[0] - from[0]) / 120, (to[1] - from[1]) / 120);
      this.from = to;
    } else if (from && event.pointerType === "mouse") {
      const corner = from.map((v, k) => Math.min(v, to[k])), size = from.map((v, k) => Math.abs(v - to[k]));
      ["x", "y", "width", "height"].forEach((name, k) => this.frame.setAttribute(name, [...corner, ...size][k]));
    } else {
      const found = this.nearest(to);
      if (found) this.show(found);
    }
  }

  pointerup(event) {
    const to = this.pointer(event), from = this.from;
    this.pointercancel();
    if (!from || this.turns) return;
    const size = from.map((v, k) => Math.abs(v - to[k]));
    if (event.pointerType === "mouse" && Math.max(...size) > 10) {
      const wide = Math.max(size[0] / this.width, size[1] / this.height);
      const part = this.equal ? [wide, wide] : [size[0] / this.width, Math.max(size[1] / this.height, 0.02)];
      this.look(from.map((v, k) => (v + to[k]) / 2), part);
    } else this.pointermove(event);
  }

  pointercancel() {
    this.from = null;
    this.frame.setAttribute("width", 0);
  }

  pointerleave() {
    if (!this.from && document.activeElement !== this.svg) this.told.textContent = "";
  }

  keydown(event) {
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const factor = { "+": 0.5, "=": 0.5, "-": 2, 0: 0, Escape: 0 }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || (!arrow && factor === undefined)) return;
    event.preventDefault();
    if (!arrow) this.zoom(factor);
    else if (this.turns) this.turn(arrow[0] * 0.15, arrow[1] * 0.15);
    else this.step(arrow[1], arrow[0]);
  }

  turn(side, over) {
    const [c, s, d, t] = [Math.cos(side), Math.sin(side), Math.cos(over), Math.sin(over)];
    const by = [[c, 0, s], [s * t, d, -c * t], [-s * d, t, c * d]];
    this.turned = by.map((row) => [0, 1, 2].map((k) => row.reduce((sum, v, j) => sum + v * this.turned[j][k], 0)));
    this.draw();
  }

  // About the chosen point, else the middle; 0 is all of it.
  zoom(factor) {
    const middle = this.at && !this.turns ? this.place(this.at.mark.points[this.at.k]) : [this.width / 2, this.height / 2];
    if (factor) this.look(middle, [factor, factor]);
    else this.look(null);
  }

  look(middle, part) {
    const zoomed = middle && ["x", "y"].map((axis, k) => {
      const [low, high] = this.view[axis], share = middle[k] / [this.width, this.height][k];
      const at = axis === "x" ? low + share * (high - low) : high - share * (high - low), half = ((high - low) * part[k]) / 2;
      const [least, most] = this.home[axis], inside = half * 2 < most - least ? between(at, least + half, most - half) : at;
      return [inside - half, inside + half];
    });
    const least = zoomed && (zoomed[0][1] - zoomed[0][0]) / (this.home.x[1] - this.home.x[0]);
    this.view = !zoomed || least >= 1 || least < 1e-3 ? this.home : { x: zoomed[0], y: zoomed[1] };
    this.draw();
  }
}

export const touch = (svg) => new Plot(svg);
document.querySelectorAll("svg.plot").forEach(touch);
