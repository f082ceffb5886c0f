// The rows that the page keeps: ten minutes at 10 Hz in columns, and the spans of closed gates.
export const RECENT_S = 600;
export const MINUTE_S = 60; // what a row of the day stands for
const GAP_S = 3; // between rows that no curve joins, unless the stream is as slow as that
const SLACK_S = 30; // rows go in batches: cutting columns at every row would cost more than their room

export class Store {
  constructor() {
    this.names = [];
    this.columns = [];
    this.spans = [];
    this.step = Infinity; // the usual distance of rows
    this.day = { names: [], columns: [] };
  }

  /** Take what `/history` gave. */
  load(history) {
    this.names = history.columns;
    this.columns = this.names.map(() => []);
    this.spans = [];
    this.step = Infinity;
    this.add(history.recent);
    this.loadDay(history);
  }

  loadDay({ day_columns: names, day }) {
    this.day = { names, columns: names.map((_, at) => day.map((row) => row[at])) };
  }

  /** What is there now, to stay as it is. */
  copy() {
    const { names, step, day } = this;
    const columns = this.columns.map((column) => [...column]), spans = this.spans.map((span) => ({ ...span }));
    return Object.assign(new Store(), { names, step, day, columns, spans });
  }

  get length() {
    return this.columns.length ? this.columns[0].length : 0;
  }

  get lastTime() {
    return this.length ? this.columns[0][this.length - 1] : null;
  }

  /** The values of a column, an empty array where there is no such column. */
  column(name) {
    return this.columns[this.names.indexOf(name)] || [];
  }

  dayColumn(name) {
    return this.day.columns[this.day.names.indexOf(name)] || [];
  }

  /** Take rows in the order of time; a time that goes back overwrites what was there. */
  add(rows) {
    const gate = this.names.indexOf("gate");
    for (const row of rows) {
      while (this.length && this.lastTime >= row[0]) this.columns.forEach((column) => column.pop());
      if (this.length) this.addGap(row[0] - this.lastTime);
      row.forEach((value, at) => this.columns[at].push(value));
      this.addGate(row[0], row[gate]);
    }
    if (this.length && this.columns[0][0] < this.lastTime - RECENT_S - SLACK_S) this.cut();
  }

  /** A row without values where rows are further apart than usual: it breaks the curves. */
  addGap(distance) {
    this.step = Math.min(distance, 2 * this.step);
    if (distance <= Math.max(GAP_S, 2 * this.step)) return;
    this.columns.forEach((column, at) => column.push(at ? null : this.lastTime + distance / 2));
  }

  addGate(time, code) {
    const open = this.spans.at(-1);
    if (open && (open.to > time || open.from > time)) {
      this.spans = this.spans.filter((span) => span.to < time);
    }
    const last = this.spans.at(-1);
    if (last && last.code === code && time - last.to < 1) last.to = time;
    else if (code) {
      if (last && time - last.to < 0.35) last.to = time; // no gap between two gates that follow each other
      this.spans.push({ from: time, to: time + 0.1, code });
    }
  }

  cut() {
    const first = this.columns[0].findIndex((time) => time >= this.lastTime - RECENT_S);
    this.columns.forEach((column, at) => { this.columns[at] = column.slice(first); });
    this.spans = this.spans.filter((span) => span.to >= this.lastTime - RECENT_S);
  }

  /** The row at a time as an object, null where nothing is known. */
  rowAt(time) {
    const row = this.row(this.at(time));
    const near = row && Math.abs(row.t_s - time) <= Math.max(GAP_S / 2, this.step);
    return near && this.names.some((name) => name !== "t_s" && row[name] !== null) ? row : null;
  }

  /** The minute of the day at a time as an object, null where nothing is known. */
  minuteAt(time) {
    const at = this.dayColumn("t_s").findLastIndex((begin) => begin <= time);
    if (at < 0 || time >= this.day.columns[0][at] + MINUTE_S) return null;
    return Object.fromEntries(this.day.names.map((name, column) => [name, this.day.columns[column][at]]));
  }

  /** The position of the row nearest to a time, -1 without rows. */
  at(time) {
    const times = this.columns[0] || [];
    let low = 0, high = times.length - 1;
    if (high < 0) return -1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < time) low = middle + 1; else high = middle;
    }
    return low > 0 && time - times[low - 1] < times[low] - time ? low - 1 : low;
  }

  /** A row as an object, null where there is none. */
  row(at) {
    if (at < 0 || at >= this.length) return null;
    return Object.fromEntries(this.names.map((name, column) => [name, this.columns[column][at]]));
  }
}
