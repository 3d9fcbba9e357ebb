// Reads a cube with zarrita.js as a browser would: `node read_cube.mjs FOLDER` prints one JSON object.
import FileSystemStore from "@zarrita/storage/fs";
import * as zarr from "zarrita";

const store = new FileSystemStore(process.argv[2]);
const root = zarr.root(store);
const group = await zarr.open.v3(root, { kind: "group" });

// 64-bit integers are BigInt in JavaScript, which JSON does not know: as text, so that no digit is lost.
async function values(name, selection = null) {
  const array = await zarr.open.v3(root.resolve(name), { kind: "array" });
  const { data, shape } = await zarr.get(array, selection);
  return { shape, values: Array.from(data, (value) => (typeof value === "bigint" ? String(value) : value)) };
}

const shape = (await zarr.open.v3(root.resolve("cube"), { kind: "array" })).shape;
const middle = shape.map((length) => Math.floor(length / 2));
console.log(
  JSON.stringify({
    multiscales: group.attrs.ome.multiscales,
    cube: await values("cube"),
    band: await values("cube", [middle[0], null, null]),
    spectrum: await values("cube", [null, middle[1], middle[2]]),
    wavelength: await values("wavelength"),
    status: await values("status"),
    time: await values("time"),
  }),
);
