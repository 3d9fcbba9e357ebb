// The two WebSockets: events, and frames. Both come back by themselves when the service does.

import { BASE, get } from "./api.js";
import { state, tell } from "./store.js";

const AGAIN_MS = 1500;

export function listen() {
  open("/events", (message) => {
    const event = JSON.parse(message);
    if (event.type === "state" || event.type === "hello") take(event.data);
    else tell(event.type, event.data);
  }, (connected) => {
    state.connected = connected;
    tell("state", state.info);
  });
  open("/preview", (message) => {
    const { header, pixels } = unpacked(message);
    if (header.kind === "frame") tell("frame", (state.frame = { ...header, pixels }));
    else if (header.kind === "rows") tell("rows", (state.rows = keptRows(header, pixels)));
  });
}

export async function refresh() {
  take(await get("/state"));
}

function take(info) {
  state.info = info;
  tell("state", info);
}

// The picture so far is kept, for a screen that is opened later.
function keptRows(header, pixels) {
  const kept = state.rows && state.rows.epoch === header.epoch ? state.rows : null;
  const width = header.shape[1];
  const all = kept ? kept.all : new Uint8Array(header.rows * width * 3);
  all.set(pixels, header.first * width * 3);
  return { ...header, pixels, all, width, reached: header.first + header.shape[0] };
}

function open(path, onmessage, onchange = () => {}) {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${BASE}${path}`);
  socket.binaryType = "arraybuffer";
  socket.addEventListener("open", () => {
    if (state.token) socket.send(JSON.stringify({ token: state.token }));
    onchange(true);
  });
  socket.addEventListener("message", (event) => onmessage(event.data));
  socket.addEventListener("close", () => {
    onchange(false);
    setTimeout(() => open(path, onmessage, onchange), AGAIN_MS);
  });
}

// Length of the header, header, pixels; see the description of the interface.
function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return { header, pixels: new Uint8Array(buffer, 4 + length) };
}
