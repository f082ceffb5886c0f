// The curves: one uPlot per signal over a common time, gates as shaded spans, one cursor for all.
/* global uPlot */
import { MINUTE_S, RECENT_S } from "./store.js";
import { clock, gateName, number } from "./words.js";

const DAY_S = 86400;
const DAY_GAP_S = 2.5 * MINUTE_S; // between minutes that no curve joins
const same = (value) => value;
// least: what the axis spans at least, so that noise does not fill it
const PANELS = [
  { name: "mass_kg", std: "mass_std_kg", title: "Mass, kg", colour: "--mass", least: 400, show: same },
  { name: "grade", std: "grade_std", title: "Grade, %", colour: "--grade", least: 2, show: (v) => 100 * v },
  { name: "speed_mps", title: "Speed, km/h", colour: "--speed", least: 10, show: (v) => 3.6 * v },
  { name: "torque_Nm", title: "Torque, N m", colour: "--torque", least: 100, show: same },
  { name: "gear", title: "Gear", colour: "--gear", least: 2, show: same, stepped: true },
  { name: "residual_N", title: "Residual, N (0: the model explains all)", colour: "--residual", least: 500, show: same, trimmed: true },
];
// kinds of gates: a colour and a direction of hatching each, so that they differ by more than colour
const KINDS = [
  { gates: ["stale", "invalid", "implausible"], rgb: "213,94,0", slope: 1 },
  { gates: ["brake", "retarder"], rgb: "204,121,167", slope: -1 },
  { gates: ["shift", "driveline"], rgb: "0,114,178", slope: 0 },
  { gates: ["recovery"], rgb: "128,128,128", slope: null },
];
const OTHER = { rgb: "0,158,115", slope: 2 };
export const kindOf = (name) => KINDS.find((kind) => kind.gates.includes(name)) || OTHER;

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const rgba = (colour, alpha) => {
  const n = parseInt(colour.length === 4 ? colour.replace(/[^#]/g, "$&$&").slice(1) : colour.slice(1), 16);
  return `rgba(${n >> 16},${(n >> 8) & 255},${n & 255},${alpha})`;
};

export class Charts {
  /** place: element for the figures; onCursor: called with the cursor's time, or null, when one of both moves. */
  constructor(place, store, onCursor) {
    this.store = store;
    this.onCursor = onCursor;
    this.gates = {};
    this.day = false;
    this.now = 0;
    this.cursor = null; // the time that it stays at while the curves move on
    this.panels = PANELS.map((panel) => ({ ...panel, ...figure(place, panel), plot: null, range: [0, 1] }));
    new ResizeObserver(() => this.resize()).observe(place);
  }

  /** Draw everything anew: another theme, another span of time. */
  rebuild() {
    for (const panel of this.panels) {
      panel.plot?.destroy();
      const plot = panel.plot = new uPlot(this.options(panel), this.data(panel), panel.place);
      plot.over.addEventListener("mousemove", (event) => this.point(plot.posToVal(event.offsetX, "x")));
      plot.over.addEventListener("mouseleave", () => this.point(null));
    }
    this.point(this.cursor);
  }

  /** Draw what is new. now: the time at the right edge, seconds. */
  draw(now) {
    this.now = now;
    if (!this.panels[0].plot) return this.rebuild();
    for (const panel of this.panels) panel.plot.setData(this.data(panel));
    this.point(this.cursor);
  }

  /** Put the cursor of every panel at a time, null for none. */
  point(time) {
    const past = time === null || time < this.now - (this.day ? DAY_S : RECENT_S);
    this.cursor = past || time > this.now + 1 ? null : time; // the clock of the rows may have been set back
    queueMicrotask(() => this.placeCursor()); // what is new is drawn in a microtask, too
    this.onCursor(this.cursor);
  }

  placeCursor() {
    for (const { plot } of this.panels) {
      const left = this.cursor === null || !plot ? -10 : plot.valToPos(this.cursor, "x");
      plot?.setCursor({ left, top: left < 0 ? -10 : 1 }, false);
    }
  }

  /** What the panels show, in words, under each of them. */
  describe() {
    for (const panel of this.panels) {
      const [, values, low, high] = this.data(panel);
      const known = (this.day ? [...low, ...high] : values).filter((value) => value !== null);
      const span = this.day ? "the last day" : "the last ten minutes";
      let text = `${panel.title}: nothing known of ${span}.`;
      if (known.length) {
        const least = known.reduce((a, b) => Math.min(a, b)), most = known.reduce((a, b) => Math.max(a, b));
        const digits = most - least < 20 ? 1 : 0;
        text = `${panel.title}: ${least.toFixed(digits)} to ${most.toFixed(digits)} in ${span}`;
        text += this.day ? "." : `, last ${known.at(-1).toFixed(digits)}.`;
      }
      panel.place.setAttribute("aria-label", text);
    }
  }

  options(panel) {
    const colour = css(panel.colour), soft = css("--soft"), grid = css("--grid");
    const axis = { stroke: soft, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid }, font: "12px system-ui" };
    const edge = { stroke: rgba(colour, this.day ? 0.9 : 0), width: this.day ? 1 : 0, points: { show: false } };
    const paths = panel.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined;
    return {
      ...this.size(panel), legend: { show: false },
      cursor: { y: false, drag: { x: false, y: false }, points: { size: 7 } },
      scales: {
        x: { time: true, range: () => this.times() },
        y: { range: () => panel.range },
      },
      axes: [
        { ...axis, size: 28, space: 70, values: (_, ticks) => ticks.map((time) => clock(time).slice(0, this.day ? 5 : 8)) },
        { ...axis, size: 64, space: 26, values: (_, ticks) => ticks.map(short) },
      ],
      series: [{}, { stroke: colour, width: 1.6, points: { show: false }, paths }, edge, edge],
      bands: [{ series: [3, 2], fill: rgba(colour, Number(css("--band"))) }],
      hooks: { drawClear: [(plot) => this.shade(plot)] },
    };
  }

  /** The time axis: all there is, a minute at least (an hour of a day). */
  times() {
    const [first] = this.day ? this.store.dayColumn("t_s") : this.store.columns[0] || [];
    const [least, most] = this.day ? [3600, DAY_S] : [60, RECENT_S];
    const shown = first === undefined ? most : Math.min(most, Math.max(least, this.now - first));
    return [this.now - shown, this.now];
  }

  size(panel) {
    return { width: Math.max(panel.place.clientWidth, 200), height: panel.std ? 190 : 140 };
  }

  resize() {
    for (const panel of this.panels) panel.plot?.setSize(this.size(panel));
  }

  /** The columns of a panel: times, values, low and high edge of the band. Sets its range, too. */
  data(panel) {
    const { store } = this, show = (value) => (value === null ? null : panel.show(value));
    let times, values, low, high;
    if (this.day) {
      const minutes = this.minutes(), column = (name) => store.dayColumn(name);
      const shown = (values) => minutes.map(([, at]) => show(values[at] ?? null));
      times = minutes.map(([time]) => time);
      [low, high] = [shown(column(`${panel.name}_low`)), shown(column(`${panel.name}_high`))];
      values = times.map(() => null);
    } else {
      times = store.columns[0] || [];
      values = store.column(panel.name).map(show);
      const stds = panel.std ? store.column(panel.std) : [];
      const edge = (sign) => values.map((v, at) => (v === null || !(stds[at] >= 0) ? null : v + sign * 2 * show(stds[at])));
      low = panel.std ? edge(-1) : values.map(() => null);
      high = panel.std ? edge(1) : low;
    }
    panel.range = range(this.day ? low.concat(high) : values, panel, this.day ? [] : high, values);
    return [times, values, low, high];
  }

  /** The begin and the end of each minute of the day with its position, and -1 where minutes are missing. */
  minutes() {
    const begins = this.store.dayColumn("t_s");
    return begins.flatMap((begin, at) => {
      const minute = [[begin, at], [begin + 0.99 * MINUTE_S, at]];
      return begin - begins[at - 1] > DAY_GAP_S ? [[begin - MINUTE_S, -1], ...minute] : minute;
    });
  }

  /** Each minute of the day, the darker the more of it a gate was closed. */
  shadeDay({ ctx, bbox, valToPos }) {
    const times = this.store.dayColumn("t_s"), open = this.store.dayColumn("open");
    ctx.save();
    times.forEach((time, at) => {
      const left = Math.max(valToPos(time, "x", true), bbox.left), right = valToPos(time + 60, "x", true);
      if (right <= bbox.left || open[at] >= 1) return;
      ctx.fillStyle = `rgba(128,128,128,${(0.45 * (1 - open[at])).toFixed(3)})`;
      ctx.fillRect(left, bbox.top, Math.max(right - left, 1), bbox.height);
    });
    ctx.restore();
  }

  /** Shade the spans of closed gates, with their names where there is room. */
  shade(plot) {
    if (this.day) return this.shadeDay(plot);
    const { ctx, bbox } = plot, ratio = devicePixelRatio || 1;
    const first = plot === this.panels[0].plot;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.font = `${11 * ratio}px system-ui`;
    for (const { from, to, code } of this.store.spans) {
      const left = plot.valToPos(from, "x", true), right = plot.valToPos(to, "x", true);
      if (right < bbox.left) continue;
      const name = gateName(this.gates, code), kind = kindOf(name.replaceAll(" ", "_"));
      const width = Math.max(right - left, 1);
      ctx.fillStyle = `rgba(${kind.rgb},.16)`;
      ctx.fillRect(left, bbox.top, width, bbox.height);
      if (width > 4 * ratio) hatch(ctx, kind, left, bbox, width, 9 * ratio);
      if (first && ctx.measureText(name).width + 6 < width) {
        ctx.fillStyle = css("--text");
        ctx.fillText(name, Math.max(left, bbox.left) + 3 * ratio, bbox.top + 12 * ratio);
      }
    }
    ctx.restore();
  }
}

function figure(place, panel) {
  const outside = document.createElement("figure"), caption = document.createElement("figcaption");
  const inside = document.createElement("div");
  caption.textContent = panel.title;
  inside.className = "plot";
  inside.id = `plot-${panel.name}`;
  inside.setAttribute("role", "img");
  inside.setAttribute("aria-label", panel.title);
  outside.append(caption, inside);
  place.append(outside);
  return { place: inside };
}

/** The y axis: what the values span, and the band where it is not much wider than usual. */
function range(values, panel, high, centre) {
  let least = Infinity, most = -Infinity;
  for (const value of panel.trimmed ? trimmed(values) : values) {
    if (value === null) continue;
    if (value < least) least = value;
    if (value > most) most = value;
  }
  if (least > most) return [0, panel.least];
  const half = high.map((value, at) => (value === null ? null : value - centre[at])).filter((v) => v !== null);
  const usual = half.length ? half.sort((a, b) => a - b)[half.length >> 1] : 0;
  const room = usual + 0.05 * (most - least);
  const lacking = Math.max(0, panel.least - (most - least + 2 * room)) / 2;
  return [least - room - lacking, most + room + lacking];
}

/** All but the outermost hundredth: single peaks of a residual must not flatten the rest. */
function trimmed(values) {
  const sorted = values.filter((value) => value !== null).sort((a, b) => a - b);
  const cut = Math.floor(sorted.length / 100);
  return sorted.slice(cut, sorted.length - cut);
}

/** Lines across a span; the slope separates kinds of gates without colour. */
function hatch(ctx, { rgb, slope }, left, { top, height }, width, step) {
  if (slope === null) return;
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, top, width, height);
  ctx.clip();
  ctx.strokeStyle = `rgba(${rgb},.45)`;
  ctx.beginPath();
  if (slope === 0) {
    for (let y = top; y < top + height; y += step) { ctx.moveTo(left, y); ctx.lineTo(left + width, y); }
  } else {
    const run = height / slope, begin = Math.floor((left - Math.abs(run)) / step) * step;
    for (let x = begin; x < left + width + Math.abs(run); x += step) {
      ctx.moveTo(x, top); ctx.lineTo(x + run, top + height);
    }
  }
  ctx.stroke();
  ctx.restore();
}

const short = (value) => (Math.abs(value) < 100 ? String(Math.round(100 * value) / 100) : number(value));

/** The road ahead: grade over distance, from `road_ahead` of the status. Returns the plot. */
export function road(place, ahead, before) {
  const data = [ahead.distance_m, ahead.grade.map((grade) => (grade === null ? null : 100 * grade))];
  if (before) { before.setData(data); return before; }
  const axis = { stroke: css("--soft"), grid: { stroke: css("--grid") }, font: "12px system-ui" };
  place.setAttribute("role", "img");
  return new uPlot({
    width: Math.max(place.clientWidth, 200), height: 140, legend: { show: false }, cursor: { show: false },
    scales: { x: { time: false } },
    axes: [{ ...axis, label: "m ahead", labelSize: 18 }, { ...axis, size: 64 }],
    series: [{}, { stroke: css("--grade"), width: 2, points: { show: false } }],
  }, data, place);
}
