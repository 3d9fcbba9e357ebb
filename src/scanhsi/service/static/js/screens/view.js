// View: a cube in colour or one band; spectra under the cursor, over a region, at random; download.

import { get, image, query } from "../api.js";
import { button, choice, fill, h, segments } from "../dom.js";
import { colour } from "../draw/colours.js";
import { picture } from "../draw/picture.js";
import { plot } from "../draw/plot.js";
import { bytes, number } from "../format.js";
import { attempt } from "../messages.js";
import { state } from "../store.js";
import { download } from "./download.js";

const PRESET_NM = 803;

function open(element, page) {
  let cube = null;
  let info = null;
  let scale = [1, 1];
  let pinned = null;
  let busy = false;
  const shown = picture({
    keepAspect: true,
    overlay: (context, { place }) => {
      if (!pinned) return;
      const [x, y] = place(...pinned);
      context.strokeStyle = colour("warn");
      context.lineWidth = 2;
      context.strokeRect(x - 6, y - 6, 12, 12);
    },
    oncursor: (x, y, pressed) => pressed && spectrumAt(x, y),
    onregion: (x0, y0, x1, y1) => spectrumOver(x0, y0, x1, y1),
  });
  // A place on the axis of the spectra is a band of the picture.
  const spectra = plot({ label: "spectra", onpick: (value) => pick(info.wavelength_nm ? nearest(info.wavelength_nm, value) : Math.round(value)) });
  const told = h("p.muted", "Touch the picture for a spectrum, drag for the mean over a region.");
  const slider = h("input", { type: "range", min: 0, max: 1, step: 1, "aria-label": "band" });
  const band = h("b");
  const mode = segments([["colour", "Colour"], ["band", "Band"]], "colour", (chosen) => { wanted = chosen; draw(); });
  let wanted = "colour";
  let about = "";
  const cubes = choice("cube", [], { onchange: () => { location.hash = `#view/${cubes.value}`; } });

  const draw = () => attempt(async () => {
    if (!cube || busy) return;
    busy = true;
    const [path, index] = wanted === "colour" ? [`/cubes/${cube}/colour`, null] : [query(`/cubes/${cube}/band`, { band: slider.value }), slider.value];
    try {
      const { bitmap, headers } = await image(path);
      scale = [info.samples / bitmap.width, info.lines / bitmap.height];
      shown.clear();
      shown.show(bitmap);
      shown.say(index === null ? about : `${bandName(index)}, black to white: ${headers.get("Scanhsi-Range")?.split(" ").map((one) => number(Number(one))).join(" to ") ?? ""}`);
    } finally {
      busy = false;
    }
    if (index !== null && index !== slider.value) draw(); // the slider went on meanwhile
  });
  const bandName = (index) => (info.wavelength_nm ? `${info.wavelength_nm[index].toFixed(1)} nm` : `band ${index}`);
  const axis = () => (info.wavelength_nm ? { x: info.wavelength_nm, xlabel: "wavelength, nm" } : { x: Array.from({ length: info.bands }, (_, index) => index), xlabel: "band" });
  const spectrumAt = (x, y) => attempt(async () => {
    pinned = [x, y];
    shown.redraw();
    const [line, sample] = [Math.floor(y * scale[1]), Math.floor(x * scale[0])];
    const found = await get(query(`/cubes/${cube}/spectrum`, { line, sample }));
    spectra.show({ ...axis(), ylabel: found.quantity, lines: [{ y: found.mean }], marks: mark() });
    told.textContent = `Line ${line}, sample ${sample}.`;
  });
  const spectrumOver = (x0, y0, x1, y1) => attempt(async () => {
    pinned = null;
    const region = {
      line: Math.floor(y0 * scale[1]), line_end: Math.min(info.lines, Math.ceil((y1 + 1) * scale[1])),
      sample: Math.floor(x0 * scale[0]), sample_end: Math.min(info.samples, Math.ceil((x1 + 1) * scale[0])),
    };
    const found = await get(query(`/cubes/${cube}/spectrum`, region));
    const [low, high] = [-1, 1].map((sign) => found.mean.map((value, index) => value + sign * found.sigma[index]));
    spectra.show({ ...axis(), ylabel: found.quantity, lines: [{ y: found.mean, band: [low, high] }], marks: mark() });
    told.textContent = `Lines ${region.line} to ${region.line_end - 1}, samples ${region.sample} to ${region.sample_end - 1}: mean and standard deviation of ${found.pixels} pixels.`;
  });
  const mark = () => (wanted === "band" ? [axis().x[slider.value]] : []);
  const random = () => attempt(async () => {
    const found = await get(query(`/cubes/${cube}/random-spectra`, { count: 100, seed: Math.floor(Math.random() * 1e6) }));
    spectra.show({ ...axis(), ylabel: found.quantity, lines: found.spectra.map((y) => ({ y, alpha: 0.25, width: 1 })) });
    told.textContent = "100 spectra of pixels drawn at random.";
  });
  const pick = (index) => {
    slider.value = index;
    band.textContent = bandName(slider.value);
    wanted = "band";
    mode.show("band");
    spectra.mark(mark());
    draw();
  };
  slider.addEventListener("input", () => pick(slider.value));

  const openCube = (id) => attempt(async () => {
    cube = id;
    shown.say("reading …");
    info = await get(`/cubes/${id}`);
    slider.max = info.bands - 1;
    slider.value = info.wavelength_nm ? nearest(info.wavelength_nm, PRESET_NM) : Math.floor(info.bands / 2);
    band.textContent = bandName(slider.value);
    about = [
      `${info.bands} bands × ${info.lines} lines × ${info.samples} samples`, bytes(info.size_bytes),
      info.complete ? null : `${info.lines_stored} of ${info.lines_planned} lines`, info.lines_missing ? `${info.lines_missing} lost` : null,
      info.simulated ? "SIMULATED" : null, info.target,
    ].filter(Boolean).join(", ");
    pinned = null;
    await draw();
    await random();
  });
  attempt(async () => {
    const list = await get("/cubes");
    const asked = decodeURIComponent(location.hash.split("/")[1] ?? "");
    fill(cubes.input, list.map((one) => h("option", { value: one.id }, one.id)));
    if (!list.length) {
      shown.say("no cube yet: scan one");
      return;
    }
    cubes.value = list.some((one) => one.id === asked) ? asked : list[0].id;
    await openCube(cubes.value);
  });

  const formats = choice("download", [["", "as …"], ...(state.capabilities?.formats ?? []).map((name) => [name, name])], {
    onchange: () => attempt(async () => {
      const format = formats.value;
      formats.value = "";
      if (format && cube) await download(cube, format);
    }),
  });
  element.append(h("div.panes.viewer",
    h("div.pane", shown.element),
    h("div.pane",
      h("div.row.even", cubes.element, formats.element),
      h("div.row.even", mode.element, button("100 random", random, { title: "100 spectra of pixels drawn at random" })),
      h("div.row.one", slider, band),
      h("div.card.fills", spectra.element),
      told)));
}

function nearest(values, wanted) {
  let best = 0;
  values.forEach((value, index) => { if (Math.abs(value - wanted) < Math.abs(values[best] - wanted)) best = index; });
  return best;
}

export default { title: "View", open };
