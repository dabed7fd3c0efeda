// The page: listens to the stream, draws, and asks the service to do things. No library, no build step.

import { Circle, Field, Rose } from "./draw.js";
import * as show from "./show.js";

const $ = (id) => document.getElementById(id);
const rose = new Rose($("rose"));
const circle = new Circle($("circle"));
const field = new Field($("field"));

const page = { compass: 1, now: null, task: null, world: null, vehicle: null, drawn: null, oldest: null, trail: null };

// --- the token ----------------------------------------------------------------------------------

// It comes in the fragment, which browsers never send, or, from BlueOS's menu, as the end of the address. It leaves
// the address bar at once.
const entered = location.pathname.match(/^\/enter\/(.+)$/)?.[1] ?? new URLSearchParams(location.hash.slice(1)).get("token");
if (entered) {
  localStorage.setItem("mavcompass-token", decodeURIComponent(entered));
  history.replaceState(null, "", "/");
}
const token = () => localStorage.getItem("mavcompass-token") ?? "";

function showTokenBox() {
  $("token-box").hidden = Boolean(token());
}

$("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  localStorage.setItem("mavcompass-token", $("token").value.trim());
  $("token").value = "";
  refuse("");
  showTokenBox();
});

// --- asking the service -------------------------------------------------------------------------

function refuse(words) {
  $("refusal").textContent = words;
  $("refusal").hidden = !words;
}

async function get(path) {
  const response = await fetch(path);
  const answer = await response.json();
  if (!response.ok) throw new Error(answer.error ?? response.statusText);
  return answer;
}

async function post(path, body = {}) {
  refuse("");
  try {
    const response = await fetch(path, {
      method: "POST",
      headers: { "content-type": "application/json", authorization: `Bearer ${token()}` },
      body: JSON.stringify(body),
    });
    const answer = await response.json();
    if (response.status === 401) {
      localStorage.removeItem("mavcompass-token");
      showTokenBox();
    }
    if (!response.ok) throw new Error([answer.error, answer.remedy].filter(Boolean).join(" "));
    return answer;
  } catch (error) {
    refuse(error.message);
    return null;
  }
}

async function begin(path, body) {
  const task = await post(path, body);
  if (task) takeTask(task);
}

// Nothing is sent before the person has agreed.
function consent(text, agree) {
  const dialog = $("consent");
  $("consent-text").textContent = text;
  $("agree").textContent = agree;
  dialog.returnValue = "";
  dialog.showModal();
  return new Promise((done) => dialog.addEventListener("close", () => done(dialog.returnValue === "yes"), { once: true }));
}

const method = () => $("method").value;
const TURNS = { "four-positions": "four times by 90°", "touch-up": "by 90°" };
const armsFirst = () => method() in TURNS && page.vehicle?.armed === false && $("motion").value === "vehicle";

// Of a number that the service would not take the browser says why.
function numbers(...ids) {
  const fields = ids.map($);
  return fields.every((field) => field.reportValidity()) ? fields.map((field) => field.value) : null;
}

$("calibrate").addEventListener("click", async () => {
  const chosen = $("compasses").value;
  const body = { method: method(), motion: $("motion").value, writing: $("writing").value, compasses: chosen ? [Number(chosen)] : [] };
  const given = numbers("max-error", "true-heading", "true-heading-sigma");
  if (!given) return;
  body.max_error_deg = Number(given[0]);
  // Left empty it is a second antenna's, and the service says so where there is none.
  if (method() === "one-point" && given[1]) Object.assign(body, { true_heading_deg: Number(given[1]), true_heading_sigma_deg: Number(given[2]) });
  if (armsFirst()) {
    const copter = page.vehicle.kind === "copter";
    const flight = copter ? ", take off to 3 m, turn there, land" : " and turn on the spot";
    const text = `The vehicle is disarmed. May it be armed, change its flight mode${flight}? It is disarmed and put back into its mode afterwards. Keep clear; a stick that is moved stops it.`;
    if (!(await consent(text, "Arm and calibrate"))) return;
    Object.assign(body, { arm: true, set_mode: true, takeoff_m: copter ? 3 : null });
  }
  begin("/api/calibration", body);
});
$("motion").addEventListener("change", showHint);
$("method").addEventListener("change", () => {
  for (const label of document.querySelectorAll("[data-for]")) label.hidden = !label.dataset.for.split(" ").includes(method());
  showHint();
});
$("check").addEventListener("click", () => begin("/api/check", { turn: $("turn").value }));
$("stop").addEventListener("click", () => post("/api/task/stop"));
$("yes").addEventListener("click", () => post("/api/task/answer", { yes: true }));
$("no").addEventListener("click", () => post("/api/task/answer", { yes: false }));
$("more").addEventListener("click", () => loadHistory(page.oldest));

// --- the stream ---------------------------------------------------------------------------------

let socket = null, heardAt = 0, retryMs = 300;

function listen() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/stream?rate_hz=15`);
  socket.onmessage = (event) => {
    heardAt = performance.now();
    retryMs = 300;
    const message = JSON.parse(event.data);
    page.now = message.now;
    if ("findings" in message) showFindings(message.findings);
    if ("task" in message) takeTask(message.task);
    if ("trail" in message) takeTrail(message.trail);
    requestAnimationFrame(showNow);
  };
  socket.onopen = loadState;
  socket.onclose = () => {
    setTimeout(listen, retryMs);
    retryMs = Math.min(2 * retryMs, 2000);
  };
}

setInterval(() => {
  const heard = performance.now() - heardAt < 3000;
  const connected = heard && page.now?.connected;
  const kind = page.vehicle ? `${page.vehicle.autopilot} ${page.vehicle.kind}` : "vehicle";
  const words = !heard ? "the service is not reached" : connected ? `${kind}${page.vehicle?.armed ? ", armed" : ""}` : "the vehicle is not heard";
  $("status").textContent = words;
  $("status").className = `status ${connected ? "on" : "off"}`;
  $("live").style.opacity = connected ? "" : ".45";
}, 300);

async function loadState() {
  try {
    const state = await get("/api/state");
    page.world = state.world;
    page.vehicle = state.vehicle;
    $("version").textContent = `mavcompass ${state.version}`;
    showHint();
    const count = state.vehicle?.compasses.length ?? 0;
    if (count && $("compasses").options.length !== count + 1) {
      const options = state.vehicle.compasses.map((c) => new Option(`compass ${c.instance}`, c.instance));
      $("compasses").replaceChildren(new Option("all", ""), ...options);
    }
  } catch {
    // The stream tells that the service is away.
  }
}
setInterval(loadState, 2000);

const HINTS = {
  "one-point": "It is left where it stands, on the level, motors off: say where it points, by a landmark's bearing, a second antenna or the sun.",
  autopilot: "The autopilot calibrates by its own method: turn the vehicle by hand, every side down once. What it finds is judged before it is kept.",
};

function showHint() {
  $("motion-hint").textContent = !page.vehicle
    ? "Waiting for the vehicle."
    : HINTS[method()] ? HINTS[method()]
    : page.vehicle.armed
      ? `The vehicle is armed: it turns itself, ${TURNS[method()]}. Keep clear.`
      : armsFirst()
        ? `The vehicle is disarmed: you are asked whether it may be armed to turn itself, ${TURNS[method()]}.`
        : `The vehicle is disarmed: you turn it by hand, ${TURNS[method()]} (or it does, if armed: Options, Who turns).`;
}

// --- what changes quickly -----------------------------------------------------------------------

function showNow() {
  const now = page.now;
  const heading = now?.headings.find((h) => h.instance === page.compass) ?? now?.headings[0];
  showChoice(now?.headings ?? []);
  if (!heading) return;
  const degrees = heading.true_deg ?? heading.magnetic_deg;
  // A course is true: beside a magnetic heading it would say nothing.
  const course = heading.true_deg === null ? null : now.course_deg;
  const sigma = heading.true_sigma_deg ?? heading.sigma_deg;
  rose.show(degrees, sigma, course);
  $("moving").hidden = course === null;
  $("course").textContent = `${course?.toFixed(1)}°`;
  field.show(heading, page.world);
  $("heading").textContent = String(Math.round(degrees) % 360).padStart(3, "0");
  $("north").textContent = heading.true_deg === null ? "magnetic" : "true";
  $("sigma").textContent = sigma.toFixed(sigma < 10 ? 1 : 0);
  const north = page.vehicle?.compasses.find((c) => c.instance === heading.instance)?.true_north;
  $("rests-on").textContent = north?.learnt_by.length ? north.rests_on : "";
  $("magnetic").textContent = `${heading.magnetic_deg.toFixed(1)}°`;
  const [forward, right, down] = heading.level_mgauss;
  const level = Math.hypot(forward, right), total = Math.hypot(level, down);
  $("strength").textContent = `${total.toFixed(0)} mG`;
  $("dip").textContent = `${((Math.atan2(down, level) * 180) / Math.PI).toFixed(1)}°`;
  $("tilt").textContent = `${Math.round(now.roll_deg) || 0}°, ${Math.round(now.pitch_deg) || 0}°`;
  if (page.task && isRunning(page.task)) {
    const trail = page.trail?.task === page.task.id ? page.trail : null;
    $("turned").textContent = `${(now.turned_deg - (trail?.turned ?? now.turned_deg)).toFixed(0)}°`;
    $("still").classList.toggle("on", now.still);
    const planned = { "four-positions": 4, "touch-up": 2, "one-point": 1 }[page.task.method] ?? 0;
    circle.draw(trail?.compasses[heading.instance], [forward, right], page.world?.horizontal_mgauss ?? null, planned);
  }
}

function showChoice(headings) {
  const key = headings.map((h) => h.instance).sort().join();
  const box = $("compass-choice");
  if (box.dataset.key !== `${key}/${page.compass}`) {
    box.dataset.key = `${key}/${page.compass}`;
    box.hidden = headings.length < 2;
    const instances = headings.map((h) => h.instance).sort();
    box.replaceChildren(...instances.map((i) => show.node("button", {
      text: `Compass ${i}`, "aria-pressed": String(i === page.compass), onclick: () => { page.compass = i; },
    })));
  }
}

const CURES = { running: "Write what was learnt", "touch-up": "Put it right by a quarter turn" };

function showFindings(findings) {
  $("findings").hidden = !findings.length;
  // One remedy often cures several findings: it is said once, below them.
  const groups = new Map();
  for (const finding of findings) groups.set(finding.remedy, [...(groups.get(finding.remedy) ?? []), finding]);
  $("findings").replaceChildren(...[...groups].map(([remedy, group]) => {
    const css = group.some((f) => f.severity === "bad") ? "finding worst" : "finding";
    const [{ method }] = group, compasses = group.map((f) => f.compass);
    const take = () => begin("/api/calibration", { method, writing: "ask", compasses });
    const button = method ? [show.node("button", { text: CURES[method], onclick: take })] : [];
    return show.node("div", { class: css }, ...group.map((f) => show.node("b", { text: f.text })), show.node("span", { text: remedy }), ...button);
  }));
}

// --- the task -----------------------------------------------------------------------------------

const isRunning = (task) => !["done", "failed"].includes(task.state);

function takeTask(task) {
  const before = page.task;
  page.task = task;
  if (!task) return;
  const running = isRunning(task);
  $("idle").hidden = running;
  $("running").hidden = !running;
  document.body.classList.toggle("busy", running);
  if (running && before?.id !== task.id) {
    $("work").scrollIntoView({ block: "start" });
    $("stop").focus({ preventScroll: true }); // what had the focus is gone, and this is what one may want next
  }
  if (running) showRunning(task);
  else if (page.drawn !== task.id) {
    page.drawn = task.id;
    showEnd(task);
    loadHistory();
  }
}

function showRunning(task) {
  const titles = { calibration: "Calibrating", check: "Checking", undo: "Putting back" };
  $("running-title").textContent = titles[task.kind] ?? task.kind;
  $("result").hidden = true;
  const last = task.lines[task.lines.length - 1];
  $("prompt").textContent = task.question ?? last?.text ?? "Waiting for the vehicle.";
  $("bar").style.width = `${Math.round(100 * task.fraction)}%`;
  const told = task.lines.slice(0, -1).filter((line, k, all) => line.step !== all[k + 1]?.step);
  $("steps").replaceChildren(...told.reverse().map((line) => show.node("li", { text: line.text })));
  showQuestion(task);
}

function showQuestion(task) {
  const writes = task.proposals.length > 0, was = !$("question").hidden;
  $("question").hidden = !task.question;
  $("running").classList.toggle("writes", writes);
  if (!task.question || (was && $("question").dataset.of === `${task.id} ${task.question}`)) return;
  $("question").dataset.of = `${task.id} ${task.question}`;
  $("proposals").replaceChildren(...task.proposals.map(show.proposal));
  $("about").replaceChildren(...(writes ? [] : task.about.map((text) => show.node("p", { text }))));
  $("details").hidden = !task.details.length;
  $("details").open = false;
  $("details").firstChild.textContent = `${task.details.length} parameters`;
  $("details").lastChild.textContent = task.details.join("\n");
  $("yes").textContent = writes ? "Write" : "Yes";
  $("no").textContent = writes ? "Do not write" : "No";
  $("work").scrollIntoView({ block: "start" });
  $("question").focus({ preventScroll: true });
}

// What a run has drawn comes from the service, so that who joins late sees the same as all others.
function takeTrail(told) {
  if (page.trail?.task !== told.task) page.trail = { task: told.task, compasses: {} };
  page.trail.turned = told.turned_at_start_deg;
  for (const [instance, more] of Object.entries(told.compasses)) {
    const points = page.trail.compasses[instance]?.points.slice(0, more.first) ?? [];
    page.trail.compasses[instance] = { ...more, points: points.concat(more.points) };
  }
}

function showEnd(task) {
  const box = $("result");
  box.hidden = false;
  if (task.state === "failed") {
    box.replaceChildren(show.node("p", { class: "verdict bad", text: `The ${task.kind} came to nothing` }),
      show.node("p", { text: task.error }), show.node("p", { class: "soft", text: task.remedy }));
  } else {
    showDocument(task.kind, task.document, task.history_entry);
  }
}

function showDocument(kind, document, entry) {
  const box = $("result");
  const pieces = document.error
    ? [show.node("p", { class: "verdict bad", text: document.error }), show.node("p", { class: "soft", text: document.remedy ?? "" })]
    : kind === "undo"
      ? [show.node("p", { class: "verdict good", text: `The old calibration is back: ${Object.keys(document.values).length} parameters put back and read back` })]
      : show[kind](document);
  if (kind === "calibration" && !document.error && entry) {
    pieces.push(show.node("p", {}, show.node("a", { href: `/api/history/${entry}/report`, target: "_blank", rel: "noopener", text: "Full report" })));
  }
  box.hidden = false;
  box.replaceChildren(...pieces);
}

// --- the history --------------------------------------------------------------------------------

const acts = {
  async show(id) {
    const entry = await get(`/api/history/${id}`);
    showDocument(entry.kind, entry.document, entry.has_report ? entry.id : null);
    $("result").scrollIntoView({ behavior: "smooth", block: "start" });
  },
  async undo(id) {
    if (await consent("Put back the parameters that this calibration replaced?", "Put back")) begin("/api/undo", { entry: id });
  },
  async gap(id) {
    if (!(await post("/api/gap", { entry: id }))) return;
    refuse("Explaining the gap; this takes a while and does not touch the vehicle.");
    const timer = setInterval(async () => {
      const task = await get("/api/gap");
      if (isRunning(task)) return;
      clearInterval(timer);
      refuse(task.state === "failed" ? `${task.error} ${task.remedy}` : "");
      if (task.state === "done") showDocument("gap", task.document, task.history_entry);
      loadHistory();
    }, 1000);
  },
};

async function loadHistory(before = null) {
  const answer = await get(`/api/history?limit=8${before ? `&before=${before}` : ""}`).catch(() => ({ entries: [] }));
  const lines = answer.entries.map((entry) => show.historyLine(entry, acts));
  if (before) $("history").append(...lines);
  else $("history").replaceChildren(...(lines.length ? lines : [show.node("li", { class: "soft", text: "Nothing was done yet." })]));
  page.oldest = answer.entries.at(-1)?.id ?? null;
  $("more").hidden = answer.entries.length < 8;
}

showTokenBox();
loadHistory();
listen();
