// Calibrate: choose, start, put before the instrument what is asked for, read what came of it.

import { get, post } from "../api.js";
import { button, fill, h } from "../dom.js";
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
  const results = h("div.pane.fills.scrolls", { tabIndex: 0 });
  const job = jobCard(page, ["calibration", "auto-exposure"], (over) => over.result?.rows && show(over));
  const main = h("div.pane.scrolls", { tabIndex: 0 });
  const kinds = state.capabilities?.calibrations ?? [];
  const list = h("div.list", kinds.map((kind) => {
    const [name, text] = WHAT[kind] ?? [kind.replaceAll("_", " "), ""];
    return h("div.card", h("div.row.one",
      h("div.fills", h("b", name), h("p.muted", text)),
      command("Start", () => post("/calibrations", { kind }), { "aria-label": `start ${name}` })));
  }));
  const show = ({ title, output, result }) => fill(results, h("div.card",
    h("h2", title), simulated(result), h("table", h("tbody", result.rows.map((row) => h("tr", h("th", row.title), h("td", value(row)))))),
    h("p.muted", `Kept as ${output}.`)));
  const choose = () => {
    fill(main, controlNote(), list);
    commands(page, main);
    fill(shown, "Specification sheet");
  };
  const shown = button("", () => attempt(async () => {
    if (!list.isConnected) choose();
    else {
      fill(main, sheet(await get("/spec")));
      fill(shown, "Calibrations");
    }
  }));
  element.append(h("div.panes.wide", main, h("div.pane", job.element, results, shown)));
  fill(results, h("p.note", "Each calibration says what it needs before the instrument and waits until it is there. Results are kept in the data folder and go into the specification sheet."));
  choose();
  get("/jobs").then((jobs) => {
    const last = jobs.find((one) => ["calibration", "auto-exposure"].includes(one.kind));
    if (!last) return;
    job.draw(last);
    if (last.result?.rows) show(last);
  }).catch(() => {});
}

const simulated = (of) => of.simulated && h("div.row", h("div.badge", "SIMULATED"));

const value = ({ value: text, uncertainty }) => (uncertainty ? `${text} ± ${uncertainty}` : text);

// Table 7 of the paper, from the results in the data folder.
function sheet({ name, table, further, ...of }) {
  const row = (one) => h("tr", h("th", one.title), h("td", value(one), one.source && h("p.muted", one.source)), h("td", one.paper ?? ""));
  return h("div.card", h("div.row", h("h2", `Specification of ${name}`), simulated(of)),
    h("table", h("thead", h("tr", ["", "here", "in the paper"].map((text) => h("th", text)))), h("tbody", table.map(row), further.map(row))));
}

export default { title: "Calibrate", open };
