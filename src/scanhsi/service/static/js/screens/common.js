// What several screens show: the live picture, the switch for it, a job that runs.

import { post, put } from "../api.js";
import { whileInControl } from "../control.js";
import { button, fill, h } from "../dom.js";
import { colourImage, greyImage, stretchOf } from "../draw/colours.js";
import { picture } from "../draw/picture.js";
import { attempt } from "../messages.js";
import { state } from "../store.js";

// The frame as it comes: samples across, bands down.
export function framePicture(page, options = {}) {
  const shown = picture(options);
  const draw = (frame) => {
    if (!frame) return;
    shown.show(greyImage(frame.pixels, frame.shape[1], frame.shape[0]));
    shown.say(`${frame.samples} samples × ${frame.bands} bands${frame.saturated ? `, ${frame.saturated} saturated` : ""}`);
  };
  draw(state.frame);
  if (!state.frame) shown.say("no frame yet: switch the live view on");
  page.on("frame", draw);
  return shown;
}

// The colour picture of a scan as it grows: samples across, lines down. What is brightest so far is taken for white, what is
// darkest for black.
export function rowsPicture(page, options = {}) {
  const shown = picture(options);
  let epoch = null;
  let stretch = null;
  const draw = (rows) => {
    if (!rows) return;
    const soFar = rows.all.subarray(0, rows.reached * rows.width * 3);
    const fitting = stretchOf(soFar);
    const off = !stretch || fitting.some(([low, gain], channel) => Math.abs(low - stretch[channel][0]) > 4 || Math.abs(gain / stretch[channel][1] - 1) > 0.08);
    if (epoch !== rows.epoch) shown.begin(rows.width, rows.rows);
    if (epoch !== rows.epoch || off) {
      [epoch, stretch] = [rows.epoch, fitting];
      if (rows.reached) shown.rows(colourImage(soFar, rows.width, rows.reached, stretch), 0);
    } else if (rows.shape[0]) shown.rows(colourImage(rows.pixels, rows.width, rows.shape[0], stretch), rows.first);
  };
  draw(state.rows);
  page.on("rows", draw);
  return shown;
}

export function liveSwitch(page) {
  const element = button("", () => attempt(() => put("/live", { on: !state.info.live })), { "data-command": "" });
  page.on("state", (info) => {
    if (!info) return;
    element.textContent = info.live ? "Live view on" : "Live view off";
    element.setAttribute("aria-pressed", String(info.live));
  });
  return element;
}

// The words that say why the controls are grey.
export const controlNote = () => h("p.note", { "data-control-note": "" }, "You are looking on. Take control to change something.");

export function commands(page, element) {
  page.ended(whileInControl(element));
}

export const command = (text, action, options = {}) =>
  button(text, () => attempt(action), { "data-command": "", ...options });

// What a job of certain kinds is doing: its message, its question, a button to end it.
export function jobCard(page, kinds, onended = () => {}) {
  const element = h("div.card", { hidden: true });
  let shown = null;
  const draw = (job) => {
    if (!kinds.includes(job.kind)) return;
    const over = ["done", "stopped", "failed", "cancelled"].includes(job.state);
    element.hidden = over;
    if (over) {
      if (shown === job.id) onended(job);
      shown = null;
      return;
    }
    shown = job.id;
    fill(element, h("h2", job.title), h("p", job.prompt ?? job.message ?? "under way"),
      h("div.row.even",
        job.state === "waiting" && command("Done, go on", () => post(`/jobs/${job.id}/confirm`), { kind: "primary" }),
        command("Cancel", () => post(`/jobs/${job.id}/cancel`))));
    commands(page, element);
  };
  page.on("job", draw);
  return { element, draw };
}
