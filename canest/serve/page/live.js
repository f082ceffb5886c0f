// Connects to the server, keeps the rows, and draws; whatever is lost shows within two seconds.
import { Charts, road } from "./charts.js";
import { RECENT_S, Store } from "./store.js";
import { showChanges, showGates, showKnown, showNumbers, showProblem, showSnapshot, showStatus } from "./view.js";
import { age, clock, sentence } from "./words.js";

const DRAW_MS = 200, CHECK_MS = 250, DESCRIBE_MS = 10000, DAY_MS = 60000;
const MOST_CHANGES = 100;
const LOST_S = 1.8; // without a word from the server
const QUIET_S = 1.0; // without a frame on the bus
const STALE_S = 1.0; // without a new estimate

const id = (name) => document.getElementById(name);
const seconds = () => performance.now() / 1000;
const store = new Store();
const charts = new Charts(id("charts"), store, (time) => readAt(time));
const state = {
  names: { gates: {}, statuses: [] }, newest: null, newestAt: -Infinity, quiet: null, quietAt: 0, status: null,
  statusAt: 0, problem: "connecting", eventAt: seconds(), source: "the daemon", dirty: false, paused: false,
  roadPlot: null, announced: "", connected: false, changes: [],
};

/** A row's values by name, of an array as it is sent. */
const named = (row) => Object.fromEntries(store.names.map((name, at) => [name, row[at]]));

/** The time at the right edge: that of the newest row, and what has passed since. */
const now = () => (state.newest ? state.newest.t_s + Math.min(seconds() - state.newestAt, 1e6) : Date.now() / 1000);

/** Take one event of the server. Tests call it, too. */
export function take(kind, content) {
  state.eventAt = seconds();
  if (kind === "rows") {
    store.add(content.rows);
    if (content.newest && (!state.newest || content.newest[0] !== state.newest.t_s)) {
      state.newest = named(content.newest);
      state.newestAt = seconds();
    }
    state.quiet = content.quiet_s;
    state.quietAt = seconds();
    state.dirty = true;
  } else if (kind === "status") {
    state.status = content;
    state.statusAt = seconds();
    showSnapshot(content);
    showRoad(content.road_ahead);
  } else if (kind === "change") {
    const known = state.changes.some(([time, text]) => time === content[0] && text === content[1]);
    if (!known) state.changes = [...state.changes, content].slice(-MOST_CHANGES);
    showChanges(state.changes);
  } else if (kind === "source") {
    state.problem = content.problem;
    state.source = content.source;
  }
  check();
}

/** How many rows the page has now. */
export const points = () => store.length;

/** Take what `/history` gave: at the start, and after every gap. */
export function open(history) {
  state.names = { gates: history.gates || {}, statuses: history.statuses || [] };
  charts.gates = state.names.gates;
  store.load(history);
  state.newest = history.newest ? named(history.newest) : null;
  state.newestAt = history.newest ? seconds() - Math.max(0, history.now_s - history.newest[0]) : -Infinity;
  state.problem = history.problem;
  state.source = history.source;
  state.changes = history.changes || [];
  showChanges(state.changes);
  if (history.status) take("status", history.status);
  take("rows", { rows: [], newest: null, quiet_s: history.quiet_s });
  draw();
  describe();
}

function connect() {
  const events = new EventSource("events");
  let waiting = [];
  events.onopen = async () => {
    waiting = [];
    state.eventAt = seconds();
    try {
      const answer = await fetch("history");
      if (!answer.ok) throw new Error(await answer.text());
      const history = await answer.json();
      open(history);
      const last = store.lastTime || 0;
      for (const [kind, content] of waiting || []) {
        take(kind, kind === "rows" ? { ...content, rows: content.rows.filter((row) => row[0] > last) } : content);
      }
      waiting = null;
      state.connected = true;
    } catch (error) {
      state.problem = `The history cannot be read: ${error.message}`;
    }
  };
  for (const kind of ["rows", "status", "source", "change"]) {
    events.addEventListener(kind, (event) => {
      const content = JSON.parse(event.data);
      if (kind === "rows" && !store.names.length && waiting === null) return events.onopen(); // the first daemon
      if (waiting) { waiting.push([kind, content]); if (waiting.length > 200) waiting.shift(); } else take(kind, content);
    });
  }
  events.onerror = () => {
    state.connected = false;
    waiting = [];
    check();
    if (events.readyState === EventSource.CLOSED) setTimeout(connect, 2000); // refused: too many pages, or no token
  };
}

/** Show what is wrong, and mark numbers that are not of now. */
function check() {
  const { bus = {}, estimate } = state.status || {};
  const quiet = state.quiet === null ? null : state.quiet + seconds() - state.quietAt;
  const silent = seconds() - state.eventAt;
  let problem = "", counting = "";
  if (!state.connected && silent > LOST_S) problem = "No connection to canest serve: is it running? Trying again.";
  else if (silent > LOST_S) [problem, counting] = ["canest serve does not answer.", `Silent for ${age(silent)}.`];
  else if (state.problem) problem = `No data: ${state.problem}.`;
  else if (bus.state && !["up", "error-passive"].includes(bus.state)) {
    problem = `The bus ${bus.channel} is ${bus.state}${bus.reason ? `: ${bus.reason}` : ""}.`;
  } else if (quiet !== null && quiet > QUIET_S) [problem, counting] = ["No frame on the bus.", `Quiet for ${age(quiet)}.`];
  showProblem(problem, counting);
  const fresh = !problem && state.newest !== null && seconds() - state.newestAt < STALE_S;
  showNumbers(state.newest, state.names.gates, fresh);
  showKnown(fresh ? null : lastKnown());
  const name = fresh ? state.names.statuses[state.newest.status] : problem ? "no estimate of now" : estimate?.status || "waiting";
  showStatus(name);
  announce(problem || `Status: ${name}`);
}

/** The newest mass there was, and its age: what the page has seen itself, else what the daemon knows. */
function lastKnown() {
  if (state.newest && state.newest.mass_kg !== null) return { ...state.newest, age_s: seconds() - state.newestAt };
  const { last_known: known, learned } = state.status || {};
  if (known) return { ...known, age_s: known.age_s + seconds() - state.statusAt };
  return learned ? { ...learned, age_s: Math.max(0, Date.now() / 1000 - learned.saved_s) } : null;
}

/** For screen readers: changes only. */
function announce(text) {
  if (text !== state.announced) id("announce").textContent = state.announced = text;
}

function draw() {
  state.dirty = false;
  charts.draw(now());
  showGates(charts.day ? null : store.spans, state.names.gates);
}

function describe() {
  if (!document.hidden && store.length) charts.describe();
}

function showRoad(ahead) {
  const shown = Boolean(ahead && ahead.distance_m && ahead.distance_m.length);
  id("road").hidden = !shown;
  if (!shown) return;
  state.roadPlot = road(id("road-chart"), ahead, state.roadPlot);
  const grades = ahead.grade.filter((grade) => grade !== null).map((grade) => 100 * grade);
  const far = Math.round(ahead.distance_m.at(-1));
  id("road-chart").setAttribute("aria-label",
    `Grade of the next ${far} m: ${Math.min(...grades).toFixed(1)} to ${Math.max(...grades).toFixed(1)} %`);
}

/** Read the values at a time (null: none) into the readout; `from` the slider, which moves the cursors itself. */
function readAt(time) {
  const row = time === null || charts.day ? null : store.row(store.at(time));
  const text = row ? sentence(row, state.names.gates) : time === null ? "move the cursor to read values" : clock(time);
  id("readout").textContent = text;
  return text;
}

function slide() {
  const slider = id("cursor"), time = now() - (Number(slider.max) - Number(slider.value));
  charts.point(time);
  slider.setAttribute("aria-valuetext", readAt(time));
}

async function show(day) {
  charts.day = day;
  id("show-day").setAttribute("aria-pressed", String(day));
  id("show-recent").setAttribute("aria-pressed", String(!day));
  Object.assign(id("cursor"), { max: day ? 86400 : RECENT_S, step: day ? 60 : 1, value: day ? 86400 : RECENT_S });
  if (day) await refreshDay();
  charts.now = now();
  charts.rebuild();
  charts.describe();
  showGates(day ? null : store.spans, state.names.gates);
}

async function refreshDay() {
  try {
    const history = await (await fetch("history")).json();
    store.day = { names: history.day_columns, columns: history.day_columns.map((_, at) => history.day.map((row) => row[at])) };
  } catch {
    return; // `check` shows that the server is gone
  }
}

function changeTheme(next) {
  document.documentElement.dataset.theme = next;
  try { localStorage.setItem("canest-theme", next); } catch { /* storage may be forbidden */ }
  id("theme").textContent = `Theme: ${next}`;
  state.roadPlot?.destroy();
  state.roadPlot = null;
  charts.rebuild();
}

function start() {
  const themes = ["automatic", "dark", "light"];
  id("theme").textContent = `Theme: ${document.documentElement.dataset.theme}`;
  id("theme").onclick = () => changeTheme(themes[(themes.indexOf(document.documentElement.dataset.theme) + 1) % 3]);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.rebuild());
  id("show-recent").onclick = () => show(false);
  id("show-day").onclick = () => show(true);
  id("pause").onclick = () => {
    state.paused = !state.paused;
    id("pause").setAttribute("aria-pressed", String(state.paused));
  };
  id("cursor").oninput = slide;
  setInterval(() => { if (state.dirty && !state.paused && !document.hidden && !charts.day) draw(); }, DRAW_MS);
  setInterval(check, CHECK_MS);
  setInterval(describe, DESCRIBE_MS);
  setInterval(async () => { if (charts.day && !document.hidden) { await refreshDay(); draw(); } }, DAY_MS);
  connect();
}

start();
