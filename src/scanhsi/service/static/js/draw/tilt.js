// The tilt of what is seen: lines of a grid, or an edge, against the axes of the picture.

const SMALL = 0.02; // of the strongest gradient: below is noise

// Dominant orientation modulo 90 degrees, from the gradients of a picture: {degrees, coherence}, or null where it shows nothing.
//
// Each gradient votes with its squared length at four times its angle, so that both families of lines of a grid agree.
export function tilt({ data, width, height }, aspect = 1) {
  const at = (x, y) => { const place = 4 * (y * width + x); return data[place] + data[place + 1] + data[place + 2]; };
  let [cosine, sine, total, strongest] = [0, 0, 0, 0];
  const votes = [];
  for (let y = 1; y < height - 1; y += 1)
    for (let x = 1; x < width - 1; x += 1) {
      const gx = at(x + 1, y - 1) + 2 * at(x + 1, y) + at(x + 1, y + 1) - at(x - 1, y - 1) - 2 * at(x - 1, y) - at(x - 1, y + 1);
      const gy = (at(x - 1, y + 1) + 2 * at(x, y + 1) + at(x + 1, y + 1) - at(x - 1, y - 1) - 2 * at(x, y - 1) - at(x + 1, y - 1)) / aspect;
      const power = gx * gx + gy * gy;
      if (power > strongest) strongest = power;
      if (power > 0) votes.push(gx, gy, power);
    }
  for (let index = 0; index < votes.length; index += 3) {
    const power = votes[index + 2];
    if (power < SMALL * strongest) continue;
    const angle = 4 * Math.atan2(votes[index + 1], votes[index]);
    cosine += power * Math.cos(angle);
    sine += power * Math.sin(angle);
    total += power;
  }
  if (!total) return null;
  return { degrees: (Math.atan2(sine, cosine) / 4) * (180 / Math.PI), coherence: Math.hypot(cosine, sine) / total };
}
