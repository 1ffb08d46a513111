// The messages between the page of a body and the server, version 1; docs/src/page-protocol.md describes them.

import type { Connection } from "../connection";
import { type Command, type Grid, HEADER_BYTES, type Point, type Scene, kindOf } from "../protocol";

/** x, y, z in metres and a unit quaternion x, y, z, w. */
export type Pose = [number, number, number, number, number, number, number];
export type Vector = [number, number, number];

export interface Shape {
  link_from_shape: Pose;
  geometry: { box: Vector } | { cylinder: [number, number] } | { sphere: number } | { mesh: { address: string; scale: Vector } };
}

export interface Patch {
  name: string;
  skin: string;
  link: number;
  link_from_patch: Pose;
  surface: { positions_mm: number[]; normals: number[]; sheet_mm: number[]; triangles: number[]; rims: { positions_mm: number[]; normals: number[] }[] };
  /** Null for a patch that could not be started. */
  running: {
    page: string;
    is_twin: boolean;
    grid: Grid;
    outline_mm: Point[][];
    image_quantity: string;
    range_hint: [number, number] | null;
    press: Scene["press"];
  } | null;
}

export interface Joint {
  name: string;
  unit: "rad" | "m";
  limits: [number, number] | null;
}

export interface BodyScene {
  body: string;
  root: string;
  links: { name: string; parent: number | null; shapes: Shape[] }[];
  joints: Joint[];
  sets_joints: boolean;
  patches: Patch[];
  not_drawn: string[];
}

export interface PlacedTouch {
  position_mm: Vector;
  sigma_mm: Vector;
  normal: Vector;
  force_n: Vector | null;
}

export interface BodyTouch {
  id: number;
  phase: "begin" | "move" | "end";
  sheet_mm: Point;
  radius_mm: number | null;
  force_n: number | null;
  sigma_force_n: number | null;
  in_patch: PlacedTouch;
  /** Null while joints are unknown or stale. */
  in_root: PlacedTouch | null;
}

export interface Guard {
  verdict: "ok" | "stale" | "stop";
  reasons: string[];
}

export interface PatchState {
  state: "starting" | "running" | "silent" | "ended" | "failed";
  problem: string | null;
  frame: number;
  fps: number;
  frames: number;
  lost: number;
  channels_left_out: number;
  latency_p99_ms: number | null;
  demonstrates: boolean;
  guard: Guard | null;
  touches: BodyTouch[];
}

export interface BodyState {
  sequence: number;
  joints: { state: "fresh" | "stale" | "fixed"; age_s: number | null; problem: string | null; values: Record<string, number | null> };
  links: { root_from_link: Pose | null; is_known: boolean }[];
  patches: PatchState[];
  /** Force and torque. */
  body_wrench: [Vector, Vector] | null;
}

export type BodyCommand = { patch: { number: number; command: Command } } | { joints: Record<string, number> };

export type BodyConnection = Connection<BodyScene, BodyState, BodyCommand>;

/** The image of a patch; null for other messages. */
export function decodeImage(buffer: ArrayBuffer): { patch: number; values: Float32Array } | null {
  if (kindOf(buffer) !== 5) return null;
  const view = new DataView(buffer);
  const [patch, count] = [view.getUint32(24, true), view.getUint32(28, true)];
  return buffer.byteLength === HEADER_BYTES + 4 * count ? { patch, values: new Float32Array(buffer, HEADER_BYTES, count) } : null;
}
