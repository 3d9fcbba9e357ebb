// Calibrate: choose, start, put before the instrument what is asked for, read what came of it.

import { get, post } from "../api.js";
import { button, fill, h } from "../dom.js";
import { number } from "../format.js";
import { download } from "./download.js";
import { attempt } from "../messages.js";
import { state } from "../store.js";
import { command, commands, controlNote, jobCard } from "./common.js";

const WHAT = {
  dark: ["Dark", "Lens covered. Dark current and offset of each pixel, hot pixels."],
  white: ["White", "White tile. What the light and the optics do to a perfect white."],
  photon_transfer: ["Photon transfer", "White tile. Gain, read noise, full well, linearity."],
  snr: ["Signal to noise", "White tile. For each band and exposure."],
  light: ["Light", "White tile, lamp just switched on. Warm-up and drift."],
  wavelength: ["Wavelength", "Mercury-argon lamp. Which band is which wavelength, and how sharp."],
  tile: ["Wavelength tile", "Tile with absorption peaks. A check of the wavelengths."],
  smile: ["Smile", "Mercury-argon lamp. How spectral lines bend along the slit."],
  keystone: ["Keystone", "Slanted lines. How places shift with wavelength."],
  geometry: ["Geometry", "Amsler grid. Distance, normal step, tilt."],
  jitter: ["Jitter", "Slanted lines. How exactly the mirror stands."],
  backlash: ["Backlash", "Slanted lines. What the mirror loses when it turns back."],
  repeatability: ["Repeatability", "Slanted lines, several times. How well it comes back."],
  resolution: ["Resolution", "Slanted edge. MTF along both axes."],
};

function open(element, page) {
  const results = h("div.pane.fills.scrolls");
  const job = jobCard(page, ["calibration", "auto-exposure"], (over) => over.result?.rows && show(over));
  const kinds = state.capabilities?.calibrations ?? [];
  const list = h("div.list", kinds.map((kind) => {
    const [name, text] = WHAT[kind] ?? [kind.replaceAll("_", " "), ""];
    return h("div.card", h("div.row", { style: { flexWrap: "nowrap" } },
      h("div", { style: { flex: "1" } }, h("b", name), h("p.muted", text)),
      command("Start", () => post("/calibrations", { kind }), { "aria-label": `start ${name}` })));
  }));
  const show = ({ title, output, result }) => fill(results, h("div.card",
    h("h2", title), result.simulated && h("div.badge", { style: { alignSelf: "flex-start" } }, "SIMULATED"),
    h("table", h("tbody", result.rows.map((row) => h("tr", h("th", row.label ?? row.name ?? row.quantity), h("td", value(row)))))),
    h("p.muted", `Kept as ${output}.`)));
  element.append(h("div.panes.wide",
    h("div.pane.scrolls", { tabIndex: 0 }, controlNote(), list),
    h("div.pane", job.element, results,
      button("Specification sheet", () => attempt(() => download("/spec?format=pdf"))))));
  fill(results, h("p.note", "Each calibration says what it needs before the instrument and waits until it is there. Results are kept in the data folder and go into the specification sheet."));
  commands(page, element);
  get("/jobs").then((jobs) => {
    const last = jobs.find((one) => ["calibration", "auto-exposure"].includes(one.kind));
    if (!last) return;
    job.draw(last);
    if (last.result?.rows) show(last);
  }).catch(() => {});
}

function value(row) {
  if (row.text) return row.text;
  if (typeof row.value !== "number") return row.value ?? "–";
  const sigma = row.uncertainty ?? row.sigma;
  return `${number(row.value, 4)}${sigma ? ` ± ${number(sigma, 2)}` : ""} ${row.unit ?? ""}`;
}

export default { title: "Calibrate", open };
