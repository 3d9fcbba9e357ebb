// Expose: how bright it is, what is saturated; exposure and gain.

import { patch, post } from "../api.js";
import { choice, field, h, stat } from "../dom.js";
import { plot } from "../draw/plot.js";
import { number, percent } from "../format.js";
import { state } from "../store.js";
import { command, commands, controlNote, framePicture, jobCard, liveSwitch } from "./common.js";

function open(element, page) {
  const frame = framePicture(page);
  const histogram = plot({ label: "histogram of counts" });
  const spectrum = plot({ label: "mean spectrum" });
  const [brightest, mean, saturated] = [stat("brightest"), stat("mean"), stat("saturated")];
  page.on("frame", (shown) => {
    const width = (shown.full_scale + 1) / shown.histogram.length;
    histogram.show({
      x: shown.histogram.map((_, index) => (index + 0.5) * width),
      bars: shown.histogram.map((count) => Math.log10(1 + count)),
      hot: shown.histogram.length - 1,
      xlabel: "counts", ylabel: "log₁₀ of pixels", ymin: 0,
    });
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
    fastest.textContent = `At this exposure at most ${(1 / info.camera.exposure_s).toFixed(1)} lines/s.`;
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
  element.append(h("div.panes", h("div.pane", frame.element, h("div.card.narrow-only", { style: { flex: "0 0 42%" } }, histogram.element)),
    h("div.pane.plots", h("div.card.fills", h("h2", "Histogram"), wideHistogram(page)), h("div.card.fills", h("h2", "Spectrum"), spectrum.element)),
    controls));
  commands(page, controls);
}

// The same histogram in the pane of a wide window.
function wideHistogram(page) {
  const shown = plot({ label: "histogram of counts" });
  page.on("frame", ({ histogram, full_scale: top }) => shown.show({
    x: histogram.map((_, index) => ((index + 0.5) * (top + 1)) / histogram.length),
    bars: histogram.map((count) => Math.log10(1 + count)),
    hot: histogram.length - 1,
    xlabel: "counts", ylabel: "log₁₀ of pixels", ymin: 0,
  }));
  return shown.element;
}

export default { title: "Expose", open };
