// One skin in space: its surface coloured by its image, its rim, touches with their forces, and presses. Everything is
// in the patch's frame and moves with its link.

import * as THREE from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import { Range, paint, table } from "../colour";
import type { Point } from "../protocol";
import { Rim } from "../rim";
import { Touch3d } from "./touch3d";
import type { BodyTouch, Patch } from "./protocol";

/** Skins are drawn this far above their link, metres, so that the two don't flicker. */
const ABOVE_M = 1e-3;
const MM = 1e-3;

/** How a skin is drawn. */
export type Look = "live" | "starting" | "silent" | "failed" | "ended";

/** Width of rims, pixels. */
const RIM_PX = { usual: 2, alarm: 4 };
const RIM_COLOURS: Record<Look | "stop" | "stale", number> = { live: 0x35a7bd, starting: 0x93a1b0, silent: 0xe9a94b, failed: 0xff5a4a, ended: 0x93a1b0, stop: 0xff3b30, stale: 0xe9a94b };
const BACK = new THREE.MeshLambertMaterial({ color: 0x2b333b, side: THREE.BackSide });

const PRESS_RING = new THREE.RingGeometry(0.94, 1, 40);
const PRESS_COLOUR = new THREE.MeshBasicMaterial({ color: 0xffffff, side: THREE.DoubleSide, depthTest: false, transparent: true });

export class Skin3d {
  readonly group = new THREE.Group();
  /** The mesh for ray casting. */
  readonly mesh: THREE.Mesh;
  /** Centre of the skin and its normal there, in the patch's frame. */
  readonly middle = new THREE.Vector3();
  readonly normal = new THREE.Vector3(0, 0, 1);
  readonly range = new Range();
  shownRange: [number, number] = [0, 1];
  private readonly colours: Uint32Array;
  private readonly texture: THREE.DataTexture | null;
  private readonly pixels: Uint32Array;
  private readonly flipped: Uint32Array;
  private readonly outside: Rim | null;
  private readonly material: THREE.MeshBasicMaterial;
  private readonly rims = new LineMaterial({ linewidth: RIM_PX.usual, transparent: true });
  private readonly touches = new Map<number, Touch3d>();
  private readonly presses = new Map<number, THREE.Mesh>();

  constructor(
    readonly number: number,
    readonly patch: Patch,
  ) {
    const { surface, running } = patch;
    const count = surface.positions_mm.length;
    const positions = new Float32Array(count);
    for (let k = 0; k < count; k += 1) positions[k] = MM * surface.positions_mm[k] + ABOVE_M * surface.normals[k];
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(surface.normals), 3));
    geometry.setIndex(surface.triangles);
    const isSigned = (running?.range_hint?.[0] ?? 0) < 0;
    this.colours = table(isSigned ? "signed" : "viridis");
    this.range.isSymmetric = isSigned;
    this.range.begin(running?.range_hint ?? null);
    this.shownRange = this.range.update(new Float32Array(0));
    if (running) {
      const { rows, cols, x_min_mm, x_max_mm, y_min_mm, y_max_mm } = running.grid;
      const places = new Float32Array(surface.sheet_mm.length);
      for (let k = 0; k < places.length; k += 2) {
        places[k] = (surface.sheet_mm[k] - x_min_mm) / (x_max_mm - x_min_mm);
        places[k + 1] = (surface.sheet_mm[k + 1] - y_min_mm) / (y_max_mm - y_min_mm);
      }
      geometry.setAttribute("uv", new THREE.BufferAttribute(places, 2));
      this.pixels = new Uint32Array(rows * cols);
      this.flipped = new Uint32Array(rows * cols).fill(this.colours[isSigned ? 128 : 0]);
      this.texture = new THREE.DataTexture(new Uint8Array(this.flipped.buffer), cols, rows);
      this.texture.colorSpace = THREE.SRGBColorSpace;
      [this.texture.magFilter, this.texture.minFilter] = [THREE.LinearFilter, THREE.LinearFilter];
      this.texture.needsUpdate = true;
      this.outside = new Rim(running);
    } else {
      [this.pixels, this.flipped] = [new Uint32Array(0), new Uint32Array(0)];
      [this.texture, this.outside] = [null, null];
    }
    // Unlit, so that colours match the legend.
    this.material = new THREE.MeshBasicMaterial({ map: this.texture, transparent: true });
    this.mesh = new THREE.Mesh(geometry, this.material);
    this.mesh.userData.skin = this;
    this.group.add(this.mesh, new THREE.Mesh(geometry, BACK));
    for (const { positions_mm, normals } of surface.rims) {
      const ends: number[] = [];
      for (let k = 0; k < positions_mm.length; k += 3) {
        for (let c = k; c < k + 6; c += 1) ends.push(MM * positions_mm[c % normals.length] + 1.5 * ABOVE_M * normals[c % normals.length]);
      }
      this.group.add(new LineSegments2(new LineSegmentsGeometry().setPositions(ends), this.rims));
    }
    this.place();
    const [x, y, z, ...turn] = patch.link_from_patch;
    this.group.position.set(x, y, z);
    this.group.quaternion.set(...turn);
  }

  /** Finds the point of the surface nearest to the sheet's origin, where the name is attached. */
  private place(): void {
    const { positions_mm, normals, sheet_mm } = this.patch.surface;
    let nearest = Infinity;
    for (let k = 0; k < sheet_mm.length / 2; k += 1) {
      const distance = Math.hypot(sheet_mm[2 * k], sheet_mm[2 * k + 1]);
      if (distance >= nearest) continue;
      nearest = distance;
      this.middle.fromArray(positions_mm, 3 * k).multiplyScalar(MM);
      this.normal.fromArray(normals, 3 * k);
    }
  }

  /** Takes a new image. */
  image(values: Float32Array): void {
    const { texture, outside, patch } = this;
    if (!texture || !outside || !patch.running || values.length !== this.pixels.length) return;
    const { rows, cols } = patch.running.grid;
    this.shownRange = this.range.update(values);
    paint(outside.fill(values, rows, cols), this.pixels, this.colours, this.shownRange);
    // The image's first row is at the top, the texture's at the bottom.
    for (let row = 0; row < rows; row += 1) this.flipped.set(this.pixels.subarray(row * cols, (row + 1) * cols), (rows - 1 - row) * cols);
    texture.needsUpdate = true;
  }

  /** Shows its state: `isPlaced` is false while its joints are unknown or stale. */
  look(look: Look, verdict: "ok" | "stale" | "stop" | null, isPlaced: boolean): void {
    const isLive = look === "live";
    const map = isLive ? this.texture : null;
    if (this.material.map !== map) {
      this.material.map = map;
      this.material.needsUpdate = true;
    }
    const plain = { starting: 0x5b6773, silent: 0x7a6a4a, failed: 0x8a3a34, ended: 0x4a545e, live: this.texture ? 0xffffff : 0x5b6773 }[look];
    this.material.color.setHex(plain);
    this.material.opacity = isPlaced ? 1 : 0.4;
    const alarm = isLive && verdict !== "ok" ? verdict : null;
    const isAlarm = alarm !== null || look === "failed" || look === "silent";
    this.rims.color.setHex(RIM_COLOURS[alarm ?? look]);
    this.rims.linewidth = isAlarm ? RIM_PX.alarm : RIM_PX.usual;
    this.rims.opacity = isPlaced ? 1 : 0.5;
  }

  show(touches: BodyTouch[]): void {
    const live = touches.filter((touch) => touch.phase !== "end");
    const ids = new Set(live.map(({ id }) => id));
    for (const [id, touch] of this.touches) {
      if (ids.has(id)) continue;
      this.group.remove(touch.group);
      touch.dispose();
      this.touches.delete(id);
    }
    for (const touch of live) {
      let drawn = this.touches.get(touch.id);
      if (!drawn) {
        drawn = new Touch3d();
        this.touches.set(touch.id, drawn);
        this.group.add(drawn.group);
      }
      drawn.show(touch);
    }
  }

  /** Labels of the touches: positions in the root's frame, and texts. */
  labels(): { key: string; at: THREE.Vector3; outward: THREE.Vector3; text: string }[] {
    return [...this.touches].map(([id, touch]) => ({ key: `${this.number}:${id}`, at: touch.labelAt(), outward: touch.outward(), text: touch.text }));
  }

  /** Position of a ray's hit on the flattened sheet. */
  sheetOf(hit: THREE.Intersection): Point | null {
    const grid = this.patch.running?.grid;
    if (!hit.uv || !grid) return null;
    return [grid.x_min_mm + hit.uv.x * (grid.x_max_mm - grid.x_min_mm), grid.y_min_mm + hit.uv.y * (grid.y_max_mm - grid.y_min_mm)];
  }

  /** The point of the surface above a place on the flattened sheet, and the normal there: in the patch's frame. */
  pointOf([x, y]: Point): { at: THREE.Vector3; normal: THREE.Vector3 } {
    const { positions_mm, normals, sheet_mm, triangles } = this.patch.surface;
    for (let k = 0; k < triangles.length; k += 3) {
      const corners = [0, 1, 2].map((c) => triangles[k + c]);
      const [a, b, c] = corners.map((corner) => new THREE.Vector3(sheet_mm[2 * corner], sheet_mm[2 * corner + 1], 0));
      const weights = new THREE.Vector3();
      if (!THREE.Triangle.getBarycoord(new THREE.Vector3(x, y, 0), a, b, c, weights)) continue;
      if (Math.min(weights.x, weights.y, weights.z) < -1e-6) continue;
      const mix = (from: number[], factor: number) => {
        const sum = new THREE.Vector3();
        weights.toArray().forEach((weight, index) => sum.addScaledVector(new THREE.Vector3().fromArray(from, 3 * corners[index]), weight * factor));
        return sum;
      };
      return { at: mix(positions_mm, MM), normal: mix(normals, 1).normalize() };
    }
    return { at: this.middle.clone(), normal: this.normal.clone() };
  }

  /** Marks a press, or ends its mark. */
  press(pointer: number, press: { at: Point; radius_mm: number } | null): void {
    const old = this.presses.get(pointer);
    if (old) this.group.remove(old);
    this.presses.delete(pointer);
    if (!press) return;
    const ring = new THREE.Mesh(PRESS_RING, PRESS_COLOUR);
    ring.scale.setScalar(press.radius_mm * MM);
    const { at, normal } = this.pointOf(press.at);
    ring.position.copy(at).addScaledVector(normal, 3 * ABOVE_M);
    ring.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), normal);
    ring.renderOrder = 3;
    this.presses.set(pointer, ring);
    this.group.add(ring);
  }
}
