// Scan: start, watch it grow, pause, end. All of it without scrolling.

import { get, post } from "../api.js";
import { button, fill, h, stat } from "../dom.js";
import { budget } from "../draw/budget.js";
import { percent, seconds } from "../format.js";
import { ask } from "../messages.js";
import { state } from "../store.js";
import { command, commands, rowsPicture } from "./common.js";
import { planOf, savedPlan } from "./planned.js";

const OVER = ["done", "stopped", "failed", "cancelled"];

function open(element, page) {
  let job = null;
  const waterfall = rowsPicture(page);
  const [rate, efficiency, left, passed, stored, lost] =
    [stat("lines/s"), stat("efficiency"), stat("time left"), stat("passed"), stat("stored"), stat("lost")];
  const line = h("b");
  const bar = h("i", { style: { width: "0" } });
  const times = budget();
  const title = h("h2", "No scan yet");
  const buttons = h("div.row.even");

  const progress = (data) => {
    if (!data) return;
    line.textContent = `line ${data.taken + data.missing} of ${data.lines}`;
    passed.show(seconds(data.elapsed_s));
    rate.show(data.lines_per_second?.toFixed(1) ?? "–");
    efficiency.show(percent(data.efficiency));
    left.show(seconds(data.remaining_s));
    lost.show(String(data.missing), data.missing > 0);
    stored.show(String(data.stored));
    bar.style.width = `${(100 * (data.taken + data.missing)) / data.lines}%`;
    if (data.budget) times.show(data);
  };
  const draw = (changed) => {
    if (changed.kind !== "scan") return;
    job = changed;
    title.textContent = `${job.title.replace(/ into .*/, "")}: ${job.state}`;
    progress(job.progress);
    waterfall.say(job.output ?? job.request.target ?? "not stored");
    if (OVER.includes(job.state)) {
      left.show("over");
      if (job.result) ended(job.result);
    }
    controls();
  };
  const ended = (report) => {
    rate.show(report.lines_per_second?.toFixed(1) ?? "–");
    efficiency.show(percent(report.efficiency));
    stored.show(String(report.stored));
    lost.show(String(report.missing), report.missing > 0);
  };
  let drawn = "";
  const controls = () => {
    const now = job ? `${job.id} ${job.state}` : "none";
    if (now === drawn) return; // a button that is replaced under the finger hears nothing
    drawn = now;
    if (!job || OVER.includes(job.state)) {
      fill(buttons, command("Scan", start, { kind: "primary", id: "start-scan" }),
        job?.output && job.state !== "failed" && button("View", () => { location.hash = `#view/${job.output}`; }));
    } else {
      fill(buttons,
        job.can_pause && (job.state === "paused"
          ? command("Resume", () => post(`/jobs/${job.id}/resume`), { kind: "primary" })
          : command("Pause", () => post(`/jobs/${job.id}/pause`))),
        command("Finish", () => post(`/jobs/${job.id}/finish`), { title: "End after this line; the cube is shorter" }),
        command("Abort", () => post(`/jobs/${job.id}/cancel`), { kind: "danger", title: "End at once; stored lines are kept" }));
    }
    commands(page, buttons);
  };
  const start = async () => {
    const plan = savedPlan();
    const facts = `${plan.lines} lines, ${seconds(state.info.camera.exposure_s)} exposure, ${plan.mode}`;
    if (state.info.mirror.step === null || !state.info.mirror.homed) {
      if (!(await ask("The mirror will look for home", [h("p", "It turns, then the scan begins. Is the way clear?")], { yes: "Scan" }))) return;
    }
    const before = title.textContent;
    title.textContent = `Starting: ${facts}`;
    try {
      await post("/scans", planOf(plan));
    } catch (error) {
      title.textContent = before;
      throw error;
    }
  };

  page.on("job", draw);
  page.on("progress", progress);
  element.append(h("div.panes.wide",
    h("div.pane", waterfall.element),
    h("div.pane",
      h("div.card", title, line, h("div.meter", { role: "progressbar", "aria-label": "lines taken" }, bar),
        h("div.stats", [rate, efficiency, left, passed, stored, lost].map((one) => one.element))),
      h("div.card.fills", h("h2", "Where the time goes"), times.element),
      buttons)));
  waterfall.say("the colour picture grows here");
  get("/jobs").then((jobs) => {
    const last = jobs.find((one) => one.kind === "scan");
    if (last && !job) draw(last);
  }).catch(() => {}).finally(controls);
}

export default { title: "Scan", open };
