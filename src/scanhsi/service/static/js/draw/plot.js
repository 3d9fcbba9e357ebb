// Lines over an axis: spectra, profiles, histograms.

import { canvas, h } from "../dom.js";
import { number } from "../format.js";
import { colour } from "./colours.js";

const LEFT = 46;
const BOTTOM = 32;
const TOP = 8;
const RIGHT = 10;

// `show({x, lines: [{y, colour, width, alpha, band: [low, high]}], bars, xlabel, ylabel, marks, ymin, ymax})`
export function plot({ label = "plot", onpick = null } = {}) {
  let data = null;
  let axis = null;
  const { element, redraw } = canvas((context, width, height) => {
    if (!data || !data.x.length) return;
    axis = axes(data, width, height);
    frame(context, axis, data, width, height);
    context.save();
    context.beginPath();
    context.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - BOTTOM);
    context.clip();
    if (data.bars) bars(context, axis, data);
    for (const line of data.lines ?? []) draw(context, axis, data.x, line);
    for (const mark of data.marks ?? []) {
      context.strokeStyle = colour("muted");
      context.setLineDash([4, 3]);
      context.beginPath();
      context.moveTo(axis.x(mark), TOP);
      context.lineTo(axis.x(mark), height - BOTTOM);
      context.stroke();
      context.setLineDash([]);
    }
    context.restore();
  });
  element.setAttribute("role", "img");
  element.setAttribute("aria-label", label);
  if (onpick) {
    element.style.cursor = "crosshair";
    element.addEventListener("pointerdown", (event) => {
      if (axis) onpick(axis.xAt(event.clientX - element.getBoundingClientRect().left));
    });
  }
  return {
    element: h("div.plot.fills", element),
    show(to) { data = to; redraw(); },
    mark(places) { if (data) { data.marks = places; redraw(); } },
    redraw,
  };
}

function axes({ x, lines = [], bars: counts, ymin = null, ymax = null }, width, height) {
  const [x0, x1] = [x[0], x[x.length - 1] === x[0] ? x[0] + 1 : x[x.length - 1]];
  let [low, high] = [ymin ?? Infinity, ymax ?? -Infinity];
  for (const values of [...lines.map((line) => line.y), ...(counts ? [counts] : [])])
    for (const value of values) {
      if (!Number.isFinite(value)) continue;
      if (ymin === null && value < low) low = value;
      if (ymax === null && value > high) high = value;
    }
  if (!Number.isFinite(low) || !Number.isFinite(high)) [low, high] = [0, 1];
  if (high <= low) high = low + 1;
  const [across, down] = [width - LEFT - RIGHT, height - TOP - BOTTOM];
  return {
    low, high, x0, x1,
    x: (value) => LEFT + ((value - x0) / (x1 - x0)) * across,
    y: (value) => TOP + (1 - (value - low) / (high - low)) * down,
    xAt: (place) => Math.min(Math.max(x0 + ((place - LEFT) / across) * (x1 - x0), Math.min(x0, x1)), Math.max(x0, x1)),
  };
}

function frame(context, axis, { xlabel = "", ylabel = "" }, width, height) {
  context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  context.fillStyle = colour("muted");
  context.strokeStyle = colour("plot-grid");
  context.lineWidth = 1;
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const tick of ticks(axis.x0, axis.x1, Math.max(2, Math.floor((width - LEFT) / 75)))) {
    const x = Math.round(axis.x(tick)) + 0.5;
    line(context, x, TOP, x, height - BOTTOM);
    context.fillText(number(tick, 4), x, height - BOTTOM + 4);
  }
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const tick of ticks(axis.low, axis.high, Math.max(2, Math.floor((height - BOTTOM) / 34)))) {
    const y = Math.round(axis.y(tick)) + 0.5;
    line(context, LEFT, y, width - RIGHT, y);
    context.fillText(number(tick), LEFT - 5, y);
  }
  context.textAlign = "center";
  context.textBaseline = "bottom";
  context.fillText(xlabel, LEFT + (width - LEFT - RIGHT) / 2, height - 1);
  if (!ylabel) return;
  context.save();
  context.translate(2, TOP + (height - TOP - BOTTOM) / 2);
  context.rotate(-Math.PI / 2);
  context.textBaseline = "top";
  context.fillText(ylabel, 0, 0);
  context.restore();
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

function draw(context, axis, x, { y, colour: name = "plot-1", width = 1.5, alpha = 1, band = null }) {
  if (band) {
    context.globalAlpha = 0.2;
    context.fillStyle = colour(name);
    context.beginPath();
    x.forEach((value, index) => context.lineTo(axis.x(value), axis.y(band[0][index])));
    for (let index = x.length - 1; index >= 0; index -= 1) context.lineTo(axis.x(x[index]), axis.y(band[1][index]));
    context.fill();
  }
  context.globalAlpha = alpha;
  context.strokeStyle = colour(name);
  context.lineWidth = width;
  context.lineJoin = "round";
  context.beginPath();
  let down = false;
  for (let index = 0; index < x.length; index += 1) {
    if (!Number.isFinite(y[index]) || y[index] === null) down = false;
    else if (down) context.lineTo(axis.x(x[index]), axis.y(y[index]));
    else {
      context.moveTo(axis.x(x[index]), axis.y(y[index]));
      down = true;
    }
  }
  context.stroke();
  context.globalAlpha = 1;
}

function bars(context, axis, { x, bars: counts, hot = null }) {
  const step = x.length > 1 ? axis.x(x[1]) - axis.x(x[0]) : 4;
  counts.forEach((count, index) => {
    context.fillStyle = colour(hot !== null && index >= hot ? "danger" : "plot-1");
    const top = axis.y(count);
    context.fillRect(axis.x(x[index]) - step / 2, top, Math.max(1, step - 0.5), axis.y(axis.low) - top);
  });
}

function ticks(low, high, most) {
  const [from, to] = [Math.min(low, high), Math.max(low, high)];
  const rough = (to - from) / most;
  const unit = 10 ** Math.floor(Math.log10(rough));
  const step = unit * [1, 2, 5, 10].find((factor) => factor * unit >= rough);
  const found = [];
  for (let tick = Math.ceil(from / step) * step; tick <= to + step * 1e-6; tick += step) found.push(Math.abs(tick) < step * 1e-6 ? 0 : tick);
  return found;
}
