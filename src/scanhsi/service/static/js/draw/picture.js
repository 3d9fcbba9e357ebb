// A picture that fills its frame, with overlays drawn in its own pixels' coordinates, and a cursor.

import { canvas, h } from "../dom.js";

export function picture({ keepAspect = false, smooth = false, overlay = null, oncursor = null, onregion = null } = {}) {
  const buffer = document.createElement("canvas");
  let size = null;
  let box = [0, 0, 1, 1];
  let region = null;
  const caption = h("div.caption", { hidden: true });
  const { element, redraw } = canvas((context, width, height) => {
    if (!size) return;
    box = keepAspect ? fitted(size, width, height) : [0, 0, width, height];
    context.imageSmoothingEnabled = smooth;
    context.drawImage(buffer, 0, 0, size[0], size[1], ...box);
    if (overlay) overlay(context, { place, width: box[2], height: box[3], left: box[0], top: box[1] });
    if (region) {
      const [[x0, y0], [x1, y1]] = [place(region[0], region[1]), place(region[2], region[3])];
      context.strokeStyle = "#ffc233";
      context.lineWidth = 2;
      context.strokeRect(x0, y0, x1 - x0, y1 - y0);
    }
  });
  const place = (x, y) => [box[0] + (x / size[0]) * box[2], box[1] + (y / size[1]) * box[3]];
  const pixel = (event) => {
    const frame = element.getBoundingClientRect();
    const x = ((event.clientX - frame.left - box[0]) / box[2]) * size[0];
    const y = ((event.clientY - frame.top - box[1]) / box[3]) * size[1];
    return [Math.min(Math.max(x, 0), size[0] - 0.001), Math.min(Math.max(y, 0), size[1] - 0.001)];
  };
  let from = null;
  element.addEventListener("pointerdown", (event) => {
    if (!size) return;
    from = pixel(event);
    element.setPointerCapture(event.pointerId);
  });
  element.addEventListener("pointermove", (event) => {
    if (!size) return;
    const at = pixel(event);
    if (from && onregion) {
      region = [Math.min(from[0], at[0]), Math.min(from[1], at[1]), Math.max(from[0], at[0]), Math.max(from[1], at[1])];
      redraw();
    } else if (oncursor) oncursor(...at, false);
  });
  element.addEventListener("pointerup", (event) => {
    if (!from) return;
    const at = pixel(event);
    const dragged = onregion && Math.hypot(at[0] - from[0], at[1] - from[1]) > 3;
    from = null;
    if (dragged) onregion(...region.map(Math.floor));
    else {
      region = null;
      redraw();
      if (oncursor) oncursor(...at, true);
    }
  });
  const show = (image, to = [image.width, image.height]) => {
    if (buffer.width !== to[0] || buffer.height !== to[1]) [buffer.width, buffer.height] = to;
    size = to;
    return buffer.getContext("2d");
  };
  return {
    element: h("div.picture.fills", element, caption),
    redraw,
    get size() { return size; },
    // An ImageData, or anything that can be drawn.
    show(image) {
      const context = show(image);
      if (image instanceof ImageData) context.putImageData(image, 0, 0);
      else context.drawImage(image, 0, 0);
      redraw();
    },
    // Rows of a picture that grows; it begins black.
    begin(width, height) {
      const context = show(null, [width, height]);
      context.fillStyle = "#000";
      context.fillRect(0, 0, width, height);
      redraw();
    },
    rows(image, first) {
      if (!size) return;
      buffer.getContext("2d").putImageData(image, 0, first);
      redraw();
    },
    pixels() { return size ? buffer.getContext("2d").getImageData(0, 0, ...size) : null; },
    say(text) {
      caption.hidden = !text;
      if (caption.textContent !== text) caption.textContent = text ?? "";
    },
    clear() { size = null; region = null; redraw(); },
  };
}

function fitted([across, down], width, height) {
  const scale = Math.min(width / across, height / down);
  return [(width - across * scale) / 2, (height - down * scale) / 2, across * scale, down * scale];
}
