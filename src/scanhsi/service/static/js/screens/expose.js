// Expose: how bright it is, what is saturated; exposure and gain.

import { patch, post } from "../api.js";
import { choice, field, h, stat } from "../dom.js";
import { plot } from "../draw/plot.js";
import { number, percent } from "../format.js";
import { state } from "../store.js";
import { command, commands, controlNote, framePicture, jobCard, liveSwitch } from "./common.js";

function open(element, page) {
  const frame = framePicture(page);
  const spectrum = plot({ label: "mean spectrum" });
  const [brightest, mean, saturated] = [stat("brightest"), stat("mean"), stat("saturated")];
  page.on("frame", (shown) => {
    spectrum.show({ x: shown.spectrum.map((_, index) => index * shown.stride[0]), lines: [{ y: shown.spectrum }], xlabel: "band", ylabel: "counts", ymin: 0 });
    brightest.show(percent(shown.maximum / shown.full_scale));
    mean.show(percent(shown.mean / shown.full_scale));
    saturated.show(String(shown.saturated), shown.saturated > 0);
  });
  const limits = state.capabilities?.camera ?? {};
  const exposure = field("exposure", { unit: "ms" });
  const gain = field("gain", { unit: "dB" });
  const format = choice("pixel format", (limits.pixel_formats ?? []).map((name) => [name, name]), { "data-command": "" });
  const fastest = h("p.muted");
  const warning = h("p.note.warn", { hidden: true }, "Gain adds noise and no light: longer exposure or more light is better.");
  let before = "";
  page.on("state", (info) => {
    if (!info || JSON.stringify(info.camera) === before) return;
    before = JSON.stringify(info.camera);
    exposure.value = number(info.camera.exposure_s * 1e3, 5);
    gain.value = info.camera.gain_db;
    format.value = info.camera.pixel_format;
    warning.hidden = !(info.camera.gain_db > 0);
    tellFastest(fastest);
  });
  const apply = () => patch("/camera", { exposure_s: exposure.value / 1e3, gain_db: gain.value, pixel_format: format.value || null });
  for (const one of [exposure, gain]) {
    one.input.setAttribute("data-command", "");
    one.input.addEventListener("keydown", (event) => event.key === "Enter" && one.input.blur());
  }
  const job = jobCard(page, ["auto-exposure"]);
  const controls = h("div.pane.scrolls",
    controlNote(),
    liveSwitch(page),
    h("div.card", h("div.stats", brightest.element, mean.element, saturated.element)),
    h("div.grid2", exposure.element, gain.element),
    format.element,
    warning,
    h("div.row.even", command("Apply", apply, { kind: "primary" }), command("Auto-exposure", () => post("/auto-exposure"))),
    job.element,
    fastest,
    h("p.muted", "Auto-exposure wants the white tile before the instrument. Saturated pixels are red."));
  element.append(h("div.panes", h("div.pane", frame.element, h("div.card.narrow-only", { style: { flex: "0 0 42%" } }, histogram(page))),
    h("div.pane.plots", h("div.card.fills", h("h2", "Histogram"), histogram(page)), h("div.card.fills", h("h2", "Spectrum"), spectrum.element)),
    controls));
  commands(page, controls);
}

// Below the picture in a narrow window, in a pane of its own in a wide one.
function histogram(page) {
  const shown = plot({ label: "histogram of counts" });
  page.on("frame", ({ histogram: counts, full_scale: top }) => shown.show({
    x: counts.map((_, index) => ((index + 0.5) * (top + 1)) / counts.length),
    bars: counts.map((count) => Math.log10(1 + count)),
    hot: counts.length - 1,
    xlabel: "counts", ylabel: "log₁₀ of pixels", ymin: 0,
  }));
  return shown.element;
}

// What the exposure leaves of the line rate: of a sweep, which is the fastest, by the delays of the instrument.
async function tellFastest(element) {
  const told = await post("/plan", { mode: "continuous" }).catch(() => null);
  element.textContent = told?.time ? `At this exposure at most ${told.time.lines_per_second.toFixed(1)} lines/s.` : "";
}

export default { title: "Expose", open };
