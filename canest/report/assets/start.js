// Draws the figures of a page, gives each its cursor, and its map where there are positions.
"use strict";

/** The track on a plane, coloured by an estimate; the cursor's place on it is marked. */
canest.Track = class {
  constructor(cursor, track) {
    Object.assign(this, { cursor, track, colour: "grade" });
    const { element } = canest;
    const [wide, tall] = [track.east_km, track.north_km].map((list) => {
      const [low, high] = canest.extent(list);
      return (high - low).toFixed(1);
    });
    this.plot = element("div", { class: "map", role: "img", "aria-label": `Track, ${wide} km east to west, ${tall} km north to south` });
    const select = element("select", {}, ...Object.keys(track.colours).map((name) => element("option", {}, name)));
    select.addEventListener("change", () => { this.colour = select.value; this.draw(); });
    cursor.figure.box.querySelector(".track").append(element("label", {}, "Track coloured by ", select), this.plot);
    cursor.onMove = (t) => this.mark(t);
    canest.theme.onChange(() => this.draw());
  }

  async draw() {
    const { track } = this, { values, unit, scale } = track.colours[this.colour];
    const [cmin, cmax] = canest.extent(values.filter((v) => v !== null), true);
    const most = Math.max(Math.abs(cmin ?? 0), Math.abs(cmax ?? 0), 0.1);
    const ink = canest.theme.tint("#1c2733"), muted = canest.theme.tint("#5b697e"), ground = canest.theme.tint("#ffffff");
    const common = { type: "scatter", mode: "markers", hoverinfo: "none" };
    const axis = { gridcolor: canest.theme.tint("#e6eaf0"), zeroline: false, ticksuffix: " km", nticks: 5 };
    await Plotly.react(this.plot, [
      { ...common, mode: "lines", x: track.east_km, y: track.north_km, line: { color: muted, width: 1 }, hoverinfo: "skip" },
      { ...common, x: track.east_km, y: track.north_km, marker: {
        size: 6, color: values, colorscale: scale, cmin: this.colour === "grade" ? -most : cmin,
        cmax: this.colour === "grade" ? most : cmax,
        colorbar: { orientation: "h", thickness: 10, y: 1.02, yanchor: "bottom", title: { text: `${this.colour}, ${unit}`, side: "top" } } } },
      { ...common, x: [null], y: [null], hoverinfo: "skip", marker: { size: 14, color: "rgba(0,0,0,0)", line: { color: ink, width: 3 } } },
    ], {
      height: 360, margin: { l: 52, r: 8, t: 64, b: 32 }, showlegend: false, hovermode: "closest",
      paper_bgcolor: ground, plot_bgcolor: ground, font: { color: ink, size: 11 }, dragmode: false,
      xaxis: axis, yaxis: { ...axis, scaleanchor: "x" },
    }, { displayModeBar: false, responsive: true });
    if (!this.listens) this.plot.on("plotly_hover", (event) => this.cursor.move(this.track.t[event.points[0].pointIndex]));
    this.listens = true;
    this.mark(this.cursor.t);
  }

  mark(t) {
    if (!this.listens) return;
    const place = [this.track.east_km, this.track.north_km].map((list) => [[canest.between(t, this.track.t, list)]]);
    Plotly.restyle(this.plot, { x: place[0], y: place[1] }, [2]);
  }
};

canest.start = async () => {
  canest.theme.start();
  canest.tables = [...document.querySelectorAll("table.sortable")].map((table) => new canest.Table(table));
  canest.figures = [];
  for (const box of document.querySelectorAll(".drawn")) {
    const figure = new canest.Figure(box);
    canest.figures.push(figure);
    await figure.draw();
    if (!figure.linked) continue;
    figure.cursor = new canest.Cursor(figure);
    if (figure.linked.track) await new canest.Track(figure.cursor, figure.linked.track).draw();
  }
  document.documentElement.dataset.drawn = "yes";
};
document.addEventListener("DOMContentLoaded", canest.start);
