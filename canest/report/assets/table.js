// Tables that can be sorted by any column, and long ones searched.
"use strict";

canest.Table = class {
  static SEARCHED_FROM = 15; // rows

  constructor(table) {
    const [header, ...rows] = table.rows;
    Object.assign(this, { table, rows, header, body: header.parentElement });
    this.texts = rows.map((row) => row.textContent.toLowerCase());
    [...header.cells].forEach((cell, column) => this.makeButton(cell, column));
    if (rows.length >= canest.Table.SEARCHED_FROM) this.makeSearch();
  }

  makeButton(cell, column) {
    if (!cell.textContent) return;
    const button = canest.element("button", { type: "button", class: "sort" }, ...cell.childNodes);
    button.addEventListener("click", () => this.sort(cell, column));
    cell.append(button);
  }

  makeSearch() {
    const { element } = canest;
    const input = element("input", { type: "search" });
    const count = element("span", { role: "status" });
    const show = () => {
      const wanted = input.value.trim().toLowerCase();
      this.rows.forEach((row, k) => { row.hidden = !this.texts[k].includes(wanted); });
      const shown = this.rows.filter((row) => !row.hidden).length;
      count.textContent = wanted ? `${shown.toLocaleString("en")} of ${this.rows.length.toLocaleString("en")}` : "";
    };
    input.addEventListener("input", show);
    this.table.closest(".scroll").before(element("p", { class: "search" }, element("label", {}, "Find ", input), " ", count));
  }

  /** The value of a cell: a number where it is one, null for none. */
  static value(cell) {
    const text = cell.textContent.trim();
    if (text === "" || text === "-") return null;
    const number = text.replaceAll(",", "").split(" ± ")[0];
    return /^[-+]?[0-9.]+$/.test(number) ? Number(number) : text.toLowerCase();
  }

  /** Sort by a column: numbers from the largest, words from A; a second time the other way round. */
  sort(cell, column) {
    const values = new Map(this.rows.map((row) => [row, canest.Table.value(row.cells[column])]));
    const numeric = [...values.values()].some((value) => typeof value === "number");
    const before = cell.getAttribute("aria-sort");
    const up = before ? before === "descending" : !numeric;
    [...this.header.cells].forEach((other) => other.removeAttribute("aria-sort"));
    cell.setAttribute("aria-sort", up ? "ascending" : "descending");
    const order = (a, b) => {
      const [x, y] = [values.get(a), values.get(b)];
      if (x === null || y === null) return (x === null) - (y === null); // what is not known comes last
      return (up ? 1 : -1) * (typeof x === typeof y ? (x > y) - (x < y) : (typeof x === "string") - (typeof y === "string"));
    };
    this.body.append(...[...this.rows].sort(order));
  }
};
