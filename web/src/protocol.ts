// The messages between the page and the server, version 1; docs/src/page-protocol.md describes them. Those in JSON have
// the types in messages.ts, which is generated from the server's types.

export type {
  Alive,
  Command,
  DamageRow as Damage,
  DamageView,
  ElectrodeView as Electrode,
  FaultView as Fault,
  GridView as Grid,
  HealthView as Health,
  Notice,
  PipelineState as Pipeline,
  Press,
  Scene,
  State,
  TouchView as Touch,
} from "./messages";

import type { Connection } from "./connection";
import type { Command, Scene, State } from "./messages";

export const VERSION = 1;

export type Point = [number, number];

export interface Image {
  frame: number;
  time_ns: bigint;
  rows: number;
  cols: number;
  values: Float32Array;
}

/** Probabilities, row-major, row 0 at the top. */
export interface Classes {
  rows: number;
  cols: number;
  lowered: Float32Array;
  raised: Float32Array;
}

export interface Channels {
  indices: Uint32Array;
  values: Float32Array;
}

/** A connection to the server of one skin. */
export type SkinConnection = Connection<Scene, State, Command>;

type Binary = { kind: "image"; image: Image } | { kind: "channels"; channels: Channels } | { kind: "noise"; noise: Float32Array } | { kind: "classes"; classes: Classes };

const MAGIC = 0x534d5244; // "DRMS" read as a little-endian word
export const HEADER_BYTES = 32;

/** Kind of a binary message; 0 if this version doesn't know it. */
export function kindOf(buffer: ArrayBuffer): number {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER_BYTES || view.getUint32(0, true) !== MAGIC || view.getUint16(4, true) !== VERSION) return 0;
  return view.getUint16(6, true);
}

/** Reads a binary message; null if this version doesn't know it. */
export function decode(buffer: ArrayBuffer): Binary | null {
  const kind = kindOf(buffer);
  if (kind === 0) return null;
  const view = new DataView(buffer);
  const first = view.getUint32(24, true);
  const second = view.getUint32(28, true);
  const words = (buffer.byteLength - HEADER_BYTES) / 4;
  switch (kind) {
    case 1: {
      if (words !== first * second) return null;
      const values = new Float32Array(buffer, HEADER_BYTES, words);
      const frame = Number(view.getBigUint64(8, true));
      return { kind: "image", image: { frame, time_ns: view.getBigUint64(16, true), rows: first, cols: second, values } };
    }
    case 2: {
      if (words !== first + second) return null;
      const indices = new Uint32Array(buffer, HEADER_BYTES, second);
      const values = new Float32Array(buffer, HEADER_BYTES + 4 * second, first);
      return { kind: "channels", channels: { indices, values } };
    }
    case 3:
      return words === first ? { kind: "noise", noise: new Float32Array(buffer, HEADER_BYTES, first) } : null;
    case 4: {
      const pixels = first * second;
      if (words !== 2 * pixels) return null;
      const lowered = new Float32Array(buffer, HEADER_BYTES, pixels);
      const raised = new Float32Array(buffer, HEADER_BYTES + 4 * pixels, pixels);
      return { kind: "classes", classes: { rows: first, cols: second, lowered, raised } };
    }
    default:
      return null;
  }
}
