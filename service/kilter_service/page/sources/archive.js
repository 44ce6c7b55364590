// Several files as one ZIP archive, stored as they are: pictures are compressed already.
const TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  let value = n;
  for (let k = 0; k < 8; k += 1) value = value & 1 ? 0xedb88320 ^ (value >>> 1) : value >>> 1;
  return value;
});

const crc = (bytes) => ~bytes.reduce((sum, byte) => TABLE[(sum ^ byte) & 255] ^ (sum >>> 8), ~0) >>> 0;

/** A record of a ZIP archive: numbers of two or four bytes, [value, bytes]. */
function record(fields) {
  const view = new DataView(new ArrayBuffer(fields.reduce((sum, [, bytes]) => sum + bytes, 0)));
  fields.reduce((at, [value, bytes]) => (bytes === 2 ? view.setUint16(at, value, true) : view.setUint32(at, value, true), at + bytes), 0);
  return view;
}

export async function archived(files) {
  const [parts, list] = [[], []];
  let at = 0;
  for (const file of files) {
    const name = new TextEncoder().encode(file.name);
    const bytes = new Uint8Array(await file.arrayBuffer());
    const about = [[20, 2], [0x0800, 2], [0, 2], [0, 4], [crc(bytes), 4], [bytes.length, 4], [bytes.length, 4], [name.length, 2], [0, 2]];
    parts.push(record([[0x04034b50, 4], ...about]), name, bytes);
    list.push(record([[0x02014b50, 4], [20, 2], ...about, [0, 2], [0, 2], [0, 2], [0, 4], [at, 4]]), name);
    at += 30 + name.length + bytes.length;
  }
  const size = list.reduce((sum, one) => sum + one.byteLength, 0);
  const end = record([[0x06054b50, 4], [0, 2], [0, 2], [files.length, 2], [files.length, 2], [size, 4], [at, 4], [0, 2]]);
  return new File([...parts, ...list, end], "pictures.zip");
}
