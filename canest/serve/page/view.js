// The words and tables of the page. Elements are made once and change their text: nothing grows.
import { kindOf } from "./charts.js";
import { age, fixed, gateName, kmh, missing as unknown, moment, number, percent, readable, unit } from "./words.js";

const CHANGES_SHOWN = 15;
const id = (name) => document.getElementById(name);
const put = (name, text) => {
  const element = typeof name === "string" ? id(name) : name;
  if (element.textContent !== text) element.textContent = text;
};

/** The numbers of the newest row; status: names of the codes. fresh: whether the row is of now. */
export function showNumbers(row, gates, fresh) {
  const of = (name) => (fresh && row ? row[name] : null);
  put("mass", unit(of("mass_kg"), "kg"));
  put("mass-std", unknown(of("mass_std_kg")) ? "" : `± ${number(row.mass_std_kg)} kg`);
  put("grade", percent(of("grade")));
  put("grade-std", unknown(of("grade_std")) ? "" : `± ${(100 * row.grade_std).toFixed(2)} %`);
  put("speed", kmh(of("speed_mps")));
  put("torque", unit(of("torque_Nm"), "N m"));
  put("gear", of("gear") ? String(row.gear) : "–");
  put("residual", unit(of("residual_N"), "N"));
  put("gate", gateName(gates, of("gate")));
  id("numbers").classList.toggle("stale", !fresh);
}

/** The last known mass while there is none of now. known: {mass_kg, mass_std_kg, age_s}, or null. */
export function showKnown(known) {
  id("known").hidden = !known;
  if (!known) return;
  const spread = unknown(known.mass_std_kg) ? "" : ` ± ${number(known.mass_std_kg)}`;
  put("known", `Last known mass: ${number(known.mass_kg)}${spread} kg, ${age(known.age_s)} ago`);
}

export function showStatus(name) {
  put("status", name);
  id("status").dataset.status = name;
}

/** A problem in words ('' for none). counting: what changes every second, and is not read out. */
export function showProblem(text, counting = "") {
  const box = id("problem");
  box.hidden = !text;
  if (!text) return box.replaceChildren();
  if (!box.firstChild) {
    box.append(document.createElement("span"), document.createElement("span"));
    box.lastChild.setAttribute("aria-hidden", "true");
  }
  put(box.firstChild, text);
  put(box.lastChild, counting && ` ${counting}`);
}

/** Everything that comes once a second. */
export function showSnapshot(status) {
  const bus = status.bus || {};
  put("vehicle", status.vehicle || "canest");
  document.title = `${status.vehicle || "canest"} – canest live`;
  const rate = unknown(bus.frames_per_s) ? "" : `, ${number(bus.frames_per_s)} frames/s`;
  put("bus", `${bus.interface}:${bus.channel} ${bus.state}${rate}`);
  const lacking = [status.why_not_valid, ...(status.missing_signals || []), ...(status.notes || [])].filter(Boolean);
  id("missing").hidden = !lacking.length;
  list("missing-list", lacking);
  showSenders(status);
  const masses = Object.entries(status.masses_of_others_kg || {});
  id("others").hidden = !masses.length;
  table("others-table", ["Address", "Mass, kg"], masses.map(([from, kg]) => [from, number(kg)]));
  facts("daemon", daemonFacts(status));
}

/** The time that everything of `showSnapshot` is of, where that is not now; null where it is. */
export function showAge(time) {
  document.body.classList.toggle("old", time !== null);
  for (const place of document.querySelectorAll(".as-of")) put(place, time === null ? "" : `as of ${moment(time)}`);
}

/** What has changed, the newest first: [[time, text], ...] in the order of time. */
export function showChanges(changes) {
  const place = id("changes"), shown = changes.slice(-CHANGES_SHOWN).reverse();
  while (place.children.length > shown.length) place.lastChild.remove();
  while (place.children.length < shown.length) {
    const item = document.createElement("li");
    item.append(document.createElement("time"), " ", document.createElement("span"));
    place.append(item);
  }
  shown.forEach(([time, text], at) => {
    const [when, what] = place.children[at].children;
    put(when, moment(time));
    when.dateTime = new Date(1000 * time).toISOString();
    put(what, text);
  });
}

function showSenders(status) {
  const rows = Object.entries(status.senders || {}).map(([key, s]) => [
    readable(key), fixed(s.rate_hz, 1, "Hz"), number(s.frames), number(s.not_available),
    number((s.error_values || 0) + (s.wrong_length || 0) + (s.transport_errors || 0)),
  ]);
  table("senders-table", ["Sender", "Rate", "Frames", "Not available", "Errors"], rows);
  const warnings = Object.entries(status.sends_faster || {}).map(
    ([key, [usual, now]]) => `${readable(key)}: ${now} Hz, usually ${usual}. Does somebody else send under this address?`);
  for (const [role, refused] of Object.entries(status.contested_signals || {})) {
    warnings.push(`${readable(role)} comes from several addresses; refused: ${Object.keys(refused).join(", ")}`);
  }
  for (const [role, s] of Object.entries(status.stuck_signals || {})) warnings.push(`${readable(role)} was stuck for ${s} s`);
  const others = Object.keys(status.other_senders || {}).map(readable);
  if (others.length) warnings.push(`Unexpected senders: ${others.join(", ")}`);
  list("warnings", warnings);
}

function daemonFacts(status) {
  const lines = [], { broadcast = {}, ticks, samples } = status;
  if (samples) {
    const closed = Object.entries(status.gates || {}).map(([name, n]) => `${readable(name)} ${Math.round((100 * n) / samples)} %`);
    lines.push(["Learned from", `${Math.round((100 * status.updated) / samples)} % of ${number(samples)} samples`]);
    if (closed.length) lines.push(["Gates", closed.join(", ")]);
  }
  if ("silent_because" in broadcast) lines.push(["Broadcast", broadcast.silent_because ? `silent: ${broadcast.silent_because}` : "on"]);
  if (ticks) lines.push(["Ticks", `${number(ticks.count)}, ${number(ticks.missed)} missed, ${ticks.cpu_us_mean} µs each`]);
  if (status.reload_refused_because) lines.push(["New config", `refused, the one before is in force: ${status.reload_refused_because}`]);
  if (status.failures) lines.push(["Failures", `${status.failures} errors inside the estimation were survived: see the log`]);
  for (const [name, text] of Object.entries(status.files || {})) if (typeof text === "string") lines.push([readable(name), text]);
  if (status.uptime_s) lines.push(["Running", `${age(status.uptime_s)}, pid ${status.pid}, ${status.config}`]);
  return lines;
}

/** The gates among the spans that are shown, with what they look like; null for the day, which has shares. */
export function showGates(spans, gates) {
  const codes = spans ? [...new Set(spans.map((span) => span.code))].sort((a, b) => a - b) : ["day"];
  const place = id("gates");
  if (place.dataset.codes === codes.join()) return;
  place.dataset.codes = codes.join();
  if (!spans) {
    const item = document.createElement("li");
    item.append(swatch(kindOf("recovery")), "a gate was closed: the darker, the more of the minute");
    place.replaceChildren(item);
    return;
  }
  place.replaceChildren(...codes.map((code) => {
    const item = document.createElement("li"), name = gateName(gates, code);
    item.append(swatch(kindOf(name.replaceAll(" ", "_"))), name);
    return item;
  }));
}

function swatch({ rgb, slope }) {
  const make = (name, attributes) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    return element;
  };
  const picture = make("svg", { viewBox: "0 0 24 14", "aria-hidden": "true" });
  picture.append(make("rect", { width: 24, height: 14, fill: `rgba(${rgb},.3)` }));
  const lines = { null: "", 0: "M0 4H24M0 10H24", 1: "M0 0L14 14M10 0L24 14", "-1": "M14 0L0 14M24 0L10 14", 2: "M2 0L9 14M10 0L17 14M17 0L24 14" };
  if (lines[slope]) picture.append(make("path", { d: lines[slope], stroke: `rgb(${rgb})`, fill: "none" }));
  return picture;
}

function list(name, texts) {
  const place = id(name);
  while (place.children.length > texts.length) place.lastChild.remove();
  while (place.children.length < texts.length) place.append(document.createElement("li"));
  texts.forEach((text, at) => put(place.children[at], text));
}

function facts(name, pairs) {
  const place = id(name);
  while (place.children.length > 2 * pairs.length) place.lastChild.remove();
  while (place.children.length < 2 * pairs.length) {
    place.append(document.createElement("dt"), document.createElement("dd"));
  }
  pairs.flat().forEach((text, at) => put(place.children[at], text));
}

function table(name, head, rows) {
  const place = id(name);
  if (!place.tHead) {
    const line = place.createTHead().insertRow();
    for (const text of head) {
      const cell = document.createElement("th");
      cell.scope = "col";
      cell.textContent = text;
      line.append(cell);
    }
    place.createTBody();
  }
  const body = place.tBodies[0];
  while (body.rows.length > rows.length) body.deleteRow(-1);
  while (body.rows.length < rows.length) {
    const line = body.insertRow();
    head.forEach(() => line.insertCell());
  }
  rows.forEach((cells, at) => cells.forEach((text, column) => put(body.rows[at].cells[column], text)));
}
