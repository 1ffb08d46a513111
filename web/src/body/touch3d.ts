// A touch in space: a disc of its radius, and an arrow of its force with the tip on the skin. The force acts on the
// sensor, against the outward normal.

import * as THREE from "three";
import type { BodyTouch } from "./protocol";

const MM = 1e-3;
/** Length of an arrow, metres per newton: a light touch is visible on a robot of 1 m. Then its limits, metres. */
const ARROW_M_PER_N = 0.04;
const SHORTEST_M = 0.03;
const LONGEST_M = 0.4;
/** Radius drawn for a touch without one, millimetres. */
const USUAL_RADIUS_MM = 5;
/** Height of the disc over the skin, metres. */
const ABOVE_M = 2.5e-3;
const Z = new THREE.Vector3(0, 0, 1);

const DISC = new THREE.CircleGeometry(1, 40);
const RING = new THREE.RingGeometry(0.9, 1, 40);
// Along z, with the tip at the origin: shaft and head for a length of 1.
const SHAFT = new THREE.CylinderGeometry(0.5, 0.5, 1, 16).rotateX(Math.PI / 2).translate(0, 0, 0.5);
const HEAD = new THREE.ConeGeometry(0.5, 1, 20).rotateX(-Math.PI / 2).translate(0, 0, 0.5);
const PLACED = { disc: 0xf2731a, arrow: 0xe0202c };
const UNPLACED = { disc: 0x8a929a, arrow: 0x8a929a };

export class Touch3d {
  readonly group = new THREE.Group();
  text = "";
  private readonly fill = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.45, side: THREE.DoubleSide, depthWrite: false });
  private readonly edge = new THREE.MeshBasicMaterial({ side: THREE.DoubleSide });
  private readonly red = new THREE.MeshLambertMaterial();
  private readonly flat = new THREE.Group();
  private readonly arrow = new THREE.Group();
  private readonly shaft = new THREE.Mesh(SHAFT, this.red);
  private readonly head = new THREE.Mesh(HEAD, this.red);
  private length_m = 0;

  constructor() {
    this.flat.add(new THREE.Mesh(DISC, this.fill), new THREE.Mesh(RING, this.edge));
    this.arrow.add(this.shaft, this.head);
    this.group.add(this.flat, this.arrow);
  }

  /** Frees graphics memory. */
  dispose(): void {
    for (const material of [this.fill, this.edge, this.red]) material.dispose();
  }

  show(touch: BodyTouch): void {
    const { position_mm, normal } = touch.in_patch;
    const outward = new THREE.Vector3(...normal);
    this.group.position.set(...position_mm).multiplyScalar(MM).addScaledVector(outward, ABOVE_M);
    this.group.quaternion.setFromUnitVectors(Z, outward);
    const radius_m = (touch.radius_mm ?? USUAL_RADIUS_MM) * MM;
    this.flat.scale.set(radius_m, radius_m, 1);
    this.length_m = touch.force_n === null ? 0 : Math.min(Math.max(ARROW_M_PER_N * touch.force_n, SHORTEST_M), LONGEST_M);
    this.arrow.visible = this.length_m > 0;
    if (this.arrow.visible) {
      const head_m = Math.min(0.4 * this.length_m, 0.025);
      this.head.scale.set(0.55 * head_m, 0.55 * head_m, head_m);
      this.shaft.scale.set(0.22 * head_m, 0.22 * head_m, this.length_m - head_m);
      this.shaft.position.z = head_m;
    }
    const colours = touch.in_root ? PLACED : UNPLACED;
    this.fill.color.setHex(colours.disc);
    this.edge.color.setHex(colours.disc);
    this.red.color.setHex(colours.arrow);
    this.text = touch.force_n === null ? String(touch.id) : `${touch.force_n.toPrecision(2)} N`;
  }

  /** Outward normal of the skin there, in the root's frame. */
  outward(): THREE.Vector3 {
    return Z.clone().transformDirection(this.group.matrixWorld);
  }

  /** Position of its label in the root's frame. */
  labelAt(): THREE.Vector3 {
    return this.group.localToWorld(new THREE.Vector3(0, 0, this.length_m + 0.004));
  }
}
