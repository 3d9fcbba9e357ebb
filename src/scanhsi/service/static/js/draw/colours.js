// Colours of the theme, read once and again when it changes.

let known = {};

export function colour(name) {
  known[name] ??= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  return known[name];
}

export const forget = () => { known = {}; };

// Counts to grey by their square root, which shows what is dark; what is saturated in red: 255 means that, and nothing else does.
const GREY = new Uint32Array(256);
for (let value = 0; value < 256; value += 1) {
  const grey = Math.round(Math.sqrt(255 * value));
  GREY[value] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
}
GREY[255] = 0xff2a2aff;

export function greyImage(pixels, width, height) {
  const image = new ImageData(width, height);
  const out = new Uint32Array(image.data.buffer);
  for (let index = 0; index < out.length; index += 1) out[index] = GREY[pixels[index]];
  return image;
}

export function colourImage(pixels, width, height) {
  const image = new ImageData(width, height);
  const { data } = image;
  for (let from = 0, to = 0; to < data.length; from += 3, to += 4) {
    data[to] = pixels[from];
    data[to + 1] = pixels[from + 1];
    data[to + 2] = pixels[from + 2];
    data[to + 3] = 255;
  }
  return image;
}
