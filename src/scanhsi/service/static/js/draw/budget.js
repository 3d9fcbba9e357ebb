// The time budget of a line, as in Figure 5 of the paper: a lane a stage. Solid is what a stage costs; hatched is what lies hidden
// behind another stage, and would be added by an instrument that does everything in turn.

import { canvas, h } from "../dom.js";
import { seconds } from "../format.js";
import { colour } from "./colours.js";

const COLOURS = { exposure: "exposure", transfer: "transfer", api: "transfer", unpack: "copy", copy: "copy", move: "motion", store: "other" };
const LEFT = 66;
const VALUE = 64;

// `show({period_s, budget: {stage: {alone_s, hidden_s}}})`
export function budget() {
  let data = null;
  const { element, redraw } = canvas((context, width, height) => {
    if (!data) return;
    const stages = Object.entries(data.budget).filter(([, share]) => share.alone_s + share.hidden_s > 0);
    const longest = Math.max(data.period_s, ...stages.map(([, share]) => share.alone_s + share.hidden_s));
    const lane = Math.min(28, (height - 16) / stages.length);
    const across = (value) => LEFT + (value / longest) * (width - LEFT - VALUE);
    context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    context.textBaseline = "middle";
    stages.forEach(([name, share], index) => {
      const [y, end] = [index * lane, across(share.alone_s + share.hidden_s)];
      context.fillStyle = colour("text");
      context.textAlign = "right";
      context.fillText(name, LEFT - 6, y + lane / 2);
      context.fillStyle = colour(COLOURS[name] ?? "other");
      context.fillRect(LEFT, y + 2, end - LEFT, lane - 4);
      hatch(context, across(share.alone_s), y + 2, end, lane - 4);
      context.fillStyle = colour("text");
      context.fillText(seconds(share.alone_s + share.hidden_s), width - 4, y + lane / 2);
    });
    const bottom = stages.length * lane;
    context.strokeStyle = colour("warn");
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(across(data.period_s), 0);
    context.lineTo(across(data.period_s), bottom);
    context.stroke();
    context.fillStyle = colour("muted");
    context.textAlign = "right";
    context.fillText(`line period ${seconds(data.period_s)}; hatched: overlapped`, width - 4, bottom + 8);
  });
  element.setAttribute("role", "img");
  element.setAttribute("aria-label", "time budget of a line");
  return { element: h("div.plot.budget", element), show(to) { data = to; redraw(); } };
}

function hatch(context, from, y, to, height) {
  if (to - from < 1) return;
  context.save();
  context.beginPath();
  context.rect(from, y, to - from, height);
  context.clip();
  context.strokeStyle = colour("surface");
  context.lineWidth = 2;
  for (let x = from - height; x < to; x += 6) {
    context.beginPath();
    context.moveTo(x, y + height);
    context.lineTo(x + height, y);
    context.stroke();
  }
  context.restore();
}
