// Numbers and names as people read them.
const formatted = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
const whole = { format: (value) => formatted.format(value).replace("-0", "0").replace("-", "−") };
export const missing = (value) => value === null || value === undefined || Number.isNaN(value);

export const number = (value) => (missing(value) ? "–" : whole.format(value));
export const unit = (value, name) => (missing(value) ? "–" : `${whole.format(value)} ${name}`);
export const fixed = (value, digits, name) => (missing(value) ? "–" : `${value.toFixed(digits)} ${name}`);
export const percent = (ratio, digits = 2) => {
  if (missing(ratio)) return "–";
  return `${ratio >= 0 ? "+" : "−"}${Math.abs(100 * ratio).toFixed(digits)} %`;
};
export const kmh = (mps) => fixed(missing(mps) ? mps : 3.6 * mps, 1, "km/h");
export const clock = (time) => new Date(1000 * time).toLocaleTimeString("en-GB");
/** The time of day, with the date where it is not today. */
export const moment = (time) => {
  const date = new Date(1000 * time), day = date.toLocaleDateString("en-CA");
  return day === new Date().toLocaleDateString("en-CA") ? clock(time) : `${day} ${clock(time)}`;
};
export const readable = (key) => key.replaceAll("_", " ").replace("pgn ", "PGN ");
export const age = (seconds) => {
  if (seconds < 120) return `${Math.round(seconds)} s`;
  return seconds < 7200 ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
};
export const gateName = (gates, code) => {
  if (missing(code)) return "–";
  return code === 0 ? "open: learning" : (gates[code] || `gate ${code}`).replaceAll("_", " ");
};

/** A row as one sentence, for the readout and for screen readers. */
export function sentence(row, gates) {
  const parts = [clock(row.t_s)];
  if (!missing(row.mass_kg)) parts.push(`mass ${number(row.mass_kg)} ± ${number(row.mass_std_kg)} kg`);
  if (!missing(row.grade)) parts.push(`grade ${percent(row.grade)} ± ${(100 * row.grade_std).toFixed(2)}`);
  if (!missing(row.speed_mps)) parts.push(kmh(row.speed_mps));
  if (!missing(row.torque_Nm)) parts.push(unit(row.torque_Nm, "N m"));
  if (row.gear) parts.push(`gear ${row.gear}`);
  if (!missing(row.residual_N)) parts.push(`residual ${unit(row.residual_N, "N")}`);
  parts.push(row.gate ? `gate ${gateName(gates, row.gate)}` : "learning");
  return parts.join(", ");
}

/** A minute of the day as one sentence: what each value was from and to. */
export function minuteSentence(minute) {
  const range = (title, name, show) => {
    const ends = [minute[`${name}_low`], minute[`${name}_high`]];
    const [low, high] = ends.map((value) => (missing(value) ? "" : show(value)));
    return low && (low === high ? `${title}${low}` : `${title}${low} to ${high}`);
  };
  return [
    moment(minute.t_s).slice(0, -3),
    range("mass ", "mass_kg", (value) => unit(value, "kg")),
    range("grade ", "grade", (value) => percent(value)),
    range("", "speed_mps", kmh),
    range("", "torque_Nm", (value) => unit(value, "N m")),
    range("gear ", "gear", String),
    range("residual ", "residual_N", (value) => unit(value, "N")),
    `learning ${Math.round(100 * minute.open)} % of the minute`,
  ].filter(Boolean).join(", ");
}
