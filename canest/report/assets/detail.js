// All samples of a drive: chunks that are unpacked when a zoom or the cursor wants them (canest/report/detail.py).
"use strict";

/** The index of the last value that is not above x in a list that ascends; 0 where there is none. */
canest.lastBelow = (list, x) => {
  let low = 0, high = list.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (list[middle] <= x) low = middle; else high = middle - 1;
  }
  return low;
};

canest.Detail = class {
  constructor(spec) {
    this.spec = spec;
    this.unpacked = new Map();
  }

  /** Samples between two times, s; chunks are counted by their share. */
  count(from, to) {
    return this.spec.chunks.reduce((sum, c) => {
      const length = Math.max(c.last - c.first, this.spec.step_s);
      return sum + c.count * Math.max(0, Math.min(to, c.last) - Math.max(from, c.first)) / length;
    }, 0);
  }

  /** Columns of the samples from `from` to `to`, s; `t` is their time. */
  async range(from, to) {
    const found = {};
    for (const chunk of this.spec.chunks) {
      if (chunk.last < from || chunk.first > to) continue;
      const columns = await this.columns(chunk);
      const keep = columns.t.map((t, i) => (t >= from && t <= to ? i : -1)).filter((i) => i >= 0);
      for (const [name, column] of Object.entries(columns)) {
        (found[name] ??= []).push(...keep.map((i) => column[i]));
      }
    }
    return found;
  }

  /** The sample nearest to a time, s; null where there is none. */
  async at(time) {
    let best = null;
    const away = (c) => Math.max(c.first - time, time - c.last, 0);
    for (const chunk of this.spec.chunks) if (!best || away(chunk) < away(best)) best = chunk;
    if (!best) return null;
    const columns = await this.columns(best);
    let i = canest.lastBelow(columns.t, time);
    if (i + 1 < columns.t.length && columns.t[i + 1] - time < time - columns.t[i]) i += 1;
    return Object.fromEntries(Object.entries(columns).map(([name, column]) => [name, column[i]]));
  }

  columns(chunk) {
    if (!this.unpacked.has(chunk)) {
      if (this.unpacked.size > 60) this.unpacked.delete(this.unpacked.keys().next().value);
      this.unpacked.set(chunk, this.unpack(chunk));
    }
    return this.unpacked.get(chunk);
  }

  async unpack(chunk) {
    const packed = Uint8Array.from(atob(chunk.data), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = chunk.count, columns = {};
    this.spec.columns.forEach(([name, resolution], k) => {
      const values = new Array(n);
      let whole = 0;
      for (let i = 0, at = 4 * n * k; i < n; i += 1, at += 1) {
        const coded = bytes[at] | (bytes[at + n] << 8) | (bytes[at + 2 * n] << 16) | (bytes[at + 3 * n] << 24);
        whole = (whole + ((coded >>> 1) ^ -(coded & 1))) | 0;
        values[i] = whole === -2147483648 ? null : whole * resolution;
      }
      columns[name] = values;
    });
    columns.t = columns.tick.map((tick) => tick * this.spec.step_s);
    return columns;
  }
};
