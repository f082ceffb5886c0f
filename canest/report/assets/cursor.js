// One cursor over all rows of a figure: pointer, arrow keys and the map move it; it shows the sample in words.
"use strict";

canest.Cursor = class {
  constructor(figure) {
    this.figure = figure;
    const { element } = canest;
    this.line = element("div", { class: "spike", "aria-hidden": "true" });
    figure.plot.parentElement.append(this.line);
    this.slider = element("input", { type: "range", min: 0, max: 500, step: 1, value: 500, "aria-label": "Cursor" });
    this.list = element("dl", { class: "readout" });
    this.note = element("p", { class: "rate" });
    const aside = figure.box.querySelector("aside");
    aside.prepend(element("label", { class: "slide" }, "Cursor", this.slider), this.list, this.note);
    this.slider.addEventListener("input", () => {
      const [from, to] = figure.view;
      this.move(from + (to - from) * this.slider.value / this.slider.max);
    });
    for (const kind of ["pointermove", "pointerdown"]) {
      figure.plot.addEventListener(kind, (event) => {
        const x = event.clientX - figure.plot.getBoundingClientRect().left, { l, w } = this.area();
        if (x < l || x > l + w) return;
        const [from, to] = figure.view.map((t) => figure.toAxis(t));
        this.move(figure.toTime(from + (to - from) * (x - l) / w));
      });
    }
    figure.onChange(() => this.viewed());
    this.toolbar();
    this.viewed();
  }

  area() { return this.figure.plot._fullLayout._size; }

  toolbar() {
    const { figure } = this, { element } = canest;
    const by = (shrink, move) => () => {
      const [from, to] = figure.view, span = (to - from) * shrink;
      // a zoom keeps the cursor where it is, if it is in view
      const middle = shrink !== 1 && this.t >= from && this.t <= to ? this.t : (from + to) / 2;
      figure.show(middle - span / 2 + move * span, middle + span / 2 + move * span);
    };
    const button = (text, label, onclick) => element("button", { type: "button", "aria-label": label, onclick }, text);
    const axis = (name) => {
      const made = element("button", { type: "button", "aria-pressed": String(figure.axis === name) }, name);
      made.addEventListener("click", () => {
        figure.setAxis(name);
        for (const other of group.children) other.setAttribute("aria-pressed", String(other === made));
      });
      return made;
    };
    const group = element("span", { role: "group", "aria-label": "Horizontal axis" });
    group.append(axis("time"), axis("distance"));
    figure.box.querySelector(".tools").append(group,
      button("+", "Zoom in", by(0.25, 0)), button("−", "Zoom out", by(4, 0)),
      button("◀", "Earlier", by(1, -0.5)), button("▶", "Later", by(1, 0.5)),
      button("whole drive", "Show the whole drive", () => figure.show(...figure.whole)));
  }

  viewed() {
    const [from, to] = this.figure.view;
    const step = this.figure.detail?.spec.step_s ?? (to - from) / 500;
    this.slider.max = Math.max(1, Math.min(500, Math.round((to - from) / step)));
    if (this.t === undefined || this.t < from || this.t > to) this.move(to); else this.place();
    this.rate();
  }

  rate() {
    const { isFine, detail } = this.figure;
    if (!detail) return;
    this.note.textContent = isFine ? "Curves show every sample." : "Curves are thinned; zoom in for every sample.";
  }

  /** Put the cursor at a time, s, and show the sample that is nearest. */
  async move(t) {
    this.t = t;
    this.place();
    const row = this.figure.detail ? await this.figure.detail.at(t) : null;
    if (this.t !== t) return; // it has moved on
    const items = row ? this.sample(row) : this.curves(t);
    this.list.replaceChildren(...items.map(([name, text]) => {
      const value = canest.element("dd", { "data-item": name }, text);
      return canest.element("div", {}, canest.element("dt", {}, name), value);
    }));
    this.slider.setAttribute("aria-valuetext", items.map(([name, text]) => `${name} ${text}`).join(", "));
    this.onMove?.(row ? row.t : t);
  }

  place() {
    const { l, t, w, h } = this.area(), [from, to] = this.figure.view;
    const [low, high, at] = [from, to, this.t].map((time) => this.figure.toAxis(time));
    Object.assign(this.line.style, { left: `${l + w * (at - low) / (high - low || 1)}px`, top: `${t}px`, height: `${h}px` });
    this.slider.value = Math.round(this.slider.max * (this.t - from) / (to - from || 1));
  }

  time(t) {
    const start = this.figure.linked.start_s;
    const clock = start ? `, ${new Date(1000 * (start + t)).toISOString().slice(11, 22)} UTC` : "";
    return `${t.toFixed(2)} s${clock}`;
  }

  /** All that is known of a sample: [name, text] each. */
  sample(row) {
    const items = [["time", this.time(row.t)]];
    for (const item of this.figure.linked.items) {
      if (item.words) {
        items.push([item.name, item.words[row[item.column]] ?? "–"]);
        continue;
      }
      const value = canest.number(row[item.column], item), spread = item.std && canest.number(row[item.std], item);
      if (value !== "–" || !item.optional) {
        items.push([item.name, value === "–" ? "–" : `${value}${spread ? ` ± ${spread}` : ""} ${item.unit}`.trim()]);
      }
    }
    return items;
  }

  /** The curves at a time, where the page has them alone. */
  curves(t) {
    const found = new Map();
    this.figure.traces.forEach((trace, k) => {
      if (!trace.meta?.unit || this.figure.isHidden(k)) return;
      const y = trace.y[canest.lastBelow(this.figure.way.t, t)];
      const text = `${canest.number(y, { factor: 1, digits: trace.meta.digits })} ${trace.meta.unit}`;
      found.set(trace.name, [...(found.get(trace.name) ?? []), text]);
    });
    return [["time", this.time(t)], ...[...found].map(([name, texts]) => [name, texts.join(", ")])];
  }
};

canest.number = (value, { factor, digits }) => {
  if (value === null || value === undefined) return "–";
  const options = { minimumFractionDigits: digits, maximumFractionDigits: digits };
  const text = (value * factor).toLocaleString("en", options);
  return Number(text.replaceAll(",", "")) === 0 ? text.replace("-", "") : text.replace("-", "−");
};
