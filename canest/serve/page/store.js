// The rows that the page keeps: ten minutes at 10 Hz in columns, and the spans of closed gates.
export const RECENT_S = 600;
const SLACK_S = 30; // rows go in batches: cutting columns at every row would cost more than their room

export class Store {
  constructor() {
    this.names = [];
    this.columns = [];
    this.spans = [];
    this.day = { names: [], columns: [] };
  }

  /** Take what `/history` gave. */
  load(history) {
    this.names = history.columns;
    this.columns = this.names.map(() => []);
    this.spans = [];
    this.add(history.recent);
    const names = history.day_columns;
    this.day = { names, columns: names.map((_, at) => history.day.map((row) => row[at])) };
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
      row.forEach((value, at) => this.columns[at].push(value));
      this.addGate(row[0], row[gate]);
    }
    if (this.length && this.columns[0][0] < this.lastTime - RECENT_S - SLACK_S) this.cut();
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
