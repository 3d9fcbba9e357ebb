// Focus: how sharp it is, and how sharp it was at best.

import { button, h, stat } from "../dom.js";
import { plot } from "../draw/plot.js";
import { number } from "../format.js";
import { commands, controlNote, framePicture, liveSwitch } from "./common.js";

const KEPT = 240;
const KINDS = [["spatial", "along the slit"], ["spectral", "along the spectrum"]];

function open(element, page) {
  const frame = framePicture(page, { overlay: middle });
  const scores = KINDS.map(([kind, label]) => meter(kind, label));
  const course = plot({ label: "focus scores over time" });
  const history = { spatial: [], spectral: [] };
  page.on("frame", ({ focus }) => {
    if (!focus) return;
    for (const score of scores) {
      score.show(focus[score.kind]);
      history[score.kind].push(score.share);
      if (history[score.kind].length > KEPT) history[score.kind].shift();
    }
    course.show({
      x: history.spatial.map((_, index) => index - history.spatial.length + 1),
      lines: [{ y: history.spatial }, { y: history.spectral, colour: "plot-2" }],
      xlabel: "frames ago", ylabel: "% of the best", ymin: 0, ymax: 105,
    });
  });
  const forget = () => {
    scores.forEach((score) => score.reset());
    history.spatial.length = 0;
    history.spectral.length = 0;
  };
  const controls = h("div.pane",
    controlNote(),
    liveSwitch(page),
    scores.map((score) => score.element),
    button("Reset the peaks", forget),
    h("p.muted", "Turn the lens until the bar meets its peak mark. Along the spectrum: with a line lamp, at the spectrograph."),
    h("div.card.fills.wide-only", h("h2", "Course"), course.element));
  element.append(h("div.panes.wide", h("div.pane", frame.element), controls));
  commands(page, controls);
}

// The part that the score looks at is in the middle; say so.
function middle(context, { left, top, width, height }) {
  context.strokeStyle = "rgb(255 194 51 / .7)";
  context.setLineDash([5, 4]);
  context.strokeRect(left + width * 0.29, top + height * 0.38, width * 0.42, height * 0.24);
  context.setLineDash([]);
}

function meter(kind, label) {
  const bar = h("i");
  const mark = h("i.peak");
  const now = stat("now");
  const share = stat("of the best");
  let peak = 0;
  const self = {
    kind,
    share: 0,
    element: h("div.card", h("h2", `Sharpness ${label}`), h("div.meter", { role: "meter", "aria-label": label }, bar, mark), h("div.stats", share.element, now.element)),
    reset() { peak = 0; },
    show(value) {
      peak = Math.max(peak, value);
      self.share = peak ? (100 * value) / peak : 0;
      bar.style.width = `${self.share}%`;
      mark.style.left = "calc(100% - 3px)";
      now.show(number(value));
      share.show(`${self.share.toFixed(1)} %`);
    },
  };
  return self;
}

export default { title: "Focus", open };
