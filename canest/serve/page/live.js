// Keeps the rows that the server sends, and draws; whatever is lost shows within two seconds.
import { Charts, road } from "./charts.js";
import { Connection } from "./connection.js";
import { RECENT_S, Store } from "./store.js";
import { showAge, showChanges, showGates, showKnown, showNumbers, showProblem, showSnapshot, showStatus } from "./view.js";
import { age, clock, minuteSentence, moment, sentence } from "./words.js";

const DRAW_MS = 200, CHECK_MS = 250, DESCRIBE_MS = 10000, DAY_MS = 60000;
const MOST_CHANGES = 100;
const LOST_S = 1.8; // without a word from the server
const FIRST_S = 10; // without one at the start, when a slow connection has the page itself to bring
const QUIET_S = 1.0; // without a frame on the bus
const STALE_S = 1.0; // without a new estimate

const STATUS_S = 3; // without a status, which comes once a second

const id = (name) => document.getElementById(name);
const store = new Store();
const charts = new Charts(id("charts"), store, (time) => readAt(time));
// newestAt, quietAt, statusAt: when the server sent it, by its own clock; utc: what that clock lacks
const state = {
  names: { gates: {}, statuses: [] }, newest: null, newestAt: 0, quiet: null, quietAt: 0, status: null, statusAt: 0,
  utc: 0, problem: "", source: "the daemon", dirty: false, paused: false, roadPlot: null, announced: "", changes: [],
};
const connection = new Connection({ take, open }), { clock: server } = connection;

/** A row's values by name, of an array as it is sent. */
const named = (row) => Object.fromEntries(store.names.map((name, at) => [name, row[at]]));

/** Seconds since the newest row, which may have been long on its way. */
const newestAge = () => Math.max(0, server.now() - state.newestAt);

/** The time at the right edge: that of the newest row, and what has passed since. */
const now = () => (state.newest ? state.newest.t_s + newestAge() : server.now() + state.utc);

/** Take one event, which the server sent at a time of its clock. Tests call it, too. */
export function take(kind, content, sent = server.now()) {
  if (kind === "rows") {
    store.add(content.rows);
    if (content.newest && (!state.newest || content.newest[0] !== state.newest.t_s)) {
      state.newest = named(content.newest);
      state.newestAt = sent;
    }
    state.quiet = content.quiet_s;
    state.quietAt = sent;
    state.dirty = true;
  } else if (kind === "status") {
    state.status = content;
    state.statusAt = sent;
    showSnapshot(content);
    showRoad(content.road_ahead);
  } else if (kind === "change") {
    const known = state.changes.some(([time, text]) => time === content[0] && text === content[1]);
    if (!known) state.changes = [...state.changes, content].slice(-MOST_CHANGES);
    showChanges(state.changes);
  } else if (kind === "source") takeSource(content, sent);
  check();
}

function takeSource(content, sent) {
  state.problem = content.problem;
  state.source = content.source;
  state.utc = content.now_s - sent;
}

/** How many rows the page has now. */
export const points = () => store.length;

/** Take what `/history` gave: at the start, and after every gap. */
export function open(history) {
  state.names = { gates: history.gates || {}, statuses: history.statuses || [] };
  charts.gates = state.names.gates;
  store.load(history);
  state.newest = history.newest ? named(history.newest) : null;
  state.newestAt = history.newest_at_s;
  takeSource(history, history.sent_s);
  state.changes = history.changes || [];
  showChanges(state.changes);
  if (history.status) take("status", history.status, history.status_at_s);
  take("rows", { rows: [], newest: null, quiet_s: history.quiet_s }, history.sent_s);
  if (!state.paused) draw();
  describe();
}

/** What is wrong in words ('' for nothing), and what of it changes every second. */
function trouble() {
  const { lost, loaded, refusal, failure, silent } = connection, { bus = {} } = state.status || {};
  if (refusal) return [`canest serve says: ${refusal}`, ""];
  if (lost && silent > LOST_S) return ["No connection to canest serve: is it running? Trying again.", ""];
  if (silent > (loaded ? LOST_S : FIRST_S)) return ["canest serve does not answer.", `Silent for ${age(silent)}.`];
  if (failure) return [`The history cannot be read: ${failure}. Trying again.`, ""];
  if (!loaded) return ["", ""];
  if (server.late > STALE_S) return ["The connection is slow.", `What arrives is ${age(server.late)} behind.`];
  if (state.problem) return [`No data: ${state.problem}.`, ""];
  if (bus.state && !["up", "error-passive"].includes(bus.state)) {
    return [`The bus ${bus.channel} is ${bus.state}${bus.reason ? `: ${bus.reason}` : ""}.`, ""];
  }
  const quiet = state.quiet === null ? 0 : state.quiet + server.now() - state.quietAt;
  return quiet > QUIET_S ? ["No frame on the bus.", `Quiet for ${age(quiet)}.`] : ["", ""];
}

/** Show what is wrong, and mark numbers that are not of now. */
function check() {
  const [problem, counting] = trouble();
  const fresh = connection.loaded && !problem && state.newest !== null && newestAge() < STALE_S;
  const old = state.status !== null && (state.problem !== "" || server.now() - state.statusAt > STATUS_S);
  const known = (!old && state.status?.estimate?.status) || "waiting";
  let name = fresh ? state.names.statuses[state.newest.status] : problem ? "no estimate of now" : known;
  if (!connection.loaded && !problem) name = "connecting";
  showProblem(problem, counting);
  showNumbers(state.newest, state.names.gates, fresh);
  showKnown(fresh ? null : lastKnown());
  showStatus(name);
  showAge(old ? state.statusAt + state.utc : null);
  announce(problem || `Status: ${name}`);
}

/** The newest mass there was, and its age: what the page has seen itself, else what the daemon knows. */
function lastKnown() {
  if (state.newest && state.newest.mass_kg !== null) return { ...state.newest, age_s: newestAge() };
  const { last_known: known, learned } = state.status || {};
  if (known) return { ...known, age_s: known.age_s + server.now() - state.statusAt };
  return learned ? { ...learned, age_s: Math.max(0, server.now() + state.utc - learned.saved_s) } : null;
}

/** For screen readers: changes only. */
function announce(text) {
  if (text !== state.announced) id("announce").textContent = state.announced = text;
}

function draw() {
  state.dirty = false;
  charts.draw(now());
  showGates(charts.day ? null : charts.store.spans, state.names.gates);
}

function describe() {
  if (!document.hidden && charts.store.length) charts.describe();
}

function showRoad(ahead) {
  const shown = Boolean(ahead && ahead.distance_m && ahead.distance_m.length);
  id("road").hidden = !shown;
  if (!shown) return;
  state.roadPlot = road(id("road-chart"), ahead, state.roadPlot);
  const grades = ahead.grade.filter((grade) => grade !== null).map((grade) => 100 * grade);
  const far = Math.round(ahead.distance_m.at(-1));
  const [least, most] = [Math.min(...grades).toFixed(1), Math.max(...grades).toFixed(1)];
  id("road-chart").setAttribute("aria-label",
    `Grade of the next ${far} m: ${grades.length ? `${least} to ${most} %` : "not known"}`);
}

/** What is known at a time (null: none), in words. */
function wordsAt(time) {
  if (time === null) return "move the cursor to read values";
  const found = charts.day ? charts.store.minuteAt(time) : charts.store.rowAt(time);
  if (!found) return `${charts.day ? moment(time) : clock(time)}, nothing is known of this time`;
  return charts.day ? minuteSentence(found) : sentence(found, state.names.gates);
}

/** Follow the cursor of the curves with the readout and the slider. */
function readAt(time) {
  const slider = id("cursor"), text = wordsAt(time);
  if (time !== null) slider.value = slider.max - (charts.now - time);
  if (id("readout").textContent === text) return;
  id("readout").textContent = text;
  slider.setAttribute("aria-valuetext", text);
}

async function show(day) {
  charts.day = day;
  id("show-day").setAttribute("aria-pressed", String(day));
  id("show-recent").setAttribute("aria-pressed", String(!day));
  Object.assign(id("cursor"), { max: day ? 86400 : RECENT_S, step: day ? 60 : 1, value: day ? 86400 : RECENT_S });
  charts.cursor = null;
  if (day) await refreshDay();
  if (!state.paused) charts.now = now();
  charts.rebuild();
  charts.describe();
  showGates(day ? null : charts.store.spans, state.names.gates);
}

async function refreshDay() {
  try {
    store.loadDay(await (await fetch("history")).json());
    charts.store.day = store.day;
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
    charts.store = state.paused ? store.copy() : store;
    id("pause").setAttribute("aria-pressed", String(state.paused));
    if (!state.paused) draw();
  };
  id("cursor").oninput = ({ target }) => charts.point(charts.now - (target.max - target.value));
  setInterval(() => { if (state.dirty && !state.paused && !document.hidden && !charts.day) draw(); }, DRAW_MS);
  setInterval(check, CHECK_MS);
  setInterval(describe, DESCRIBE_MS);
  setInterval(async () => {
    if (!charts.day || state.paused || document.hidden) return;
    await refreshDay();
    draw();
  }, DAY_MS);
  connection.connect();
}

start();
