// A figure: plotly draws it; here are its colours, its legend, and the views (zoom, detail, time or distance).
"use strict";

canest.element = (name, attributes = {}, ...children) => {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value); else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
};

canest.tinted = (value) => {
  if (Array.isArray(value)) return value.length > 64 ? value : value.map(canest.tinted);
  if (value && typeof value === "object") {
    return Object.fromEntries(Object.entries(value).map(([key, part]) => [key, canest.tinted(part)]));
  }
  return canest.theme.tint(value);
};

canest.Figure = class {
  static MOST_POINTS = 12_000; // of a curve in view; more of them than pixels help nobody

  constructor(box) {
    this.box = box;
    this.plot = box.querySelector(".figure");
    const figure = JSON.parse(box.querySelector("script").textContent);
    this.layout = figure.layout;
    this.traces = figure.data;
    for (const trace of this.traces) if (typeof trace.x === "number") trace.x = figure.shared[trace.x];
    this.linked = figure.linked ?? null;
    if (!this.linked) return;
    const { linked } = this;
    linked.t = figure.shared[linked.x];
    // the time axis without its gaps, for interpolation
    const known = linked.t.map((t, i) => i).filter((i) => linked.t[i] !== null && linked.distance_km[i] !== null);
    this.way = { t: known.map((i) => linked.t[i]), km: known.map((i) => linked.distance_km[i]) };
    this.axis = "time";
    this.detail = linked.detail ? new canest.Detail(linked.detail) : null;
    this.valid = [...linked.valid].map((flag) => flag === "1");
    this.overview = this.traces.map((trace) => ({ t: trace.x, y: trace.y }));
    this.whole = [this.way.t[0] ?? 0, Math.max(this.way.t.at(-1) ?? 1, ...(linked.detail?.chunks ?? []).map((c) => c.last))];
    this.view = this.whole;
    this.listeners = [];
    for (const key of Object.keys(this.layout)) if (key.startsWith("xaxis")) this.layout[key].range = this.whole;
  }

  async draw() {
    const touch = matchMedia("(pointer: coarse)").matches;
    const layout = { ...canest.tinted(this.layout), showlegend: false, autosize: true };
    if (this.linked) Object.assign(layout, { hovermode: false, dragmode: touch ? false : "zoom" });
    if (this.linked) this.fitted(this.view, layout);
    await Plotly.newPlot(this.plot, canest.tinted(this.traces), layout,
      { responsive: true, displayModeBar: false, showTips: false, doubleClick: this.linked ? false : "reset+autosize" });
    canest.legend(this);
    canest.theme.onChange(() => this.recolour());
    if (!this.linked) return;
    this.plot.on("plotly_relayout", (change) => {
      const low = change["xaxis.range[0]"], high = change["xaxis.range[1]"];
      if (low !== undefined && high !== undefined) this.show(this.toTime(low), this.toTime(high));
    });
    this.plot.on("plotly_doubleclick", () => this.show(...this.whole));
    await this.show(...this.whole);
  }

  recolour() {
    const now = canest.tinted(this.traces.map((t) => ({ line: t.line, marker: t.marker, fillcolor: t.fillcolor })));
    const restyled = { "line.color": [], fillcolor: [], "marker.color": [] };
    now.forEach((t) => {
      restyled["line.color"].push(t.line?.color);
      restyled.fillcolor.push(t.fillcolor);
      restyled["marker.color"].push(t.marker?.color);
    });
    const layout = {};
    for (const [key, value] of Object.entries(canest.tinted(this.layout))) {
      if (/^[xy]axis/.test(key)) for (const c of ["gridcolor", "tickcolor", "zerolinecolor"]) {
        if (value[c]) layout[`${key}.${c}`] = value[c];
      }
      if (/bgcolor$/.test(key)) layout[key] = value;
      if (key === "font") layout["font.color"] = value.color;
    }
    const paper = canest.theme.isPrinting(); // one page of it
    Object.assign(layout, { width: paper ? 680 : null, height: Math.min(this.layout.height, paper ? 660 : Infinity), autosize: !paper });
    Plotly.update(this.plot, restyled, layout);
    canest.legend(this);
    this.changed();
  }

  onChange(listener) { this.listeners.push(listener); }
  changed() { (this.listeners ?? []).forEach((listener) => listener()); }

  /** The place on the x axis of a time, s, and the time of a place. */
  toAxis(t) { return this.axis === "time" || t === null ? t : canest.between(t, this.way.t, this.way.km); }
  toTime(x) { return this.axis === "time" ? x : canest.between(x, this.way.km, this.way.t); }

  setAxis(axis) {
    this.axis = axis;
    return this.show(...this.view);
  }

  /** Show the stretch between two times, s: with all samples if they are few enough, and y axes that fit. */
  async show(from, to) {
    const [first, last] = this.whole;
    const span = Math.min(Math.max(to - from, 0.2), last - first);
    const begin = Math.min(Math.max(from, first), last - span);
    this.view = [begin, begin + span];
    const wanted = this.view;
    const isFine = this.detail && this.detail.count(...wanted) <= canest.Figure.MOST_POINTS;
    const fine = isFine ? await this.detail.range(begin - span / 2, begin + 1.5 * span) : null;
    if (wanted !== this.view) return; // another view was asked for meanwhile
    this.isFine = Boolean(fine?.t?.length);
    const merged = this.isFine ? canest.merge(this, fine) : null;
    this.now = this.traces.map((trace, k) => merged?.of(trace, k) ?? this.overview[k]);
    this.validNow = merged?.valid ?? this.valid;
    const layout = {};
    this.fitted(this.view, layout);
    const range = this.view.map((t) => this.toAxis(t));
    for (const [key, { title }] of Object.entries(this.layout)) {
      if (!key.startsWith("xaxis")) continue;
      layout[`${key}.range`] = range;
      if (title) layout[`${key}.title.text`] = this.axis === "time" ? title.text : "km since the start";
    }
    const places = new Map(); // curves over one time axis share it
    const x = this.now.map(({ t }) => {
      if (!places.has(t)) places.set(t, this.axis === "time" ? t : t.map((value) => this.toAxis(value)));
      return places.get(t);
    });
    await Plotly.update(this.plot, { x, y: this.now.map(({ y }) => y) }, layout);
    this.changed();
  }

  /** Put into a layout the range of each y axis: what is drawn and matters between two times. */
  fitted([from, to], layout) {
    const axes = new Map();
    this.traces.forEach((trace, k) => {
      const key = (trace.yaxis ?? "y").replace("y", "yaxis");
      if (this.layout[key]?.range && this.layout[key].overlaying) return;
      if (this.isHidden(k)) return;
      const values = this.mattering(trace, this.now?.[k] ?? this.overview[k], from, to);
      if (values.length) axes.set(key, [...(axes.get(key) ?? []), canest.extent(values, this.linked.robust?.includes(key))]);
    });
    for (const [key, extents] of axes) {
      const [least, most] = this.linked.limits?.[key] ?? [-Infinity, Infinity];
      let low = Math.max(Math.min(...extents.map((e) => e[0])), least);
      let high = Math.min(Math.max(...extents.map((e) => e[1])), most);
      const smallest = this.linked.smallest?.[key] ?? 0;
      const room = Math.max(0.08 * (high - low), (smallest - (high - low)) / 2, 1e-3);
      low -= room;
      high += room;
      if (layout[key]) layout[key] = { ...layout[key], range: [low, high] }; else layout[`${key}.range`] = [low, high];
    }
  }

  isHidden(k) { return (this.plot.data?.[k]?.visible ?? this.traces[k].visible ?? true) !== true; }

  /** Values of a curve in view; of an estimate those that are valid, if any is: bands start very wide. */
  mattering(trace, { t, y }, from, to) {
    const inView = [], settled = [];
    const flags = trace.meta?.std !== undefined && t.length === (this.validNow ?? this.valid).length
      ? this.validNow ?? this.valid : null;
    for (let i = 0; i < t.length; i += 1) {
      if (t[i] === null || t[i] < from || t[i] > to || y[i] === null) continue;
      inView.push(y[i]);
      if (flags?.[i]) settled.push(y[i]);
    }
    if (!trace.meta?.std) return inView;
    if (settled.length) return settled;
    return trace.meta.times ? [] : canest.extent(inView, true);
  }
};

/** Linear interpolation of a list over another that ascends. */
canest.between = (x, xs, ys) => {
  const i = canest.lastBelow(xs, x);
  if (i + 1 >= xs.length || x <= xs[0] || xs[i + 1] === xs[i]) return ys[i] ?? 0;
  return ys[i] + ((ys[i + 1] - ys[i]) * (x - xs[i])) / (xs[i + 1] - xs[i]);
};

/** The least and the greatest value; robust: but for two in a hundred on either side. */
canest.extent = (values, robust = false) => {
  if (!values.length) return [];
  if (!robust) return values.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
  const sorted = Float64Array.from(values).sort();
  const cut = Math.floor(0.02 * sorted.length);
  return [sorted[cut], sorted[sorted.length - 1 - cut]];
};

/** Curves with all samples where there are some, and the overview on either side. */
canest.merge = (figure, fine) => {
  const { linked } = figure;
  const steps = fine.t.slice(1, 100).map((t, i) => t - fine.t[i]).filter((step) => step > 0);
  const gap = 5.5 * Math.min(...steps); // as `with_gaps` of canest/report/figure.py
  const from = fine.t[0], to = fine.t.at(-1);
  const before = [], after = [], own = [];
  linked.t.forEach((t, i) => { if (t !== null && t < from) before.push(i); else if (t > to) after.push(i); });
  fine.t.forEach((t, i) => {
    if (i && (t - fine.t[i - 1] > gap || t < fine.t[i - 1])) own.push(-1);
    own.push(i);
  });
  const part = (list, which) => which.map((i) => (i < 0 ? null : list[i]));
  const t = [...part(linked.t, before), ...part(fine.t, own), ...part(linked.t, after)];
  const valid = [...part(figure.valid, before), ...own.map((i) => i >= 0 && fine.status[i] === 2), ...part(figure.valid, after)];
  const of = (trace, k) => {
    if (!trace.meta?.column) return null;
    const { column, factor, times, std } = trace.meta;
    const y = own.map((i) => {
      if (i < 0 || fine[column][i] === null) return null;
      return factor * (fine[column][i] + (times ? times * fine[std][i] : 0));
    });
    return { t, y: [...part(figure.overview[k].y, before), ...y, ...part(figure.overview[k].y, after)] };
  };
  return { of, valid };
};

/** How the legend shows a curve: a class of the style sheet. */
canest.drawnAs = (trace) => {
  if (trace.fill === "toself") return "area";
  if (trace.mode === "markers") return trace.marker.symbol === "circle-open" ? "hollow point" : "point";
  return trace.line?.dash ?? "";
};

/** A legend of buttons: each shows or hides the curves of one name. */
canest.legend = (figure) => {
  const place = figure.box.querySelector(".legend");
  place.replaceChildren();
  const group = (trace) => trace.legendgroup ?? trace.name;
  figure.traces.forEach((trace, k) => {
    if (trace.showlegend === false || !trace.name) return;
    const colour = trace.fill === "toself" ? trace.fillcolor : trace.line?.color ?? trace.marker?.color;
    const swatch = canest.element("span", { class: `swatch ${canest.drawnAs(trace)}` });
    swatch.style.color = canest.theme.tint(Array.isArray(colour) ? "" : colour);
    const shown = (figure.plot.data?.[k]?.visible ?? trace.visible ?? true) === true;
    const button = canest.element("button", { type: "button", "aria-pressed": String(shown) }, swatch, trace.name);
    button.addEventListener("click", async () => {
      const mine = figure.traces.map((t, i) => (group(t) === group(trace) ? i : -1)).filter((i) => i >= 0);
      const now = button.getAttribute("aria-pressed") !== "true";
      await Plotly.restyle(figure.plot, { visible: now ? true : "legendonly" }, mine);
      button.setAttribute("aria-pressed", String(now));
      if (figure.linked) figure.show(...figure.view);
    });
    place.append(button);
  });
};
