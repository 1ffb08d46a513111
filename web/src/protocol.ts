// The messages between the page and the server, version 1; docs/src/page-protocol.md describes them.

import type { Connection } from "./connection";

export const VERSION = 1;

export type Point = [number, number];

export interface Electrode {
  number: number;
  position_mm: Point;
  outline_mm: Point[];
}

export interface Grid {
  rows: number;
  cols: number;
  x_min_mm: number;
  x_max_mm: number;
  y_min_mm: number;
  y_max_mm: number;
}

export interface Scene {
  skin: string;
  modality: string;
  is_twin: boolean;
  /** True if the twin can be cut and healed. */
  is_treatable: boolean;
  /** True if the skin is watched for damage. */
  watches_damage: boolean;
  outline_mm: Point[][];
  /** Diameter of the cylinder that the sheet is bent around; null if flat. */
  bend_diameter_mm: number | null;
  electrodes: Electrode[];
  grid: Grid;
  channel_labels: string[];
  channel_unit: string;
  image_quantity: string;
  image_unit: string;
  /** Unit of touch amplitudes; another than the image's with a calibration. */
  amplitude_unit: string;
  range_hint: [number, number] | null;
  hyperparameter_range: [number, number];
  press: {
    radius_mm: [number, number];
    pressure_kpa: [number, number];
    initial_radius_mm: number;
    initial_pressure_kpa: number;
  };
}

export interface Touch {
  id: number;
  phase: "begin" | "move" | "end";
  x_mm: number;
  y_mm: number;
  amplitude: number;
  area_mm2: number;
  sigma_x_mm: number | null;
  sigma_y_mm: number | null;
  force_n: number | null;
  force_range: "within" | "below" | "above" | "saturated" | "none" | null;
  /** An alternative position, with its probability. */
  other: { x_mm: number; y_mm: number; probability: number } | null;
}

export interface Pipeline {
  source: { kind: "running" | "waiting" | "lost" | "ended"; reason?: string };
  tare: { kind: "none" | "taring" | "tared"; frames_left?: number };
  baseline_age_s: number | null;
  recording: string | null;
  recorded_frames: number;
  hyperparameter: number;
  /** True while the twin shows touches by itself when nobody presses. */
  demonstrates: boolean;
}

export interface Fault {
  /** Counted from 1. */
  number: number;
  kind: "lost" | "shorted" | "inconsistent" | "noisy" | "dead" | "stuck" | "saturated" | "missing";
  with: number | null;
  for_s: number;
}

export interface Health {
  /** Fault of the frames as a whole, during which touches are unknown. */
  frame: { kind: "frozen" | "saturated" | "flipped" | "out-of-range" | "blank"; for_s: number } | null;
  left_out: number;
  electrodes: Fault[];
  channels: Fault[];
}

export interface Damage {
  id: number;
  state: "suspected" | "confirmed" | "covered" | "healing" | "healed";
  x_mm: number;
  y_mm: number;
  length_mm: number;
  direction_deg: number;
  ends_mm: [Point, Point];
  /** Largest drop of the image since the damage began. */
  depth: number;
  /** Share that has healed. */
  healed: number;
  for_s: number;
}

export interface DamageView {
  list: Damage[];
  baselines: { origin: string; reason: string; age_s: number }[];
  /** Index of the baseline that damage is measured against. */
  intact: number | null;
  proposal: { reason: "offset" | "healed" | "touched"; for_s: number; offset_sigma: number } | null;
}

export interface State {
  sequence: number;
  frame: number;
  time_ns: string;
  fps: number;
  touches: Touch[];
  latency: { stage: string; p50_us: number; p99_us: number }[];
  counters: { name: string; value: number; is_loss: boolean }[];
  state: Pipeline;
  health: Health;
  classes: { novelty: number | null; falls_back: boolean } | null;
  damage: DamageView | null;
}

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

export interface Alive {
  missed: number;
  hub: { clients: number; published: number; coalesced: number; dropped: number };
}

export interface Notice {
  level: "info" | "warning" | "error";
  text: string;
}

export interface Press {
  pointer_id: number;
  x_mm: number;
  y_mm: number;
  radius_mm: number;
  pressure_kpa: number;
}

export type Treatment =
  | { cut: { from_mm: Point; to_mm: Point } }
  | { heal: { at_mm: Point; radius_mm: number; temperature_c: number; hours: number } }
  | { "time-lapse": number }
  | "renew";

export type Command =
  | { tare: { force: boolean } }
  | "record_start"
  | "record_stop"
  | { hyperparameter: number }
  | { press: Press }
  | { move: Press }
  | { release: { pointer_id: number } }
  | { treat: Treatment }
  | { demonstrate: boolean }
  | { choose_channels: number[] };

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
