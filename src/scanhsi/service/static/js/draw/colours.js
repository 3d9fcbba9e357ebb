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

// Colours, stretched channel by channel: `[[low, gain], ...]`.
export function colourImage(pixels, width, height, stretch = [[0, 1], [0, 1], [0, 1]]) {
  const image = new ImageData(width, height);
  const { data } = image; // clamps
  const [[red, redGain], [green, greenGain], [blue, blueGain]] = stretch;
  for (let from = 0, to = 0; to < data.length; from += 3, to += 4) {
    data[to] = (pixels[from] - red) * redGain;
    data[to + 1] = (pixels[from + 1] - green) * greenGain;
    data[to + 2] = (pixels[from + 2] - blue) * blueGain;
    data[to + 3] = 255;
  }
  return image;
}

// The stretch that makes what is darkest black, which takes the camera's offset away, and what is brightest white.
export function stretchOf(pixels) {
  const every = 3 * Math.max(1, Math.floor(pixels.length / 60000));
  return [0, 1, 2].map((channel) => {
    const counts = new Uint32Array(256);
    let seen = 0;
    for (let index = channel; index < pixels.length; index += every, seen += 1) counts[pixels[index]] += 1;
    let [low, below] = [0, counts[0]];
    while (low < 255 && below < seen / 100) below += counts[(low += 1)];
    let [high, above] = [255, counts[255]];
    while (high > low + 16 && above < seen / 100) above += counts[(high -= 1)];
    return [low, 255 / Math.max(16, high - low)];
  });
}
