// The connection to the server: what it sends, how late that is, and what to do when it fails.
const KINDS = ["rows", "status", "source", "change"];
const MOST_WAITING = 200; // events that wait for the history
const RETRY_MS = 2000, LONGEST_RETRY_MS = 30000;
const DRIFT = 1e-4; // by which two clocks may go apart

export const seconds = () => performance.now() / 1000;

/** The server's clock, as far as what arrives shows it. What came with the least delay shows it best. */
export class ServerClock {
  constructor() {
    this.least = Infinity; // of the page's clock against the server's
    this.sent = -Infinity;
    this.heard = seconds();
  }

  /** Take the time at which an event was sent; events come in their order. */
  hear(sent) {
    if (sent < this.sent) this.least = Infinity; // another server, or its machine was started anew
    else this.least += DRIFT * (seconds() - this.heard);
    [this.sent, this.heard] = [sent, seconds()];
    this.bound(sent);
  }

  /** Take the time at which something else was sent. */
  bound(sent) {
    this.least = Math.min(this.least, seconds() - sent);
  }

  now() {
    return seconds() - this.least;
  }

  /** Seconds by which the last event was late. */
  get late() {
    return this.heard - this.least - this.sent;
  }
}

export class Connection {
  /** page.take(kind, content, sent): called with every event; page.open(history): with what was before. */
  constructor(page) {
    this.page = page;
    this.clock = new ServerClock();
    this.lost = false;
    this.loaded = false;
    this.refusal = ""; // what the server says instead of events
    this.failure = ""; // why there is no history
    this.waiting = [];
    this.loading = 0;
  }

  /** Seconds without a word from the server. */
  get silent() {
    return seconds() - this.clock.heard;
  }

  connect() {
    const events = new EventSource("events");
    events.onopen = () => {
      this.lost = false;
      this.refusal = "";
      this.load();
    };
    events.onerror = () => {
      this.lost = true;
      this.loading += 1;
      if (events.readyState === EventSource.CLOSED) this.refused(); // else the browser connects again by itself
    };
    events.addEventListener("reset", ({ lastEventId }) => {
      this.clock.hear(Number(lastEventId));
      this.load();
    });
    for (const kind of KINDS) {
      events.addEventListener(kind, ({ data, lastEventId }) => {
        const sent = Number(lastEventId), event = [kind, JSON.parse(data), sent];
        this.clock.hear(sent);
        if (!this.waiting) return this.page.take(...event);
        this.waiting.push(event);
        if (this.waiting.length > MOST_WAITING) this.waiting.shift();
      });
    }
  }

  /** Ask why there are no events, which an EventSource does not tell, and connect again. */
  async refused() {
    const stop = new AbortController();
    try {
      const answer = await fetch("events", { signal: stop.signal });
      this.refusal = answer.ok ? "" : (await answer.text()).trim();
    } catch {
      this.refusal = "";
    }
    stop.abort();
    setTimeout(() => this.connect(), RETRY_MS);
  }

  /** Ask for what was before, until it comes or is asked for anew. Events wait for it. */
  async load(retry = RETRY_MS) {
    const number = this.loading += 1;
    let history = null;
    this.waiting = [];
    try {
      const answer = await fetch("history");
      if (!answer.ok) throw new Error((await answer.text()).trim());
      history = await answer.json();
    } catch (error) {
      if (number !== this.loading) return;
      this.failure = error.message;
      setTimeout(() => { if (number === this.loading) this.load(Math.min(2 * retry, LONGEST_RETRY_MS)); }, retry);
      return;
    }
    if (number !== this.loading) return;
    this.clock.bound(history.sent_s);
    this.failure = "";
    this.loaded = true;
    this.page.open(history);
    const waiting = this.waiting, last = history.recent.at(-1)?.[0] ?? -Infinity;
    this.waiting = null;
    for (const [kind, content, sent] of waiting) {
      const rows = kind === "rows" && { ...content, rows: content.rows.filter((row) => row[0] > last) };
      this.page.take(kind, rows || content, sent);
    }
  }
}
